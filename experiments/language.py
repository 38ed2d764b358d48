"""What people's words are worth to a learnt robot: how well it understands them, and what a misunderstanding costs.

python experiments/language.py --help
"""

import dataclasses
import json
import math
import pathlib
import sys
import time

import cells
import jax
import jax.numpy as jnp
import numpy as np
import scene_study
import tyro
from rich.console import Console

from jaxnav.errors import UserError
from jaxnav.language.phrases import KINDS, SPLITS
from jaxnav.language.table import default_table
from jaxnav.language.vocabulary import vocabulary
from jaxnav.training.config import PRESETS, TrainConfig, resolve, to_json
from jaxnav.training.evaluation import make_policy, wilson_interval
from jaxnav.training.provenance import provenance
from jaxnav.training.run import Interrupted, Run
from jaxnav.world.types import LEFT, MESSAGES, RIGHT

PROGRAM = "language"
# What a robot hears in an episode: the messages themselves, or phrases: split, share garbled, norm of the noise.
HEARD = {
    "codes": None, "train phrases": ("train", 0.1, 0.0), "test phrases": ("test", 0.0, 0.0),
    **{f"noise {noise}": ("test", 0.0, noise) for noise in (0.5, 1.0, 1.5)},
    **{f"garbled {share}": ("test", share, 0.0) for share in (0.5, 1.0)},
}  # fmt: skip
MAIN = ("codes", "train phrases", "test phrases")


@dataclasses.dataclass(frozen=True)
class Options:
    """Train robots that hear phrases and deaf ones, play them, and write how well they understand and arrive.

    Writes language.json, .md and .png. Trainings and plays that are there already are not done again: an interrupted
    study goes on where it was.

    Args:
        seeds: robots of each kind in the hard suite; in the parity suite, which saturates, at most two.
        episodes: of each scene, in pairs with test phrases and with codes, shared by the seeds; deaf robots and those
            that hear train phrases play a quarter of it, each sweep a tenth, with the first seed.
        steps: of training, of all episodes.
        seed: of the episodes that are played, the same for all robots.
        runs: folder of the trainings.
        out: folder of the results.
        only_train: train, and play later.
    """

    seeds: int = 5
    episodes: int = 10_000
    steps: int = 600
    seed: int = 7
    runs: pathlib.Path = pathlib.Path("runs/language")
    out: pathlib.Path = scene_study.RESULTS
    only_train: bool = False

    def __post_init__(self):
        for name, least, most in (("seeds", 1, 100), ("episodes", cells.BLOCK, 1_000_000), ("steps", 25, 100_000)):
            if not least <= getattr(self, name) <= most:
                raise UserError(f"--{name} is {getattr(self, name)}: give a whole number from {least} to {most}")
        if self.steps % TrainConfig.steps_per_chunk:
            raise UserError(f"--steps is {self.steps}: give a multiple of {TrainConfig.steps_per_chunk}")
        if not 0 <= self.seed < 2**32:
            raise UserError(f"--seed is {self.seed}: give a whole number from 0 to {2**32 - 1}")

    def seeds_of(self, suite):
        """How many robots of each kind a suite has."""
        return min(self.seeds, 2) if suite == "parity" else self.seeds


def trainings(options):
    """(suite, robot, seed) of every robot: in the parity suite, where people can be seen in time, none is deaf."""
    kinds = (("hard", "phrases"), ("hard", "deaf"), ("parity", "phrases"))
    return [(*kind, seed) for seed in range(options.seeds) for kind in kinds if seed < options.seeds_of(kind[0])]


def shares(options, suite, robot, seed):
    """{what is heard: episodes of each scene} of a robot, in blocks."""
    seeds = options.seeds_of(suite)
    if robot == "deaf":
        parts = {"codes": 1 / (4 * seeds)}
    else:
        parts = {"codes": 1 / seeds, "test phrases": 1 / seeds, "train phrases": 1 / (4 * seeds)}
        if seed == 0:
            parts |= {heard: 0.1 for heard in HEARD if heard not in MAIN}
    return {heard: math.ceil(part * options.episodes / cells.BLOCK) * cells.BLOCK for heard, part in parts.items()}


