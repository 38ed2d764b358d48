"""Does a robot that was trained among ORCA pedestrians survive other people's: social force, and recorded ones?

python -m experiments.people --help
"""

import dataclasses
import hashlib
import math
import pathlib
from typing import Any

import numpy as np

from experiments import study
from experiments.paired import pair
from jaxnav import SUITES, Params, RunConfig, World, WorldConfig, preset
from jaxnav.errors import UserError
from jaxnav.language.table import default_table
from jaxnav.statistics import packed, unpacked, wilson_interval
from jaxnav.training import EpisodeSummary, Evaluator, resolve, to_json
from jaxnav.world.people import RECORDING

PROGRAM = "people"
BLOCK = 250  # episodes played at once
TRAINED_ON = "orca"
SIMULATED = (TRAINED_ON, "social-force")
CELLS = {f"{scene}/{people}": (scene, people) for scene in SUITES["parity"] for people in SIMULATED} | {
    f"{RECORDING}/{people}": (RECORDING, people) for people in (*SIMULATED, "recorded")
}


@dataclasses.dataclass(frozen=True)
class Options:
    """Train robots of the preset quick in the parity suite, and play them among people who move by other models.

    Among ORCA and social-force people in the scenes that they were trained in, and among both and recorded people in a
    scene made of the recording. Writes people.json and .md; what is trained or played already is not done again.

    Args:
        recording: file in the ETH format; without one the cells that need it are left out.
        episodes: of each robot and cell; rounded up to 250.
        steps: of training, of 256 episodes.
        robots: how many are trained, of seeds 0, 1, ...
        pedestrians: the most recorded people at once.
        crowd: simulated people in the recording's scene.
        seed: of the episodes, the same for all; training has not seen them.
        runs: folder of the trainings.
        out: folder of the results.
    """

    recording: str = ""
    episodes: int = 1000
    steps: int = 1000
    robots: int = 3
    pedestrians: int = 16
    crowd: int = 6
    seed: int = 7
    runs: pathlib.Path = pathlib.Path("runs/people")
    out: pathlib.Path = study.RESULTS

    def __post_init__(self):
        study.check_numbers(
            self, ("episodes", 1, 1_000_000), ("steps", 25, 100_000), ("robots", 1, 100), ("pedestrians", 1, 64),
            ("crowd", 1, self.pedestrians),
        )  # fmt: skip
        study.check_multiples(self, ("steps", 25))
        study.check_seed(self.seed)


def configuration(options: Options, seed: int) -> RunConfig:
    """The run of a robot."""
    base, folder = preset("quick"), options.runs / f"quick-{seed}"
    train = dataclasses.replace(base.train, total_steps=options.steps, evaluate_every=20)
    resume = (folder / "config.json").exists()
    return resolve(dataclasses.replace(base, seed=seed, out=str(folder), resume=resume, train=train))


def setting(options: Options, cell: str) -> tuple[World, Params]:
    """The world of a cell and its parameters: those of the training, but for who walks there and how many."""
    scene, people = CELLS[cell]
    config = preset("quick").world
    world = {field.name: getattr(config, field.name) for field in dataclasses.fields(WorldConfig)}
    world |= {"scenes": (scene,), "people": people}
    params = config.params
    if scene == RECORDING:
        world |= {"recording": options.recording, "pedestrians": options.pedestrians}
        params = params.replace(crowd_size=float(options.crowd))
    return World(WorldConfig(**world)), params


def plays(options: Options, cell: str, policies: list) -> list[EpisodeSummary]:
    """The results of each robot's episodes, `[episodes]`."""
    world, params = setting(options, cell)
    evaluator = Evaluator(world, params, BLOCK)
    summaries = [evaluator.summaries(policy, whole(options.episodes), options.seed) for policy in policies]
    return [EpisodeSummary(*(leaf[0] for leaf in summary)) for summary in summaries]


def whole(episodes: int) -> int:
    """Episodes as they are played, in whole blocks."""
    return math.ceil(episodes / BLOCK) * BLOCK


def row(cell: str, played: list[EpisodeSummary]) -> dict[str, Any]:
    """The row of a cell in the results."""
    scene, people = CELLS[cell]
    return {
        "suite": "people", "scene": scene, "method": people, "budget": "trained", "seeds": list(range(len(played))),
        "episodes": len(played[0].arrived), "arrived": packed([one.arrived for one in played]),
        "hit_pedestrian": packed([one.hit_pedestrian for one in played]),
        "timeout": [float(one.truncated.mean()) for one in played],
        "comfort": [float(one.comfortable_steps.sum() / one.steps.sum()) for one in played],
    }  # fmt: skip


