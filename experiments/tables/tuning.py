"""The same tuning budget for every algorithm: a random search over its floats, all trials trained at once.

python -m experiments.tables.tuning --help
"""

import dataclasses
import pathlib
import time

import numpy as np

from experiments import study
from experiments.tables import methods
from jaxnav import preset
from jaxnav.agents import LEARNERS
from jaxnav.training import VALIDATION_SEED, Evaluator, Policy, Population, make_agent, member, resolve, to_json

PROGRAM = "tables.tuning"
SCENES = ("narrow", "doorway", "corner")  # of the hard suite, since the parity suite saturates; one pedestrian each
STEPS = 128_000  # environment steps of a trial, the paper's

_RATES = {"actor_lr": (3e-4, 3e-3), "critic_lr": (3e-4, 3e-3)}
_ON_POLICY = _RATES | {"gae_lambda": (0.8, 0.98), "entropy_weight": (1e-4, 1e-2), "initial_std": (0.2, 0.8)}
# (lowest, highest) of what is drawn: discounts by their distance to 1; all on a logarithmic scale but gae_lambda.
SPACES = {
    "hsac": _RATES | {"discount": (0.95, 0.99), "tau": (0.005, 0.03), "initial_temperature": (0.02, 0.2)},
    "td3": _RATES | {"discount": (0.95, 0.99), "tau": (0.005, 0.03), "exploration_noise": (0.05, 0.5)},
    "ppo": _ON_POLICY | {"discount": (0.95, 0.99)},
    "a2c": _ON_POLICY | {"discount": (0.95, 0.99)},
}


@dataclasses.dataclass(frozen=True)
class Options:
    """Draw hyperparameters, train a robot with each for 128,000 steps in three hard scenes, and keep the best.

    Writes tuning.json and .md. The first trial of each algorithm are its defaults. Trials are judged by their mean
    success over the scenes, on the validation seed and with validation phrases: no table is played with either. An
    algorithm that the file holds already is not tuned again.

    Args:
        trials: of each algorithm.
        seed: of what is drawn.
        out: folder of the results.
    """

    trials: int = 8
    seed: int = 0
    out: pathlib.Path = study.RESULTS

    def __post_init__(self):
        study.check_numbers(self, ("trials", 1, 100), ("seed", 0, 2**32 - 1))


def drawn(space, trials, rng):
    """{name: `[trials - 1]`} of random hyperparameters."""
    values = {}
    for name, (low, high) in space.items():
        u = rng.uniform(size=trials - 1)
        if name == "gae_lambda":
            values[name] = low + u * (high - low)
        elif name == "discount":
            values[name] = 1.0 - (1.0 - low) ** (1 - u) * (1.0 - high) ** u
        else:
            values[name] = low ** (1 - u) * high**u
    return values


def configuration(algo):
    """The `RunConfig` of an algorithm with its defaults."""
    base = preset("quick", algo)
    train = dataclasses.replace(base.train, total_steps=STEPS // base.train.episodes)
    return resolve(dataclasses.replace(base, world=base.world.of_scenes(SCENES), train=train))


def tune(algo, options, console):
    """The row of an algorithm."""
    config = configuration(algo)
    rng, start = np.random.default_rng(options.seed), time.monotonic()
    values = {
        name: np.float32([getattr(config.hyper, name), *found]).round(6)
        for name, found in drawn(SPACES[algo], options.trials, rng).items()
    }
    hyper, agent = config.hyper.replace(**values), make_agent(config)
    population = Population(config, agent, options.trials)
    loop = population.start([options.seed] * options.trials, hyper)

    show = methods.reporter(console, algo, config.train.episodes)
    _, trained = population.train(loop, hyper, config.train.total_steps, show)
    evaluator, trials = Evaluator(population.world, config.world.params), []
    policies = Policy(trained.policies, learner=agent, world=population.world)
    for i in range(options.trials):
        policy = policies.replace(parameters=member(trained.policies, i))
        success = evaluator.success(policy, VALIDATION_SEED)
        score = 0.0 if trained.broken[i] is not None else float(np.mean(list(success.values())))
        trials.append(
            {"hyper": {n: float(v[i]) for n, v in values.items()}, "success": success, "score": score,
             "broken": trained.broken[i]}
        )  # fmt: skip
    best = max(trials, key=lambda trial: trial["score"])
    console.print(f"{algo}: default {trials[0]['score']:.3f}, best {best['score']:.3f} with {best['hyper']}")
    return {
        "best": best["hyper"], "score": best["score"], "trials": trials,
        "seconds": round(time.monotonic() - start, 1),
    }  # fmt: skip


def table(result):
    """The result as Markdown."""
    lines = [
        f"Random search over the floats of each algorithm: {result['trials']} trials of {STEPS:,} environment steps, "
        "the first with its defaults, the others drawn with the same random numbers for every algorithm (two that "
        "share a range try the same values). All are trained at once, each on "
        f"{', '.join(SCENES)} together and with one training seed; the score is the mean success over these scenes, "
        "500 episodes each of the validation seed. Sizes were not tuned.",
        "", "| algorithm | default | best | worst | chosen | device | commit |", "|---|---|---|---|---|---|---|",
    ]  # fmt: skip
    for algo, found in result["algorithms"].items():
        scores = [trial["score"] for trial in found["trials"]]
        broken = sum(trial["broken"] is not None for trial in found["trials"])
        worst = f"{min(scores):.3f}" + (f" ({broken} turned non-finite: 0)" if broken else "")
        chosen = ", ".join(f"{name} {value:.4g}" for name, value in found["best"].items())
        lines.append(
            f"| {algo} | {scores[0]:.3f} | {max(scores):.3f} | {worst} | {chosen} | {found['device']} | "
            f"{found['git_commit']} |"
        )
    return "\n".join(lines) + "\n"


def run(options: Options) -> dict:
    """Tune what has not been tuned yet, and write both files."""
    identity = {"trials": options.trials, "seed": options.seed, "scenes": list(SCENES), "steps": STEPS}
    begun = study.Study(
        PROGRAM, options.out, identity, LEARNERS, lambda algo: to_json(configuration(algo)), field="algorithms"
    )
    for algo in begun.missing():
        begun.add(algo, tune(algo, options, study.console()))
    return begun.finish(table)


def main(arguments=None):
    """Entry point."""
    study.main(Options, run, table, PROGRAM, arguments)


if __name__ == "__main__":
    main()
