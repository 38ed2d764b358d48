"""What brings hybrid SAC nearer to the planner in crossflow, the scene in which it is furthest behind.

python experiments/crossflow.py --help
"""

import dataclasses
import json
import pathlib
import time

import cells
import numpy as np
import scene_study
from paired import packed, pair
from rich.console import Console

from jaxnav.errors import UserError
from jaxnav.training.dataclass_json import differences, to_json
from jaxnav.training.population import member
from jaxnav.training.provenance import provenance
from jaxnav.training.run import VALIDATION_SEED

PROGRAM, SCENE, BASE = "crossflow", "crossflow", "as in the tables"
EVERY = 32_000  # environment steps between two lines of progress
# Changes of (WorldConfig, HSACConfig), and how much longer training is.
VARIANTS = {
    BASE: ({}, {}, 1),
    "all eight people observed": ({"nearest": 8}, {}, 1),
    "mean of the twins": ({}, {"twins": "mean"}, 1),
    "eight, and four times as long": ({"nearest": 8}, {}, 4),
}


@dataclasses.dataclass(frozen=True)
class Options:
    """Train hybrid SAC in crossflow with one thing changed, and compare it with the tables' and with the planner.

    Writes crossflow.json and .md. Robots are judged by episodes of the validation seed and validation phrases, which
    no table is played with. A variant that the file holds already is not tried again.

    Args:
        variants: those to try; all of them if none is named.
        seeds: robots of each, trained at once.
        episodes: played with each.
        steps: of training, in environment steps.
        out: folder of the results.
    """

    variants: tuple[str, ...] = ()
    seeds: int = 5
    episodes: int = 2000
    steps: int = 256_000
    out: pathlib.Path = scene_study.RESULTS

    def __post_init__(self):
        limits = ("seeds", 1, 100), ("episodes", 1, 10**6), ("steps", EVERY, 10**8)
        scene_study.check_numbers(self, limits)
        if self.steps % EVERY:
            raise UserError(f"--steps is {self.steps}: give a multiple of {EVERY}")
        for name in self.variants:
            if name not in VARIANTS:
                raise UserError(f"--variants names {name!r}: choose from {', '.join(VARIANTS)}")


def configuration(name, steps):
    """The `RunConfig` of a variant."""
    world, agent, longer = VARIANTS[name]
    config = cells.configuration(cells.METHODS[cells.MAIN], (SCENE,), longer * steps)
    return dataclasses.replace(
        config, world=dataclasses.replace(config.world, **world), agent=dataclasses.replace(config.agent, **agent)
    )


def _row(name, budget, plays, seeds):
    return {
        "suite": "hard", "scene": SCENE, "method": name, "budget": budget, "seeds": seeds,
        "episodes": plays.arrived.shape[1], **cells.measures(plays), "arrived": packed(plays.arrived),
    }  # fmt: skip


def trained(name, options, console):
    """The row of a variant."""
    config = configuration(name, options.steps)
    programs, start = cells.Programs(config, options.seeds), time.monotonic()
    population, total = programs.population, config.train.total_steps

    def show(steps, metrics):
        done = steps * config.train.episodes
        if done % EVERY == 0:
            rates = metrics["episodes_arrived"].sum(1) / np.maximum(metrics["episodes_ended"].sum(1), 1)
            console.print(f"{name}: {done // 1000}k steps, success while learning {rates.round(2)}", soft_wrap=True)

    _, trained = population.train(population.start(range(options.seeds), config.hyper, 0), config.hyper, total, show)
    seconds, spoken = round(time.monotonic() - start, 1), programs.agent.spoken("validation")
    good = [seed for seed in range(options.seeds) if trained.broken[seed] is None]
    if not good:
        raise UserError(f"all seeds of {name!r} turned non-finite: try others with --variants")
    plays = [
        programs.player((member(trained.policies, i), True, spoken), 0, VALIDATION_SEED, options.episodes) for i in good
    ]
    plays = type(plays[0])(*(np.stack(leaves) for leaves in zip(*plays, strict=True)))
    return _row(name, "trained", plays, good) | {
        "env_steps": trained.env_steps, "train_seconds": seconds, "config": to_json(config),
        "excluded": [i for i in range(options.seeds) if i not in good], **provenance(),
    }  # fmt: skip