def configuration(options, suite, robot, seed):
    """The `RunConfig` of a robot."""
    base, folder = PRESETS["quick"], options.runs / f"{suite}-{robot}-{seed}"
    agent, world = base.agent, base.world
    if robot == "deaf":
        agent, world = dataclasses.replace(agent, language="codes"), dataclasses.replace(world, hearing=False)
    return resolve(
        dataclasses.replace(
            base, scene="all" if suite == "parity" else suite, seed=seed, out=str(folder), agent=agent, world=world,
            resume=(folder / "config.json").exists(), train=dataclasses.replace(base.train, total_steps=options.steps),
        )
    )  # fmt: skip


def trained(options, suite, robot, seed, console):
    """(run, actor) of a robot, trained now if it isn't yet."""
    run = Run(configuration(options, suite, robot, seed))
    run.prepare_folder()
    start, name = time.monotonic(), f"{suite} {robot} {seed}"

    def report(line):
        if "evaluation" in line:
            success = ", ".join(f"{scene} {rate:.3f}" for scene, rate in line["evaluation"].items())
            console.print(f"{name}: {line['env_steps'] / 1000:.0f}k steps, {success}", soft_wrap=True)

    progress = run.train(report, start)
    return run, run.actor(progress, "last")


def understanding(run, actor):
    """Predicted message `[N]`, its probability `[N]` and the predicted reply `[N]` of every phrase of the table."""
    words = jnp.asarray(default_table().vectors())
    message, reply = jax.device_get(run.agent.understand(actor, words))
    return message.argmax(axis=-1), np.exp(message.max(axis=-1)), reply.argmax(axis=-1)


def accuracy(predictions):
    """Share of phrases understood, by split and kind, confusion: `[meant, understood]` on the test split."""
    phrases = default_table().phrases
    meant = np.array([phrase.message for phrase in phrases])
    split = np.array([phrase.split for phrase in phrases])
    kind = np.array([phrase.kind for phrase in phrases])
    reply = np.array([phrase.reply for phrase in phrases])
    result = {}
    for name in SPLITS:
        here = split == name
        right = np.array([understood[here] == meant[here] for understood, _, _ in predictions])
        mixed = [np.isin(u, (RIGHT, LEFT)) & np.isin(meant, (RIGHT, LEFT)) & (u != meant) for u, _, _ in predictions]
        replies = here & (kind == "reply")
        result[name] = {
            "phrases": int(here.sum()), "patterns": len({p.pattern for p in phrases if p.split == name}),
            "overall": float(right.mean()), "per_seed": right.mean(axis=1).tolist(),
            "ci95": wilson_interval(round(float(right.mean()) * here.sum()), int(here.sum())),
            "left_right_confused": float(np.mean([m[here].mean() for m in mixed])),
            "reply": float(np.mean([(r[replies] == reply[replies]).mean() for _, _, r in predictions])),
            "kinds": {k: float(right[:, kind[here] == k].mean()) for k in KINDS},
        }  # fmt: skip
    test = split == "test"
    confusion = np.zeros((len(MESSAGES), len(MESSAGES)))
    for understood, _, _ in predictions:
        np.add.at(confusion, (meant[test], understood[test]), 1 / len(predictions))
    return result | {"confusion": confusion.tolist()}


class Player:
    """Plays robots of a suite through two compiled programs, whatever they hear."""

    def __init__(self, run):
        self._codes, self._words = (
            cells.Player(run.world, run.params, policy) for policy in (cells.told(run.agent), make_policy(run.agent))
        )

    def __call__(self, actor, heard, scene, episodes, seed):
        """(arrived, hit a pedestrian), bool `[episodes]` each."""
        if HEARD[heard] is None:
            played = self._codes((actor, True, None), scene, seed, episodes)
        else:
            split, share, noise = HEARD[heard]
            played = self._words((actor, True, vocabulary(split, share, noise)), scene, seed, episodes)
        return played.arrived, played.hit_pedestrian


