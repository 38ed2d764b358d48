"""Results as a sweep would have found them, without training: objectives follow from the values by a known formula."""

import math

import numpy as np

from jaxnav.sweep.results import Results, Trial

EPISODES, TOTAL, EVERY = 10, 100, 20
SCENES = ("square", "hallway")
FLOATS = {
    "hyper.actor_lr": {"low": 1e-4, "high": 1e-2, "log": True},
    "hyper.tau": {"low": 0.001, "high": 0.05, "log": True},
    "hyper.discount": {"low": 0.9, "high": 0.999, "log": False},
    "world.params.reward_collision": {"low": -50.0, "high": -5.0, "log": False},
    "hyper.critic_lr": {"low": 1e-4, "high": 1e-2, "log": True},
    "hyper.initial_temperature": {"low": 0.01, "high": 0.5, "log": True},
    "hyper.target_entropy_share": {"low": 0.1, "high": 0.9, "log": False},
    "world.params.reward_discomfort": {"low": -10.0, "high": -0.1, "log": False},
}
SIZES = {"agent.updates_per_step": [1, 2, 4], "agent.actor_widths": [[64, 64], [256, 256]]}


def identity(floats=2, sizes=0, direction="maximize", guard=None, rungs=(20,)):
    """Of a sweep over so many of `FLOATS` and `SIZES`, whose base lies in the middle."""
    space, chosen = dict(list(FLOATS.items())[:floats]), dict(list(SIZES.items())[:sizes])
    base = {"train": {"episodes": EPISODES, "total_steps": TOTAL}}
    for name, value in [*((n, 0.5) for n in space), *((n, v[0]) for n, v in chosen.items())]:
        *path, last = name.split(".")
        inner = base
        for part in path:
            inner = inner.setdefault(part, {})
        inner[last] = at(space[name], value) if name in space else value
    return {
        "base": base, "space": space, "sizes": chosen, "objective": "mean_success", "direction": direction,
        "guard": guard, "rungs": list(rungs),
    }  # fmt: skip


def at(found, share):
    """The value at that share of a range."""
    if found["log"]:
        return math.exp(math.log(found["low"]) + share * (math.log(found["high"]) - math.log(found["low"])))
    return found["low"] + share * (found["high"] - found["low"])


def curve(final, steps=TOTAL, scenes=SCENES, seconds=36.0, total=TOTAL):
    """Rounds of `EVERY` steps, in which every scene's success rises to ``final`` after ``total`` steps."""
    rows = []
    for done in range(EVERY, steps + 1, EVERY):
        reached = final * (1 - math.exp(-4 * done / total)) / (1 - math.exp(-4))
        metrics = {scene: {"success": reached, "collision": 1 - reached} for scene in scenes}
        rows.append({"env_steps": done * EPISODES, "objective": reached, "scenes": metrics, "losses": {},
                     "seconds": seconds})  # fmt: skip
    return tuple(rows)


def trial(number, final, state="complete", steps=TOTAL, values=None, seed=0, of=None, **more):
    """One that ends with that objective, were it trained to the end."""
    rows = curve(final, steps, **more)
    return Trial(number, state, values or {}, seed, of, rows[-1]["objective"] if rows else None, rows, "cpu")


def searched(count, known, seed=0, noise=0.02, stopped=0.6, broken=0.0):
    """Trials of which the objective depends on the first searched value alone, and is best at 0.7 of its range; of
    those in the worse part most are stopped."""
    rng, space = np.random.default_rng(seed), known["space"]
    trials = []
    for n in range(count):
        shares = rng.uniform(size=len(space))
        values = {name: at(found, share) for (name, found), share in zip(space.items(), shares, strict=True)}
        values |= {name: choices[rng.integers(len(choices))] for name, choices in known["sizes"].items()}
        final = float(np.clip(0.95 - 1.5 * (shares[0] - 0.7) ** 2 + noise * rng.normal(), 0, 1))
        state, steps = ("stopped", 20) if abs(shares[0] - 0.7) > 0.5 * (1 - stopped) else ("complete", TOTAL)
        if rng.uniform() < broken:
            state, steps = "broken", 40
        trials.append(trial(n, final, state, steps, values, seed=n))
    return trials


def confirmed(finals, seeds=5, spread=0.01, seed=1, values=None, total=TOTAL, start=1_000_000):
    """Trainings of candidates, {of: objective}, with these seeds, whose luck is the same for all."""
    rng = np.random.default_rng(seed)
    luck, found = spread * rng.normal(size=seeds), []
    for s in range(seeds):
        for of, final in finals.items():
            own = 0.3 * spread * rng.normal()
            found.append(trial(len(found), final + float(luck[s] + own), seed=start + s, of=of,
                               values=(values or {}).get(of), total=total))  # fmt: skip
    return found


def results(search=(), confirm=(), guard=(), known=None, trials=None, confirmations=0, seeds=5, name="lr and tau"):
    """A `Results` of these phases; as many trials asked for as there are, unless said otherwise."""
    return Results(
        name=name,
        identity=known or identity(),
        budget={"trials": len(search) if trials is None else trials, "confirm": confirmations, "seeds": seeds},
        phases={"search": list(search), "confirm": list(confirm), "guard": list(guard)},
        runs=[
            {"versions": {"python": "3.11.9", "jax": "0.10.0"}, "git_commit": "0123abc", "device": "cpu, 2 cores"},
        ],
    )


def whole(floats=2, sizes=0, count=64, candidates=3, guard=True, seeds=5, finals=(0.90, 0.95, 0.94, 0.85, 0.91, 0.89)):
    """A finished sweep."""
    asked = {"scene": "all", "total_steps": 100, "every": 20, "reaches": 0.8, "slack": 1.1} if guard else None
    known = identity(floats, sizes, guard=asked)
    search = searched(count, known)
    best = sorted((t for t in search if t.state == "complete"), key=lambda t: -t.objective)[:candidates]
    chosen = dict(zip([None, *(t.number for t in best)], finals, strict=False))
    values = {t.number: t.values for t in best}
    again = confirmed(chosen, seeds, values=values)
    guarded = confirmed(chosen, seeds, values=values, seed=2) if guard else []
    return results(search, again, guarded, known, confirmations=candidates, seeds=seeds)
