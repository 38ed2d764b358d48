"""The worth of each trick of the learner: time to 0.95 in the parity suite, and success in three hard scenes.

python -m experiments.tricks --help
"""

import dataclasses
import pathlib
import time

import jax
import numpy as np

from experiments import study
from experiments.tables import tuning
from jaxnav import SUITES, preset
from jaxnav.training import VALIDATION_SEED, Evaluator, Policy, Population, make_agent, member, resolve, to_json

PROGRAM = "tricks"
THRESHOLD = 0.95
EVERY = 25  # steps of all episodes between two evaluations in the parity suite
# Changes of one thing each: (of HSACConfig, of HSACHyperparameters). results/tricks.md has more: options that brought
# nothing were taken out of the learner, and are at the commits that tricks.json names.
TRICKS = {
    "as committed": ({}, {}),
    "one-step targets": ({"n_step": 1}, {}),
    "the last actor, not the average": ({}, {"average": 1.0}),
    "learning rates that decay to 0": ({}, {"final_lr": 0.0}),
    "batches of twice the size": ({"batch": 1024}, {}),
    "a twist for each request": ({"heads": "per-request"}, {}),
    "told when and how near people come (lidar-approach)": ({"encoder": "lidar-approach"}, {}),
}


@dataclasses.dataclass(frozen=True)
class Options:
    """Train hybrid SAC with one thing changed at a time, and write what it is worth.

    Writes tricks.json and .md. A trick that the file holds already is not tried again.

    Args:
        tricks: those to try; all of them if none is named.
        seeds: robots of each, trained at once.
        parity_steps: of all episodes, in the parity suite.
        hard_steps: likewise in the hard scenes.
        out: folder of the results.
    """

    tricks: tuple[str, ...] = ()
    seeds: int = 3
    parity_steps: int = 200
    hard_steps: int = 250
    out: pathlib.Path = study.RESULTS

    def __post_init__(self):
        limits = ("seeds", 1, 100), ("parity_steps", EVERY, 10**5), ("hard_steps", EVERY, 10**5)
        study.check_numbers(self, *limits)
        study.check_multiples(self, ("parity_steps", EVERY), ("hard_steps", EVERY))
        study.check_names(self.tricks, "--tricks", TRICKS)


def configuration(name, scenes, steps):
    """The `RunConfig` of a trick."""
    agent_changes, hyper_changes = TRICKS[name]
    base = preset("quick")
    return resolve(
        dataclasses.replace(
            base, world=base.world.of_scenes(scenes), agent=dataclasses.replace(base.agent, **agent_changes),
            hyper=base.hyper.replace(**hyper_changes), train=dataclasses.replace(base.train, total_steps=steps),
        )
    )  # fmt: skip


def train(config, every, seeds):
    """One dict an evaluation: training with a trick, judged on the validation seed.

    A dict holds steps, updates, success `[seeds][scenes]`, and seconds: those of training alone, compiled, divided by
    the seeds that are trained at once.
    """
    steps = config.train.total_steps
    agent = make_agent(config)
    population = Population(config, agent, seeds)
    evaluator = Evaluator(population.world, config.world.params)
    # Compiled before the clock starts, on members that are thrown away.
    jax.block_until_ready(population.train(population.start(range(seeds), config.hyper), config.hyper, 1)[0])
    loop, seconds, lines, broken = population.start(range(seeds), config.hyper), 0.0, [], ()
    for done in range(every, steps + 1, every):
        start = time.monotonic()
        loop, trained = population.train(loop, config.hyper, done, before=broken)
        seconds, broken = seconds + time.monotonic() - start, trained.broken
        policy = Policy(trained.policies, learner=agent, world=population.world)
        of_seeds = [policy.replace(parameters=member(trained.policies, i)) for i in range(seeds)]
        success = [list(evaluator.success(one, VALIDATION_SEED).values()) for one in of_seeds]
        lines.append(
            {"steps": done, "updates": config.agent.updates(done), "seconds": round(seconds / seeds, 2),
             "success": success, "broken": broken}
        )  # fmt: skip
    return lines


def run(options: Options) -> dict:
    """Try what is missing, and write both files."""
    console = study.console()
    identity = {
        "seeds": options.seeds, "parity_steps": options.parity_steps, "hard_steps": options.hard_steps,
        "hard_scenes": list(tuning.SCENES),
    }  # fmt: skip

    def parity(name):
        return configuration(name, SUITES["parity"], options.parity_steps)

    begun = study.Study(PROGRAM, options.out, identity, TRICKS, lambda name: to_json(parity(name)))
    for name in begun.missing(options.tricks or TRICKS):
        hard = configuration(name, tuning.SCENES, options.hard_steps)
        found = {"parity": train(parity(name), EVERY, options.seeds)}
        begun.add(name, found | {"hard": train(hard, options.hard_steps, options.seeds)})
        console.print(_row(name, begun.rows[name]))
    return begun.finish(table)


def arrival(lines, seed):
    """The first of two consecutive evaluations of a seed with `THRESHOLD` in every scene, or None."""
    passed = [min(line["success"][seed]) >= THRESHOLD for line in lines]
    return next((line for line, now, then in zip(lines, passed, passed[1:], strict=False) if now and then), None)


def _row(name, found):
    parity, hard = found["parity"], found["hard"][-1]
    whole = [i for i, step in enumerate(parity[-1]["broken"]) if step is None and hard["broken"][i] is None]
    left_out = len(hard["success"]) - len(whole)
    name += f" ({left_out} of {len(hard['success'])} seeds turned non-finite and are left out)" if left_out else ""
    if not whole:
        return f"| {name} | - | - | - | - | - |"
    arrivals = [arrival(parity, seed) for seed in whole]

    def median(field, digits):
        values = [np.inf if line is None else line[field] for line in arrivals]
        middle = float(np.median(values))
        return f"{middle:.{digits}f}" if np.isfinite(middle) else "not reached"

    last, final = np.array(parity[-1]["success"])[whole], np.array(hard["success"])[whole]
    cells = [
        median("updates", 0), median("seconds", 1), f"{parity[-1]['seconds'] / parity[-1]['updates'] * 1000:.1f}",
        f"{last.mean():.3f} ({last.min():.3f})", f"{final.mean():.3f} ({' '.join(f'{v:.3f}' for v in final.mean(1))})",
    ]  # fmt: skip
    return f"| {name} | {' | '.join(cells)} |"


def table(result):
    """The result as Markdown."""
    lines = [
        "Hybrid SAC, its hyperparameters as they are by default, with one thing changed at a time; "
        f"{result['seeds']} seeds trained at once, validation seed and "
        f"phrases, 500 episodes a scene and evaluation. Parity suite: {result['parity_steps']} steps of 256 episodes; "
        f"updates until {THRESHOLD} in every scene twice in a row, and seconds (compiled, training alone, divided by "
        f"the seeds trained at once), medians. Hard scenes ({', '.join(result['hard_scenes'])}): "
        f"{result['hard_steps']} steps. {study.sources(result['rows'].values())}",
        "", f"| | updates to {THRESHOLD} | seconds to {THRESHOLD} | ms an update | parity suite at the end, mean "
        "(worst) | hard scenes, mean (each seed) |", "|---|---|---|---|---|---|",
    ]  # fmt: skip
    lines += [_row(name, result["rows"][name]) for name in TRICKS if name in result["rows"]]
    return "\n".join(lines) + "\n"


def main(arguments=None):
    """Entry point."""
    study.main(Options, run, table, PROGRAM, arguments)


if __name__ == "__main__":
    main()