def study(options):
    """Train and play what is missing, and write all three files."""
    scene_study.make_folder(options.out)
    console = Console(stderr=True)
    path = options.out / f"{PROGRAM}.json"
    identity = {
        "command": f"python experiments/{PROGRAM}.py", "seeds": options.seeds, "episodes": options.episodes,
        "steps": options.steps, "seed": options.seed, "phrases": default_table().phrases_hash,
        "embeddings": default_table().encoder,
    }  # fmt: skip
    result = {**identity, **provenance(), "plays": {}}
    if path.exists():
        try:
            before = json.loads(path.read_text())
            if {name: before[name] for name in identity} == identity:
                result["plays"] = before["plays"]
        except (ValueError, KeyError, TypeError) as error:
            raise UserError(f"{path} is no result of this program ({error!r}): move it away") from None
    robots = {key: trained(options, *key, console) for key in trainings(options)}
    result["configs"] = {
        f"{suite} {robot}": to_json(run.config) for (suite, robot, seed), (run, _) in robots.items() if seed == 0
    }
    if options.only_train:
        return None
    predictions = [understanding(*robot) for (_, kind, _), robot in robots.items() if kind == "phrases"]
    result["accuracy"] = accuracy(predictions)
    players = {}
    for (suite, robot, seed), (run, actor) in robots.items():
        if (suite, robot) not in players:
            players[suite, robot] = Player(run)
        for scene, one in enumerate(run.world.scenes):
            for heard, episodes in shares(options, suite, robot, seed).items():
                key = f"{suite}/{one.name}/{robot}/{heard}/{seed}"
                if key in result["plays"]:
                    continue
                arrived, hit = players[suite, robot](actor, heard, scene, episodes, options.seed)
                result["plays"][key] = {
                    "episodes": episodes, "success": float(arrived.mean()), "human_collision": float(hit.mean()),
                    # Which episodes failed: what pairs are made of.
                    "failed": np.flatnonzero(~arrived).tolist(),
                }  # fmt: skip
                console.print(f"{key}: {arrived.mean():.4f}")
                _write(path, result)
    _write(path, result)
    path.with_suffix(".md").write_text(table(result))
    draw(result, path.with_suffix(".png"))
    return result


def _write(path, result):
    whole = path.with_suffix(".new")
    whole.write_text(json.dumps(result) + "\n")
    whole.replace(path)  # an interruption leaves the old file or the new one


def rates(result, scene, robot, heard, field="success"):
    """Rates `[seeds]` of a robot in a scene, by what it hears."""
    found = [play[field] for key, play in result["plays"].items() if key.split("/")[1:4] == [scene, robot, heard]]
    return np.array(found)


def swept(result, scene):
    """Success of the first seed in a scene with test phrases, by sweep; the first entry is without any."""
    sweeps = ["test phrases", *(heard for heard in HEARD if heard not in MAIN)]
    return {heard: rates(result, scene, "phrases", heard)[0] for heard in sweeps}


def scenes(result):
    """(suite, scene) of everything played."""
    return list(dict.fromkeys(tuple(key.split("/")[:2]) for key in result["plays"]))


def paired(result, scene, one, other):
    """(difference of success, half its 95 % interval) of two ways to hear, over the episodes of all seeds."""
    differences = []
    for key, play_one in result["plays"].items():
        suite, name, robot, heard, seed = key.split("/")
        if (name, robot, heard) != (scene, "phrases", one):
            continue
        play_other = result["plays"]["/".join((suite, name, robot, other, seed))]
        difference = np.zeros(play_one["episodes"])
        difference[play_one["failed"]] -= 1
        difference[play_other["failed"]] += 1
        differences.append(difference)
    differences = np.concatenate(differences)
    return differences.mean(), 1.96 * differences.std() / math.sqrt(differences.size)