def planned(options):
    """The row of the planner."""
    policy, policy_params = cells.SCRIPTED["planner"]
    config = configuration(BASE, options.steps)
    player = cells.Player(config.world.world(), config.world.params, policy)
    plays = player(policy_params, 0, VALIDATION_SEED, options.episodes)
    return _row("planner", "none", type(plays)(*(leaf[None] for leaf in plays)), []) | provenance()


def study(options):
    """Try what is missing, and write both files."""
    scene_study.make_folder(options.out)
    path, console = options.out / f"{PROGRAM}.json", Console(stderr=True)
    identity = {"seeds": options.seeds, "episodes": options.episodes, "steps": options.steps}
    result = {"command": f"python experiments/{PROGRAM}.py", **identity, "rows": {}}
    result["rows"] = rows = scene_study.stored(path, identity, "rows", {})
    for name in VARIANTS:
        if name in rows:
            now = json.loads(json.dumps(to_json(configuration(name, options.steps))))
            changed = differences(rows[name]["config"], now)
            if changed:
                raise UserError(f"{path} tried another {name!r} ({', '.join(changed)} differ): move it away")
    if "planner" not in rows:
        rows["planner"] = planned(options)
        scene_study.write(path, result)
    for name in options.variants or VARIANTS:
        if name not in rows:
            rows[name] = trained(name, options, console)
            scene_study.write(path, result)
            console.print(f"{name}: {np.round(rows[name]['success']['per_seed'], 3)}", soft_wrap=True)
    path.with_suffix(".md").write_text(table(result))
    return result


def table(result):
    """The result as Markdown."""
    rows = result["rows"]
    devices = ", ".join(sorted({row["device"] for row in rows.values()}))
    lines = [
        f"Hybrid SAC in `{SCENE}` with one thing changed, {result['seeds']} seeds each; {result['episodes']:,} "
        "episodes of the validation seed, validation phrases. Differences of success in points, over the same "
        "episodes; in brackets 95 % over training seeds (bootstrap). With several variants beside each other the best "
        f"looks better than it is. Device: {devices}; the commit of each row is in the JSON file.",
        "", "| | steps | success (each seed) | collisions with people | comfort | minus the tables' | "
        "minus the planner | training, s |", f"|{'---|' * 8}",
    ]  # fmt: skip
    for name in [*(name for name in VARIANTS if name in rows), "planner"]:
        row = rows[name]
        seeds = f" ({' '.join(f'{rate:.3f}' for rate in row['success']['per_seed'])})" if row["seeds"] else ""
        compared = [
            _difference(row, rows.get(other)) if row["seeds"] and name != other else "" for other in (BASE, "planner")
        ]
        excluded = f" (without seeds {row['excluded']}, which turned non-finite)" if row.get("excluded") else ""
        lines.append(
            f"| {name}{excluded} | {row.get('env_steps', 0):,} | {row['success']['mean']:.3f}{seeds} | "
            f"{row['human_collision']['mean']:.3f} | {row['comfort']['mean']:.3f} | {' | '.join(compared)} | "
            f"{row.get('train_seconds', 0):.0f} |"
        )
    return "\n".join(lines) + "\n"


def _difference(one, other):
    found = other and pair(one, other)
    if not found:
        return "-"
    interval = found["seeds_ci95"]
    seeds = f" ({100 * interval[0]:+.1f} to {100 * interval[1]:+.1f})" if interval else ""
    return f"{100 * found['difference']:+.1f}{seeds}"


def main(arguments=None):
    """Entry point."""
    scene_study.main(Options, study, table, PROGRAM, arguments)


if __name__ == "__main__":
    main()
