"""Success outside of the world of training: other people, noise, crowds and delay.

python -m experiments.robustness --help
"""

import dataclasses
import math
import pathlib

import jax
import jax.numpy as jnp
import numpy as np

from experiments import study
from jaxnav import preset
from jaxnav.language.table import default_table
from jaxnav.statistics import wilson_interval
from jaxnav.training import play_block, resolve, to_json

PROGRAM = "robustness"
BLOCK = 500  # episodes of a scene played at once
ROBOTS = ("plain", "robust")
# Of each axis the field of `Params`, what to call it, and its values; the others stay as in `_usual`.
AXES = {
    "awareness": ("awareness of the robot (m)", (0.0, 0.25, 0.5, 1.0, 1.5, 2.0)),
    "preferred_speed": ("walking speed (m/s)", (0.3, 0.5, 0.7, 0.9, 1.1, 1.4)),
    "compliance": ("share who agree to a request", (0.0, 0.25, 0.5, 0.75, 1.0)),
    "scan_noise_std": ("noise of a range (m)", (0.0, 0.02, 0.05, 0.1, 0.2)),
    "scan_dropout": ("share of beams lost", (0.0, 0.05, 0.1, 0.2, 0.4)),
    "crowd_size": ("pedestrians", (1, 2, 3, 4, 6, 8)),
    "control_latency": ("delay of control (steps of 0.4 s)", (0, 1, 2)),
}


@dataclasses.dataclass(frozen=True)
class Options:
    """Train a plain and a robust robot, and play both where pedestrians, laser or control differ from their training.

    The robust one is the preset of that name: its episodes draw all of that at random. Both train on the parity suite
    for as many steps. Writes robustness.json, .md and .png; what is trained or played already is not done again.

    Args:
        episodes: of each scene, robot and value; rounded up to 500.
        steps: of training, of 256 episodes.
        seed: of the episodes, the same for both; training has not seen them.
        runs: folder of the trainings.
        out: folder of the results.
    """

    episodes: int = 1000
    steps: int = 1000
    seed: int = 7
    runs: pathlib.Path = pathlib.Path("runs/robustness")
    out: pathlib.Path = study.RESULTS

    def __post_init__(self):
        study.check_numbers(self, ("episodes", 1, 1_000_000), ("steps", 25, 100_000))
        study.check_multiples(self, ("steps", 25))
        study.check_seed(self.seed)


def configuration(options, robot):
    """The `RunConfig` of a robot."""
    base, folder = preset("quick" if robot == "plain" else "robust"), options.runs / robot
    train = dataclasses.replace(base.train, total_steps=options.steps, evaluate_every=20)
    resume = (folder / "config.json").exists()
    return resolve(dataclasses.replace(base, out=str(folder), resume=resume, train=train))


def player(run):
    """A function (actor, params, seed, episodes) -> arrived `[scenes, episodes]` in the world of the robust preset.

    Where nothing is randomised that world is the plain one's: noise, crowds and delay are then those of ``params``.
    """
    world = preset("robust").world.world()
    limit = math.ceil(float(run.params.max_steps))

    @jax.jit
    def block(policy, params, seed, first):
        return play_block(world, params, policy, seed, first, BLOCK, limit=limit).arrived

    def arrived(actor, params, seed, episodes):
        params = jax.tree.map(jnp.float32, params)
        blocks = [block(run.policy_of(actor), params, np.uint32(seed), first) for first in range(0, episodes, BLOCK)]
        return np.concatenate(jax.device_get(blocks), axis=1)

    return arrived


def run(options: Options) -> dict:
    """Train and play what is missing, and write all three files."""
    console, episodes = study.console(), math.ceil(options.episodes / BLOCK) * BLOCK
    identity = {
        "episodes": episodes, "seed": options.seed, "steps": options.steps,
        "configs": {robot: _identity(configuration(options, robot)) for robot in ROBOTS},
        "embeddings": default_table().fingerprint,
    }  # fmt: skip
    cells = [(name, value) for name, (_, values) in AXES.items() for value in values]
    keys = {robot: {f"{robot}/{name}/{value}": (name, value) for name, value in cells} for robot in ROBOTS}
    begun = study.Study(PROGRAM, options.out, identity, [key for robot in ROBOTS for key in keys[robot]])
    arrived = None
    for robot in ROBOTS:
        if not begun.missing(keys[robot]):
            continue
        if not (options.runs / robot / "config.json").exists():
            begun.drop(keys[robot])  # of a training that is gone: the plays of a robot are of one training
        run, actor = study.trained(configuration(options, robot), robot, console)
        names = [scene.name for scene in run.world.scenes]
        for key in begun.missing(keys[robot]):
            name, value = keys[robot][key]
            arrived = arrived or player(run)
            params = _usual().replace(**{name: value})
            params = params.replace(max_speed=max(params.max_speed, params.preferred_speed))
            success = arrived(actor, params, options.seed, episodes).mean(axis=1)
            begun.add(key, {"success": dict(zip(names, map(float, success), strict=True))})
            console.print(f"{key}: {success.round(4)}")
    return begun.finish(table, draw)