def spread(values):
    """Half the 95 % interval of a mean over seeds (Student's t)."""
    from scipy.stats import t

    if len(values) < 2:
        return math.nan
    return float(t.ppf(0.975, len(values) - 1) * values.std(ddof=1) / math.sqrt(len(values)))


def table(result):
    """The result as Markdown."""
    found, seeds = result["accuracy"], result["seeds"]
    lines = [
        f"Robots trained for {result['steps'] * TrainConfig.episodes:,} steps, {seeds} seeds of each kind; "
        f"{result['episodes']:,} episodes a scene, episode seed {result['seed']}. Embeddings: "
        f"{result['embeddings']}. Device: {result['device']}; commit {result['git_commit']}. Our scenes are not the "
        "paper's.",
        "", "**Messages understood** (mean over the robots that hear; validation and test: sentence patterns never "
        "heard in training)", "",
        f"| split | phrases | patterns | overall (95 % interval) | {' | '.join(KINDS)} | sides confused | reply |",
        f"|{'---|' * (len(KINDS) + 6)}",
    ]  # fmt: skip
    for split in SPLITS:
        row = found[split]
        low, high = row["ci95"]
        kinds = " | ".join(f"{row['kinds'][kind]:.3f}" for kind in KINDS)
        lines.append(
            f"| {split} | {row['phrases']} | {row['patterns']} | {row['overall']:.3f} ({low:.3f}-{high:.3f}) | "
            f"{kinds} | {row['left_right_confused']:.3f} | {row['reply']:.3f} |"
        )
    lines += [
        "", "**Success** (mean over seeds, half a 95 % interval over seeds; in brackets the share of episodes in which "
        "somebody is hit)", "",
        "| suite | scene | one-hot codes | train phrases | test phrases | test - codes, paired | deaf |",
        f"|{'---|' * 7}",
    ]  # fmt: skip
    for suite, scene in scenes(result):
        row = []
        for robot, heard in (*(("phrases", heard) for heard in MAIN), ("deaf", "codes")):
            success = rates(result, scene, robot, heard)
            if not success.size:
                row.append("-")
                continue
            hit = rates(result, scene, robot, heard, "human_collision")
            row.append(f"{success.mean():.3f} ± {spread(success):.3f} ({hit.mean():.3f})")
        mean, half = paired(result, scene, "test phrases", "codes")
        row.insert(3, f"{100 * mean:+.2f} ± {100 * half:.2f} points")
        lines.append(f"| {suite} | {scene} | {' | '.join(row)} |")
    for suite in dict.fromkeys(suite for suite, _ in scenes(result)):
        names, row = [scene for of, scene in scenes(result) if of == suite], []
        for robot, heard in (*(("phrases", heard) for heard in MAIN), ("deaf", "codes")):
            means = [rates(result, scene, robot, heard) for scene in names]
            success = np.mean(means, axis=0) if means[0].size else means[0]
            row.append(f"{success.mean():.3f} ± {spread(success):.3f}" if success.size else "-")
        row.insert(3, "")
        lines.append(f"| {suite} | mean of its scenes | {' | '.join(row)} |")
    sweeps = [heard for heard in HEARD if heard not in MAIN]
    lines += [
        "", "**Sweeps** of the first seed with test phrases: success with noise of that norm on the unit vectors, and "
        "with that share of the phrases garbled by speech recognition", "",
        f"| scene | test phrases | {' | '.join(sweeps)} |", f"|{'---|' * (len(sweeps) + 2)}",
    ]  # fmt: skip
    for _, scene in scenes(result):
        row = [f"{success:.3f}" for success in swept(result, scene).values()]
        lines.append(f"| {scene} | {' | '.join(row)} |")
    return "\n".join(lines) + "\n"


