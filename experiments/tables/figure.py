"""The picture of a table: success and human collisions of every method, with its seeds and intervals."""

import itertools

import numpy as np

from experiments.tables.report import NAMES, Grid

# The end at which methods differ is drawn larger: each doubling of failures is as long, but below a hundredth.
STRETCHED = {
    "success": (lambda y: -np.log(1.01 - y), lambda z: 1.01 - np.exp(-z)),
    "human_collision": (lambda y: np.log(0.01 + y), lambda z: np.exp(z) - 0.01),
}
TICKS = (0.0, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0)


def draw(result, path):
    """Write `figure_of` a result as a PNG file."""
    figure_of(result).savefig(path, dpi=130)


def figure_of(result):
    """Success and human collisions by scene and method: a column a suite, a pair of rows a budget.

    Artists of a method are labelled "<method> seeds", "<method> mean" and "<method> interval".
    """
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

    from jaxnav.render import palette

    colours = (palette.GOAL, "#E69F00", palette.ENCOUNTER, palette.ROBOT, palette.PEDESTRIAN, palette.LASER)
    grid, fields = Grid.of(result), ("success", "human_collision")
    *budgets, none = grid.methods
    budgets = budgets or [none]  # scripted robots stand beside the learnt ones of every budget
    learnt = grid.methods[budgets[0]] if budgets != [none] else []
    styles = {method: ("o", colours[k % len(colours)], colours[k % len(colours)]) for k, method in enumerate(learnt)}
    styles |= {method: ("Ds^v"[k % 4], palette.FAINT_INK, "white") for k, method in enumerate(grid.methods[none])}
    widths, slot = [len(scenes) for scenes in grid.suites.values()], 1 / (len(styles) + 1)
    width = 2 + max(max(0.2 / slot, 1.2) * sum(widths), 6)
    figure = Figure(figsize=(width, 1 + 5 * len(budgets)), layout="constrained")
    panels = figure.subplots(2 * len(budgets), len(widths), squeeze=False, width_ratios=widths)
    for (i, budget), (j, suite), (k, field) in itertools.product(*map(enumerate, (budgets, grid.suites, fields))):
        axes, scenes = panels[2 * i + k, j], grid.suites[suite]
        for place, (method, (mark, colour, face)) in enumerate(styles.items(), 1):
            rows = {}
            for x, scene in enumerate(scenes):
                row = grid.rows.get((suite, budget, scene, method))
                if row and row[field]["mean"] is not None:
                    rows[x + place * slot - 0.5] = row[field]
                else:
                    axes.text(x + place * slot - 0.5, 0.03, "left out" if row else "not run", rotation=90, fontsize=7,
                              ha="center", color=colour, transform=axes.get_xaxis_transform())  # fmt: skip
            if not rows:
                continue
            x, found = np.array(list(rows)), list(rows.values())
            axes.vlines(x, *np.transpose([row["ci95"] for row in found]), colour, lw=1.5, label=f"{method} interval")
            shape = {"marker": "_", "ms": 14} if method in learnt else {"marker": mark, "ms": 6, "mfc": face}
            axes.plot(x, [row["mean"] for row in found], ls="", mew=1.5, color=colour, label=f"{method} mean", **shape)
            if method in learnt:
                values = [row["per_seed"] for row in found]
                beside = [at + slot * np.linspace(-0.3, 0.3, len(seeds)) for at, seeds in zip(x, values, strict=True)]
                axes.plot(np.concatenate(beside), np.concatenate(values), "o", ms=4, alpha=0.6, mec="none",
                          color=colour, label=f"{method} seeds")  # fmt: skip
        if axes is not panels[k, 0]:
            axes.sharey(panels[k, 0])  # suites and budgets are compared
        axes.set_yscale("function", functions=STRETCHED[field])
        axes.set_yticks(TICKS if field == "human_collision" else [1 - tick for tick in TICKS])
        axes.yaxis.set_major_formatter("{x:g}")
        axes.set_ylim((-0.0012, 1.15) if field == "human_collision" else (-0.15, 1.0012))
        axes.set_xlim(-0.5, len(scenes) - 0.5)
        axes.set_xticks(range(len(scenes)), [scene.replace("-", "\n") for scene in scenes])
        axes.tick_params(axis="x", length=0)
        axes.vlines(np.arange(len(scenes) - 1) + 0.5, 0, 1, palette.OUTSIDE, transform=axes.get_xaxis_transform())
        axes.spines[["top", "right"]].set_visible(False)
        axes.grid(axis="y", color=palette.OUTSIDE)
        axes.set_axisbelow(True)
        axes.set_ylabel("" if j else NAMES[field])
        axes.set_title("" if k else grid.title(suite, budget).replace(", ", "\n", 1), fontsize=10)
    handles = [
        Line2D([], [], marker=mark, color=colour, mfc=face, label=method)
        for method, (mark, colour, face) in styles.items()
    ]
    figure.legend(handles=handles, loc="outside right upper", frameon=False)
    figure.supxlabel(
        "dots: seeds; bars: their mean; open marks: scripted robots; scales are stretched toward no failures\n"
        "lines: 95 % intervals, of the mean over seeds or, of a scripted robot, Wilson's over episodes",
        fontsize=9, color=palette.FAINT_INK,
    )  # fmt: skip
    return figure
