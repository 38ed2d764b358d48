"""Steering by gradient: twist sequences optimised through the world, beside scripted robots, in every scene.

python -m experiments.planning.plan_by_gradient --help
"""

import dataclasses
import functools
import math
import pathlib

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib.figure import Figure

from experiments import study
from experiments.planning.gradient_plans import plan
from jaxnav import SCENES, SUITES, OrcaRobot, Planner, StraightLine, World, WorldConfig
from jaxnav.errors import UserError
from jaxnav.render import palette
from jaxnav.statistics import wilson_interval
from jaxnav.training import episode_keys, play
from jaxnav.world import default_params

PROGRAM = "planning.plan_by_gradient"
BLOCK = 50  # episodes planned at once
PLAN, STARTS = "plan by gradient", "best of its starts"
SCRIPTED = {
    "planner, talking": Planner(),
    "planner, silent and deaf": Planner(hears=False, speaks=False),
    "ORCA": OrcaRobot(),
    "straight line": StraightLine(),
}
ROBOTS = (PLAN, STARTS, *SCRIPTED)


@dataclasses.dataclass(frozen=True)
class Options:
    """Plan episodes by gradient ascent through the world and compare with scripted robots.

    A plan is the sequence of twists of an episode, improved by Adam from several starts: the way an ORCA robot drives,
    and the ways of others that are disturbed, slowly and at random. What it climbs is progress, closeness and margins
    to people and walls, since arrival and collision are jumps without a gradient; of all plans met, the one with the
    highest true return is kept. It looks into a crystal ball: it knows how people decide and every random number of
    the episode, which no robot can, and those who have to be read from the scan as well. And it climbs from where it
    starts: what it reaches, silent steering with that knowledge can reach at least.

    Writes plan_by_gradient.json, .md and .png. A scene that the JSON file holds already is not planned again: an
    interrupted study goes on where it was.

    Args:
        scenes: scenes to plan in; those of the parity and the hard suite if none is named.
        episodes: in each scene.
        starts: of each plan.
        iterations: of Adam from each start.
        steps: length of a plan; a robot that hasn't arrived by then counts as timed out.
        rate: step size of Adam, in units of an action, whose range is [-1, 1].
        seed: of the episodes, the same for all robots, and of the starts.
        out: folder of the results.
    """

    scenes: tuple[str, ...] = ()
    episodes: int = 200
    starts: int = 4
    iterations: int = 100
    steps: int = 60
    rate: float = 0.02
    seed: int = 0
    out: pathlib.Path = study.RESULTS

    def __post_init__(self):
        study.check_names(self.scenes, "--scenes", SCENES)
        limits = ("episodes", 1, 100_000), ("starts", 1, 1000), ("iterations", 1, 100_000), ("steps", 1, 100)
        study.check_numbers(self, *limits)
        study.check_seed(self.seed)
        if not 0 < self.rate <= 1:
            raise UserError(f"--rate is {self.rate}: give a number above 0, at most 1")


@functools.cache
def world_of(name):
    """(world that holds the scene, its index): scenes with as many people share one, and so one compilation."""
    people = _people(name)
    scenes = tuple(scene for scene in SCENES if _people(scene) == people)
    return _world(scenes, people), scenes.index(name)


def _people(name):
    return (SCENES[name].crowd or (1, 1))[1]


@functools.cache
def _world(scenes, people):
    return World(WorldConfig(scenes=scenes, pedestrians=people))


@functools.cache
def programs(world, options):
    """By robot, a function (params, scene, keys `[E]`) -> arrived, collided, hit a person, steps.

    Each `[E]`; for plans `[E, iterations + 1]`, and returns before them.
    """

    def scripted(robot):
        def block(params, scene, keys):
            done = play(world, params, SCRIPTED[robot], keys, jnp.full(keys.shape, scene), options.steps)
            return done.arrived, done.collided, done.hit_pedestrian, done.steps

        return jax.jit(block)

    sizes = options.steps, options.starts, options.iterations, options.rate

    def planned(params, scene, keys):
        return jax.vmap(lambda key: plan(world, params, scene, key, *sizes)[1])(keys)

    return {PLAN: jax.jit(planned), **{robot: scripted(robot) for robot in SCRIPTED}}


def play_scene(name, options, advance):
    """Results of every robot in one scene, by name, and those of the plans by iteration, `[iterations + 1]` each."""
    (world, scene), params = world_of(name), default_params((name,))
    found = {}
    for robot, program in programs(world, dataclasses.replace(options, scenes=(), out=study.RESULTS)).items():
        blocks = []
        for first in range(0, options.episodes, BLOCK):
            keys = episode_keys(options.seed, first + jnp.arange(BLOCK))
            blocks.append(jax.device_get(program(params, jnp.int32(scene), keys)))
            advance()
        found[robot] = [np.concatenate(column)[: options.episodes] for column in zip(*blocks, strict=True)]
    returns, *plans = found[PLAN]
    found |= {STARTS: [column[:, 0] for column in plans], PLAN: [column[:, -1] for column in plans]}
    climb = {"return": returns.mean(axis=0).tolist(), "success": plans[0].mean(axis=0).tolist()}
    return {robot: _row(*found[robot]) for robot in ROBOTS}, climb


