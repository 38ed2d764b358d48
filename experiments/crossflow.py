"""Changes that might bring hybrid SAC nearer to the planner in crossflow, the scene in which it is furthest behind.

python -m experiments.crossflow --help
"""

import dataclasses
import pathlib
import time
from typing import NamedTuple

from experiments import study
from experiments.paired import pair
from experiments.tables import methods
from jaxnav.errors import UserError
from jaxnav.statistics import packed
from jaxnav.training import VALIDATION_SEED, EpisodeSummary, to_json

PROGRAM, SCENE, UNCHANGED, PLANNER = "crossflow", "crossflow", "unchanged", "planner"


class Variant(NamedTuple):
    """what: in words; world, agent: changes of `WorldConfig` and `HSACConfig`; longer: factor of the training."""

    what: str
    world: dict
    agent: dict
    longer: int = 1


_EIGHT, _APPROACH = {"nearest": 8}, {"encoder": "lidar-approach"}
VARIANTS = {
    UNCHANGED: Variant("as the tables train it for 256,000 steps", {}, {}),
    "eight": Variant("all eight people observed, not the nearest four", _EIGHT, {}),
    "approach": Variant("the encoder lidar-approach", {}, _APPROACH),
    "approach-eight": Variant("lidar-approach, all eight observed", _EIGHT, _APPROACH),
    "approach-eight-twice": Variant("lidar-approach, all eight observed, twice the steps", _EIGHT, _APPROACH, 2),
}


@dataclasses.dataclass(frozen=True)
class Options:
    """Train hybrid SAC in crossflow with changes, and compare it with the unchanged one and with the planner.

    Writes crossflow.json and .md. Robots are judged by episodes of the validation seed and validation phrases, which
    no table is played with. A variant that the file holds already is not tried again.

    Args:
        variants: those to try: unchanged, eight, approach, approach-eight, approach-eight-twice; all of
            them if none is named.
        seeds: robots of each, trained at once.
        episodes: played with each.
        steps: of training, in environment steps.
        out: folder of the results.
    """

    variants: tuple[str, ...] = ()
    seeds: int = 5
    episodes: int = 2000
    steps: int = 256_000
    out: pathlib.Path = study.RESULTS

    def __post_init__(self):
        study.check_numbers(self, ("seeds", 1, 100), ("episodes", 1, 10**6), ("steps", methods.REPORTED, 10**8))
        study.check_multiples(self, ("steps", methods.REPORTED))
        study.check_names(self.variants, "--variants", VARIANTS)


def configuration(name, steps):
    """The `RunConfig` of a variant."""
    _, world, agent, longer = VARIANTS[name]
    config = methods.configuration(methods.METHODS[methods.MAIN], (SCENE,), longer * steps)
    return dataclasses.replace(
        config, world=dataclasses.replace(config.world, **world), agent=dataclasses.replace(config.agent, **agent)
    )


def identity_of(name, steps):
    """The configuration that decides on the row of a variant or of the planner."""
    return to_json(configuration(UNCHANGED, steps).world if name == PLANNER else configuration(name, steps))


def row(name, summary, seeds):
    """The row of plays `[seeds, episodes]`; seeds: none of the planner."""
    return {
        "suite": "hard", "scene": SCENE, "method": name, "budget": "trained" if seeds else "none", "seeds": seeds,
        "episodes": summary.arrived.shape[1], **methods.measures(summary), "arrived": packed(summary.arrived),
    }  # fmt: skip


def train(name, options, console):
    """The row of a variant."""
    config = configuration(name, options.steps)
    programs, start = methods.Programs(config, options.seeds, phrases="validation"), time.monotonic()
    loop = programs.population.start(range(options.seeds), config.hyper, 0)
    show = methods.reporter(console, name, config.train.episodes)
    _, trained = programs.population.train(loop, config.hyper, config.train.total_steps, show)
    seconds = round(time.monotonic() - start, 1)
    good = [seed for seed in range(options.seeds) if trained.broken[seed] is None]
    if not good:
        raise UserError(f"all seeds of {name} turned non-finite: name others with --variants")
    plays = programs.play(trained.policies, methods.METHODS[methods.MAIN], 0, VALIDATION_SEED, options.episodes)
    plays = EpisodeSummary(*(leaf[good] for leaf in plays))
    excluded = [seed for seed in range(options.seeds) if seed not in good]
    return row(name, plays, good) | {
        "env_steps": trained.env_steps, "train_seconds": seconds, "excluded": excluded
    }  # fmt: skip


def plan(options):
    """The row of the planner."""
    config = configuration(UNCHANGED, options.steps)
    playing = methods.Playing(config.world.world(), config.world.params)
    plays = playing(methods.SCRIPTED[PLANNER], 0, VALIDATION_SEED, options.episodes)
    return row(PLANNER, EpisodeSummary(*(leaf[None] for leaf in plays)), [])


def run(options: Options) -> dict:
    """Try what is missing, and write both files."""
    identity = {"seeds": options.seeds, "episodes": options.episodes, "steps": options.steps}
    begun = study.Study(
        PROGRAM, options.out, identity, (PLANNER, *VARIANTS), lambda name: identity_of(name, options.steps)
    )
    for name in begun.missing((PLANNER, *(options.variants or VARIANTS))):
        begun.add(name, plan(options) if name == PLANNER else train(name, options, study.console()))
    return begun.finish(table)


def table(result):
    """The result as Markdown."""
    rows = result["rows"]
    lines = [
        f"Hybrid SAC in `{SCENE}`, changed; {result['seeds']} seeds each; {result['episodes']:,} episodes of the "
        "validation seed, validation phrases. Differences of success in points, over the same episodes; in brackets "
        "95 % over training seeds (percentile bootstrap: of five seeds it covers less). The best of several looks "
        f"better than it is. {study.sources(rows.values())}",
        "", "| | | steps | success (each seed) | collisions with people | comfort | minus unchanged | "
        "minus the planner | training (s) |", f"|{'---|' * 9}",
    ]  # fmt: skip
    for name in [*(name for name in VARIANTS if name in rows), PLANNER]:
        one = rows[name]
        parts = [name, "knows the map, and what is meant", "-", f"{one['success']['mean']:.3f}"]
        differ, seconds = ["", ""], "-"
        if name != PLANNER:
            excluded = f"; without seeds {one['excluded']}, which turned non-finite" if one["excluded"] else ""
            seeds = " ".join(f"{rate:.3f}" for rate in one["success"]["per_seed"])
            parts = [name, VARIANTS[name].what + excluded, f"{one['env_steps']:,}", f"{parts[-1]} ({seeds})"]
            differ = ["" if name == other else _difference(one, rows.get(other)) for other in (UNCHANGED, PLANNER)]
            seconds = f"{one['train_seconds']:.0f}"
        means = [f"{one[field]['mean']:.3f}" for field in ("human_collision", "comfort")]
        lines.append(f"| {' | '.join([*parts, *means, *differ, seconds])} |")
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
    study.main(Options, run, table, PROGRAM, arguments)


if __name__ == "__main__":
    main()
