"""The worth of words: a planner that uses the dialogue beside its deaf and its muted twin, in every scene.

python -m experiments.planning.value_of_dialogue --help
"""

import dataclasses
import math
import pathlib

from experiments import study
from jaxnav import SCENES, SUITES, OrcaRobot, Planner, StraightLine, World, WorldConfig
from jaxnav.training import Evaluator, scene_metrics
from jaxnav.world import default_params

PROGRAM = "planning.value_of_dialogue"
BLOCK = 1000  # episodes played at once
PLAYERS = {
    "planner": Planner(),
    "deaf": Planner(hears=False),
    "muted": Planner(speaks=False),
    "deaf and muted": Planner(hears=False, speaks=False),
    "ORCA": OrcaRobot(),
    "straight line": StraightLine(),
}
ROBOTS = tuple(PLAYERS)


@dataclasses.dataclass(frozen=True)
class Options:
    """Play scripted robots in every scene and write what their words are worth.

    Writes value_of_dialogue.json, .md and .png. A scene that the JSON file holds already is not played again: an
    interrupted study goes on where it was.

    Args:
        scenes: scenes to play; all of them if none is named.
        episodes: of each robot in each scene; rounded up to thousands.
        seed: of the episodes, the same for all robots.
        out: folder of the results.
    """

    scenes: tuple[str, ...] = ()
    episodes: int = 10_000
    seed: int = 0
    out: pathlib.Path = study.RESULTS

    def __post_init__(self):
        study.check_names(self.scenes, "--scenes", SCENES)
        study.check_numbers(self, ("episodes", 1, 1_000_000))
        study.check_seed(self.seed)


def play_scene(name, episodes, seed, advance):
    """`metrics` of every robot in one scene, by name."""
    pedestrians = (SCENES[name].crowd or (1, 1))[1]
    world = World(WorldConfig(scenes=(name,), pedestrians=pedestrians))
    evaluator, rows = Evaluator(world, default_params((name,)), BLOCK), {}
    for robot, player in PLAYERS.items():
        rows[robot] = scene_metrics(world, evaluator.summaries(player, episodes, seed))[name]
        advance()
    return rows


def run(options: Options) -> dict:
    """Play what is missing, and write all three files."""
    episodes = math.ceil(options.episodes / BLOCK) * BLOCK
    identity = {"episodes": episodes, "seed": options.seed}
    begun = study.Study(PROGRAM, options.out, identity, SCENES)
    for name in begun.missing(options.scenes or SCENES):
        with study.progress(study.console(), len(ROBOTS), name) as advance:
            begun.add(name, {"robots": play_scene(name, episodes, options.seed, advance)})
    return begun.finish(table, draw)


def table(result):
    """The result as Markdown."""
    lines = [
        f"Success of scripted robots, {result['episodes']:,} episodes a scene, seed {result['seed']}; 95 % Wilson "
        f"intervals are in the JSON file. {study.sources(result['rows'].values())}", "",
        f"| scene | {' | '.join(ROBOTS)} | hearing is worth | speaking is worth |", f"|{'---|' * (len(ROBOTS) + 3)}",
    ]  # fmt: skip
    for name, scene in result["rows"].items():
        success = {robot: row["success"] for robot, row in scene["robots"].items()}
        worth = [round(100 * (success["planner"] - success[twin]), 1) + 0.0 for twin in ("deaf", "muted")]
        cells = [*(f"{success[robot]:.3f}" for robot in ROBOTS), *(f"{points:+.1f} points" for points in worth)]
        lines.append(f"| {name} | {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def draw(result, path):
    """Success of every robot, a panel a suite, with intervals."""
    from matplotlib.figure import Figure

    from jaxnav.render import palette

    suites = [names for names in SUITES.values() if any(name in result["rows"] for name in names)]
    figure = Figure(figsize=(4.2 * len(suites), 3.6), layout="constrained")
    colours = dict(
        zip(
            ROBOTS,
            (palette.GOAL, palette.LASER, palette.ROBOT, palette.ENCOUNTER, palette.PEDESTRIAN, palette.FAINT_INK),
            strict=True,
        )
    )
    for axes, names in zip(figure.subplots(1, len(suites), sharey=True, squeeze=False)[0], suites, strict=True):
        names = [name for name in names if name in result["rows"]]
        for k, robot in enumerate(ROBOTS):
            rows = [result["rows"][name]["robots"][robot] for name in names]
            heights = [row["success"] for row in rows]
            spread = [
                [h - row["success_ci95"][0] for h, row in zip(heights, rows, strict=True)],
                [row["success_ci95"][1] - h for h, row in zip(heights, rows, strict=True)],
            ]
            at = [i + (k - 2.5) * 0.14 for i in range(len(names))]
            axes.bar(
                at,
                heights,
                0.13,
                yerr=spread,
                color=colours[robot],
                label=robot,
                ecolor=palette.INK,
                error_kw={"lw": 0.8},
            )
        axes.set_xticks(range(len(names)), [name.replace("-", "\n") for name in names])
        axes.set_ylim(0.0, 1.0)
        axes.spines[["top", "right"]].set_visible(False)
        axes.grid(axis="y", color=palette.OUTSIDE)
        axes.set_axisbelow(True)
    first = figure.axes[0]
    first.set_ylabel("success")
    figure.legend(*first.get_legend_handles_labels(), loc="outside upper center", ncols=len(ROBOTS), frameon=False)
    figure.savefig(path, dpi=150)


def main(arguments=None):
    """Entry point."""
    study.main(Options, run, table, PROGRAM, arguments)


if __name__ == "__main__":
    main()