def run(options: Options) -> dict:
    """Train and play what is missing, and write both files."""
    console = study.console()
    identity = {
        "episodes": whole(options.episodes), "seed": options.seed, "steps": options.steps, "robots": options.robots,
        "pedestrians": options.pedestrians, "crowd": options.crowd, "recording": fingerprint(options.recording),
        "configs": [identity_of(configuration(options, seed)) for seed in range(options.robots)],
        "embeddings": default_table().fingerprint,
    }  # fmt: skip
    begun = study.Study(PROGRAM, options.out, identity, CELLS)
    cells = [cell for cell, (scene, _) in CELLS.items() if scene != RECORDING or options.recording]
    for cell in cells:
        if CELLS[cell][0] == RECORDING:
            try:
                setting(options, cell)
            except ValueError as error:
                raise UserError(str(error)) from None
    gone = [seed for seed in range(options.robots) if not (options.runs / f"quick-{seed}" / "config.json").exists()]
    if begun.missing(cells) and gone:
        begun.drop(list(begun.rows))  # of trainings that are gone: the plays of a robot are of one training
    if begun.missing(cells):
        policies = []
        for seed in range(options.robots):
            trained, actor = study.trained(configuration(options, seed), f"robot {seed}", console)
            policies.append(trained.policy_of(actor))
        for cell in begun.missing(cells):
            begun.add(cell, row(cell, plays(options, cell, policies)))
            console.print(f"{cell}: success {_share(begun.rows[cell], 'arrived')}")
    return begun.finish(table)


def identity_of(config: RunConfig) -> dict:
    """The part of a configuration on which the training depends."""
    return {name: part for name, part in to_json(config).items() if name not in ("out", "resume")}


def fingerprint(path: str) -> str:
    """The hash of a recording, none of no recording. UserError: it can't be read."""
    if not path:
        return ""
    try:
        return hashlib.sha256(pathlib.Path(path).read_bytes()).hexdigest()
    except OSError as error:
        raise UserError(f"--recording is {path}: {error.strerror}: give a file in the ETH format") from None


def _share(row, field):
    """A proportion over all robots' episodes with its Wilson interval, as text."""
    counts = np.concatenate(unpacked(row[field], row["episodes"]))
    low, high = wilson_interval(int(counts.sum()), counts.size)
    return f"{counts.mean():.3f} ({low:.3f}-{high:.3f})"


def table(result: dict) -> str:
    """The result as Markdown: a row for each scene and model of people."""
    rows = result["rows"]
    lines = [
        f"Robots of the preset quick, trained for {result['steps'] * 256:,} environment steps in the parity suite "
        f"among one ORCA pedestrian ({result['robots']} training seeds), played among other people: "
        f"{result['episodes']:,} episodes each, episode seed {result['seed']}, test phrases. In the recording's scene "
        f"{result['crowd']} simulated people stroll at 0.5 m/s, or up to {result['pedestrians']} recorded ones walk as "
        "they walked, at their own speed, deaf and mute. Shares are of all robots' episodes, with Wilson's 95 % "
        "interval as if these were independent; the difference is of the same robots in the same episodes' starts, "
        f"with its interval over seeds. {study.sources(rows.values())}",
        "",
        "| scene | people | success | human collisions | time-outs | comfort | success beside ORCA people |",
        "|---|---|---|---|---|---|---|",
    ]
    for cell, one in rows.items():
        base = rows.get(f"{one['scene']}/{TRAINED_ON}")
        beside = "-"
        if base is not None and base is not one:
            found = pair(one, base)
            interval = found["seeds_ci95"]
            beside = f"{found['difference']:+.3f}" + (
                f" ({interval[0]:+.3f} to {interval[1]:+.3f})" if interval else ""
            )
        lines.append(
            f"| {one['scene']} | {CELLS[cell][1]} | {_share(one, 'arrived')} | {_share(one, 'hit_pedestrian')} | "
            f"{np.mean(one['timeout']):.3f} | {np.mean(one['comfort']):.3f} | {beside} |"
        )
    return "\n".join(lines) + "\n"


def main(arguments=None) -> None:
    """Entry point."""
    study.main(Options, run, table, PROGRAM, arguments)


if __name__ == "__main__":
    main()
