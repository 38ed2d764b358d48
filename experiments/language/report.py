"""The numbers, Markdown and picture of the result of understanding.py."""

import math

import numpy as np

from experiments import study
from jaxnav.language.phrases import KINDS, SPLITS
from jaxnav.statistics import paired_difference, unpacked
from jaxnav.training import TrainConfig
from jaxnav.world.types import MESSAGES

# What a robot hears in an episode: the messages themselves, or phrases: split, share garbled, norm of the noise.
HEARD = {
    "messages": None, "train phrases": ("train", 0.1, 0.0), "test phrases": ("test", 0.0, 0.0),
    **{f"noise {noise}": ("test", 0.0, noise) for noise in (0.5, 1.0, 1.5)},
    **{f"garbled {share}": ("test", share, 0.0) for share in (0.5, 1.0)},
}  # fmt: skip
MAIN = ("messages", "train phrases", "test phrases")


def rates(result, scene, robot, heard, field="success"):
    """Rates `[seeds]` of a robot in a scene, by what it hears."""
    found = [play[field] for key, play in result["rows"].items() if key.split("/")[1:4] == [scene, robot, heard]]
    return np.array(found)


def swept(result, scene):
    """Success of the first seed in a scene with test phrases, by sweep; the first entry is without any."""
    sweeps = ["test phrases", *(heard for heard in HEARD if heard not in MAIN)]
    return {heard: rates(result, scene, "phrases", heard)[0] for heard in sweeps}


def scenes(result):
    """(suite, scene) of everything played."""
    return list(dict.fromkeys(tuple(key.split("/")[:2]) for key in result["rows"]))


def paired(result, scene, one, other):
    """(difference of success, half its 95 % interval over episodes) of two ways to hear.

    All seeds play the same episodes: what varies from one to the next is their mean.
    """
    ours, theirs = [], []
    for key, play in result["rows"].items():
        suite, name, robot, heard, seed = key.split("/")
        if (name, robot, heard) == (scene, "phrases", one):
            play_other = result["rows"]["/".join((suite, name, robot, other, seed))]
            ours += unpacked(play["arrived"], play["episodes"])
            theirs += unpacked(play_other["arrived"], play["episodes"])
    found = paired_difference(np.array(ours), np.array(theirs))
    return found["difference"], found["ci95_half"]


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
        f"{result['embeddings']}. {study.sources(result['rows'].values())} Our scenes are not the paper's.",
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
        "| suite | scene | the messages themselves | train phrases | test phrases | test - messages, paired | deaf |",
        f"|{'---|' * 7}",
    ]  # fmt: skip
    for suite, scene in scenes(result):
        row = []
        for robot, heard in (*(("phrases", heard) for heard in MAIN), ("deaf", "messages")):
            success = rates(result, scene, robot, heard)
            if not success.size:
                row.append("-")
                continue
            hit = rates(result, scene, robot, heard, "human_collision")
            row.append(f"{success.mean():.3f} ± {spread(success):.3f} ({hit.mean():.3f})")
        mean, half = paired(result, scene, "test phrases", "messages")
        row.insert(3, f"{100 * mean:+.2f} ± {100 * half:.2f} points")
        lines.append(f"| {suite} | {scene} | {' | '.join(row)} |")
    for suite in dict.fromkeys(suite for suite, _ in scenes(result)):
        names, row = [scene for of, scene in scenes(result) if of == suite], []
        for robot, heard in (*(("phrases", heard) for heard in MAIN), ("deaf", "messages")):
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
        ("phrases", "messages", "the messages themselves", palette.FAINT_INK),
        ("phrases", "train phrases", "train phrases", palette.LASER),
        ("phrases", "test phrases", "test phrases", palette.ROBOT),
        ("deaf", "messages", "deaf", palette.PEDESTRIAN),
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