def _row(arrived, collided, hit, steps):
    return {
        "success": float(arrived.mean()),
        "success_ci95": wilson_interval(int(arrived.sum()), arrived.size),
        "collision": float(collided.mean()),
        "human_collision": float(hit.mean()),
        "timeout": float((~arrived & ~collided).mean()),
        "steps": float(steps[arrived].mean()) if arrived.any() else None,
    }


def run(options: Options) -> dict:
    """Plan what is missing, and write all three files."""
    settings = {name: getattr(options, name) for name in ("episodes", "starts", "iterations", "steps", "rate", "seed")}
    begun = study.Study(PROGRAM, options.out, {"options": settings}, SCENES)
    blocks = (1 + len(SCRIPTED)) * math.ceil(options.episodes / BLOCK)
    for name in begun.missing(options.scenes or SUITES["parity"] + SUITES["hard"]):
        with study.progress(study.console(), blocks, name) as advance:
            rows, climb = play_scene(name, options, advance)
        begun.add(name, {"robots": rows, "by_iteration": climb})
    return begun.finish(table, draw)


def table(result):
    """The result as Markdown."""
    options = result["options"]
    lines = [
        f"Success of twists planned by gradient ascent through the world ({options['starts']} starts, "
        f"{options['iterations']} iterations, silent, knowing all that will happen), of the best of their starts, and "
        f"of scripted robots. {options['episodes']:,} episodes a scene, at most {options['steps']} steps, seed "
        f"{options['seed']}; 95 % Wilson intervals in brackets. Collisions and time-outs are in the JSON file. "
        f"{study.sources(result['rows'].values())}", "",
        f"| scene | {' | '.join(ROBOTS)} |", f"|{'---|' * (len(ROBOTS) + 1)}",
    ]  # fmt: skip
    for name, scene in result["rows"].items():
        rows = [scene["robots"][robot] for robot in ROBOTS]
        cells = ["{:.3f} ({:.3f}-{:.3f})".format(row["success"], *row["success_ci95"]) for row in rows]
        lines.append(f"| {name} | {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def draw(result, path):
    """Success of every robot with its interval, a panel a suite; and that of the plans by iteration. Writes a PNG."""
    suites = [[name for name in names if name in result["rows"]] for names in SUITES.values()]
    suites = [names for names in suites if names]
    figure = Figure(figsize=(5.5 + 1.7 * sum(map(len, suites)), 4.0), layout="constrained")
    widths = [*map(len, suites), 2]
    *panels, last = figure.subplots(1, len(widths), sharey=True, width_ratios=widths)
    colours = (
        palette.ROBOT, palette.LASER, palette.GOAL, palette.ENCOUNTER, palette.PEDESTRIAN, palette.FAINT_INK,
    )  # fmt: skip
    for axes, names in zip(panels, suites, strict=True):
        for k, (robot, colour) in enumerate(zip(ROBOTS, colours, strict=True)):
            rows = [result["rows"][name]["robots"][robot] for name in names]
            height = np.array([row["success"] for row in rows])
            low, high = np.array([row["success_ci95"] for row in rows]).T
            at = np.arange(len(names)) + (k - 0.5 * (len(ROBOTS) - 1)) * 0.14
            spread = np.maximum([height - low, high - height], 0.0)
            axes.bar(at, height, 0.13, yerr=spread, color=colour, label=robot, error_kw={"lw": 0.8})
        axes.set_xticks(range(len(names)), names)
    colours = palette.scene_colours(result["rows"])
    for name, scene in result["rows"].items():
        last.plot(scene["by_iteration"]["success"], color=colours[name], label=name)
    last.set_xlabel("iterations of gradient ascent")
    last.legend(frameon=False, fontsize=8)
    for axes in (*panels, last):
        axes.set_ylim(0.0, 1.0)
        axes.spines[["top", "right"]].set_visible(False)
        axes.grid(axis="y", color=palette.OUTSIDE)
        axes.set_axisbelow(True)
    panels[0].set_ylabel("success")
    handles = panels[0].get_legend_handles_labels()
    figure.legend(*handles, loc="outside upper center", ncols=len(ROBOTS), frameon=False)
    figure.savefig(path, dpi=150)


def main(arguments=None):
    """Entry point."""
    study.main(Options, run, table, PROGRAM, arguments)


if __name__ == "__main__":
    main()