def _usual():
    """`Params` of the plain robot's training, with its one pedestrian."""
    return preset("quick").world.params.replace(crowd_size=1.0, scan_noise_std=0.0, scan_dropout=0.0)


def _identity(config):
    whole = to_json(config)
    return {name: part for name, part in whole.items() if name not in ("out", "resume")}


def mean_and_interval(result, robot, name, value):
    """Success over the scenes of the suite, and its Wilson interval over all their episodes."""
    rates = list(result["rows"][f"{robot}/{name}/{value}"]["success"].values())
    trials = len(rates) * result["episodes"]
    return float(np.mean(rates)), wilson_interval(round(float(np.mean(rates)) * trials), trials)


def table(result):
    """The result as Markdown."""
    rows = result["rows"]
    scenes = list(next(iter(rows.values()))["success"])
    lines = [
        "Success of a plain and of a robust robot in the parity suite, one training seed each, "
        f"{result['steps'] * 256:,} environment steps; {result['episodes']:,} episodes a scene and value, episode seed "
        f"{result['seed']}, test phrases. The robust one is the preset of that name: all of these were drawn anew for "
        "each of its episodes. Everything but the field named is as in the plain robot's training: one pedestrian, a "
        f"laser without noise, no delay. {study.sources(rows.values())} Our scenes are not the paper's.",
    ]  # fmt: skip
    for name, (label, values) in AXES.items():
        lines += [
            "", f"**{label}** (`{name}`)", "",
            f"| | {' | '.join(f'{robot}: mean (95 % interval)' for robot in ROBOTS)} | "
            f"{' | '.join(f'{robot}: {scene}' for robot in ROBOTS for scene in scenes)} |",
            f"|{'---|' * (1 + len(ROBOTS) * (1 + len(scenes)))}",
        ]  # fmt: skip
        for value in values:
            means = []
            for robot in ROBOTS:
                mean, (low, high) = mean_and_interval(result, robot, name, value)
                means.append(f"{mean:.3f} ({low:.3f}-{high:.3f})")
            each = [f"{rows[f'{robot}/{name}/{value}']['success'][scene]:.3f}" for robot in ROBOTS for scene in scenes]
            lines.append(f"| {value} | {' | '.join(means + each)} |")
    return "\n".join(lines) + "\n"


def draw(result, path):
    """A panel an axis: mean success of both robots with intervals, and where training was."""
    from matplotlib.figure import Figure

    from jaxnav.render import palette

    figure = Figure(figsize=(13, 6.2), layout="constrained")
    axes = figure.subplots(2, 4, sharey=True).ravel()
    ranges = {name: (low, high) for name, low, high in preset("robust").world.randomise}
    usual = _usual()
    colours = {"plain": palette.PEDESTRIAN, "robust": palette.ROBOT}
    for panel, (name, (label, values)) in zip(axes, AXES.items(), strict=False):
        low, high = ranges[name]
        panel.axvspan(low, high, color=palette.ROBOT, alpha=0.07, linewidth=0, label="robust: trained here")
        panel.axvline(getattr(usual, name), color=palette.PEDESTRIAN, linestyle=":", label="plain: trained here")
        for robot in ROBOTS:
            found = [mean_and_interval(result, robot, name, value) for value in values]
            means = np.array([mean for mean, _ in found])
            spread = np.abs(np.array([interval for _, interval in found]).T - means)
            panel.errorbar(
                values, means, spread, color=colours[robot], marker="o", markersize=4, label=robot, capsize=2
            )
        panel.set_xlabel(label)
        panel.grid(axis="y", color=palette.OUTSIDE)
        panel.spines[["top", "right"]].set_visible(False)
    axes[len(AXES)].axis("off")
    axes[len(AXES)].legend(*axes[0].get_legend_handles_labels(), loc="center", frameon=False)
    for panel in axes[::4]:
        panel.set_ylabel("success, mean of three scenes")
    figure.savefig(path, dpi=150)


def main(arguments=None):
    """Entry point."""
    study.main(Options, run, table, PROGRAM, arguments)


if __name__ == "__main__":
    main()