def draw(result, path):
    """Confusion of messages, accuracy by kind, success by what is heard, and the sweep of noise."""
    from matplotlib.figure import Figure

    from jaxnav.render import palette

    figure = Figure(figsize=(13, 8), layout="constrained")
    (confusion, kinds), (success, noise) = figure.subplots(2, 2, width_ratios=[1, 1.8])
    counts = np.array(result["accuracy"]["confusion"])
    shares = counts / counts.sum(axis=1, keepdims=True)
    confusion.imshow(shares, cmap="Blues", vmin=0, vmax=1)
    for i, j in np.ndindex(shares.shape):
        confusion.text(
            j, i, f"{shares[i, j]:.3f}", ha="center", va="center", color="white" if shares[i, j] > 0.5 else palette.INK
        )
    names = [message.removeprefix("robot ") for message in MESSAGES]
    confusion.set_xticks(range(len(names)), names)
    confusion.set_yticks(range(len(names)), names)
    confusion.set_xlabel("understood")
    confusion.set_ylabel("meant")
    confusion.set_title("Test phrases: what is understood", fontsize=10)

    for k, split in enumerate(SPLITS):
        row = result["accuracy"][split]["kinds"]
        kinds.bar(np.arange(len(KINDS)) + (k - 1) * 0.27, [row[kind] for kind in KINDS], 0.25, label=split,
                  color=(palette.OUTSIDE, palette.LASER, palette.ROBOT)[k], ec=palette.FAINT_INK, lw=0.5)  # fmt: skip
    kinds.set_xticks(range(len(KINDS)), [kind.replace(" ", "\n", 1) for kind in KINDS], fontsize=8)
    kinds.set_ylim(0.6, 1.005)
    kinds.set_title("Messages understood, by kind", fontsize=10)
    kinds.legend(framealpha=1.0, ncols=3, loc="lower left")

    places = scenes(result)
    bars = (
        ("phrases", "codes", "one-hot codes", palette.FAINT_INK),
        ("phrases", "train phrases", "train phrases", palette.LASER),
        ("phrases", "test phrases", "test phrases", palette.ROBOT),
        ("deaf", "codes", "deaf", palette.PEDESTRIAN),
    )
    for k, (robot, heard, label, colour) in enumerate(bars):
        at, heights, errors = [], [], []
        for i, (_, scene) in enumerate(places):
            found = rates(result, scene, robot, heard)
            if found.size:
                at.append(i + (k - 1.5) * 0.2)
                heights.append(found.mean())
                errors.append(spread(found))
        success.bar(at, heights, 0.18, yerr=errors, color=colour, label=label, error_kw={"lw": 0.8})
    success.set_xticks(range(len(places)), [scene for _, scene in places], rotation=30, ha="right", fontsize=8)
    success.set_ylim(0.4, 1.02)
    success.set_title("Success, by what is heard", fontsize=10)
    success.legend(framealpha=1.0, fontsize=8, ncols=2, loc="lower right")

    norms = {"test phrases": 0.0, **{heard: HEARD[heard][2] for heard in HEARD if heard.startswith("noise")}}
    for _, scene in places:
        success_of = swept(result, scene)
        noise.plot(norms.values(), [success_of[heard] for heard in norms], marker="o", ms=3, label=scene,
                   color=palette.scene_colours([scene])[scene])  # fmt: skip
    noise.set_xlabel("norm of the noise on the embedding of what is said (its own norm is 1)")
    noise.set_title("Success under noise, test phrases, first seed", fontsize=10)
    noise.legend(frameon=False, fontsize=8, ncols=4, loc="center")
    for axes in (kinds, success, noise):
        axes.spines[["top", "right"]].set_visible(False)
        axes.grid(axis="y", color=palette.OUTSIDE)
        axes.set_axisbelow(True)
    figure.savefig(path, dpi=130)


def main(arguments=None):
    """Entry point; exits with 2 after an error that the user can mend."""
    try:
        options = tyro.cli(Options, args=arguments, prog=f"python experiments/{PROGRAM}.py")
        result = study(options)
    except UserError as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(2)
    except (Interrupted, KeyboardInterrupt):
        print("interrupted; the same command goes on", file=sys.stderr)
        sys.exit(130)
    if result is not None:
        print(table(result), end="")


if __name__ == "__main__":
    main()
