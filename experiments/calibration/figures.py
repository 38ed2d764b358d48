"""The figures of the two calibrations, drawn from what their JSON files say."""

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from jaxnav.render import palette

from .comparison import CALIBRATED, CONSTANT_VELOCITY

_DPI = 200
_TITLES = {
    "preferred_speed": "preferred speed",
    "awareness": "awareness",
    "time_horizon": "time horizon",
    "radius": "radius",
}
_COLOURS = {
    CONSTANT_VELOCITY: palette.INK,
    "constant velocity, mean of all observed": palette.FAINT_INK,
    "ORCA, defaults of the world": "#CC79A7",
    "ORCA, CrowdNav's values, own velocity": "#E69F00",
    "calibrated, avoiding nobody": palette.LASER,
    CALIBRATED: palette.ROBOT,
}
_DASHED = ("constant velocity, mean of all observed", "calibrated, avoiding nobody")


def recovery(result, path):
    """A panel a parameter: how the start with the lowest loss of each truth descends to it. Writes a PNG."""
    figure = _figure(10, 3.3)
    panels = figure.subplots(1, len(_TITLES), sharey=True)
    colours = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#6B7078")
    for axes, (name, title) in zip(panels, _TITLES.items(), strict=True):
        axes.axhspan(0.95, 1.05, color="#DDE3EA", linewidth=0)
        for number, row in enumerate(result["truths"]):
            ratio = np.array(row["path"][name]) / row["truth"][name]
            colour = colours[number % len(colours)]
            axes.plot(row["path"]["step"], ratio, color=colour, linewidth=0.6, alpha=0.35)
            axes.plot(row["path"]["step"], ratio[:, row["best"]], color=colour, linewidth=1.5)
        axes.set_title(f"{title}\nlargest error {result['largest_error'][name]:.2%}", fontsize=10)
        axes.set_xlabel("steps of gradient descent")
        _plain(axes)
    panels[0].set_ylabel("fitted / true value")
    panels[0].set_ylim(0.28, 2.6)
    panels[0].set_yscale("log")
    panels[0].set_yticks([0.4, 0.5, 0.7, 1.0, 1.4, 2.0], ["0.4", "0.5", "0.7", "1", "1.4", "2"])
    panels[0].minorticks_off()
    marks = [
        Patch(color="#DDE3EA", label="within 5 %"),
        Line2D([], [], color=palette.INK, linewidth=1.5, label="the start with the lowest loss, a colour a truth"),
        Line2D([], [], color=palette.INK, linewidth=0.6, alpha=0.35, label="other starts"),
    ]
    figure.legend(handles=marks, loc="outside upper center", ncols=3, frameon=False, fontsize=9)
    figure.savefig(path)


def comparison(result, path):
    """Error over the time predicted, ADE and FDE with their intervals, and the errors of each person. Writes a PNG."""
    figure = _figure(13, 4.2)
    curves, table, people = figure.subplots(1, 3, width_ratios=(1.1, 1.25, 1.0))
    _draw_curves(curves, result)
    _draw_table(table, result)
    _draw_people(people, result)
    figure.savefig(path)


def _draw_curves(axes, result):
    for name, (mean, low, high) in result["curves"].items():
        colour = _COLOURS[name]
        axes.plot(result["seconds"], mean, color=colour, linewidth=1.6, linestyle="--" if name in _DASHED else "-")
        axes.fill_between(result["seconds"], low, high, color=colour, alpha=0.12, linewidth=0)
    axes.set_xlim(0, result["seconds"][-1])
    # The world's own walkers are far slower than these people: their error leaves the panel.
    axes.set_ylim(0, 1.2 * max(result["curves"][CONSTANT_VELOCITY][2]))
    axes.set_xlabel("time predicted (s)")
    axes.set_ylabel("displacement error (m)")
    axes.set_title("(a) mean over held-out people, 95 % interval", fontsize=10)
    _plain(axes)


def _draw_table(axes, result):
    names = list(result["predictors"])[::-1]
    for kind, marker, shift in (("ade", "o", 0.13), ("fde", "D", -0.13)):
        for row, name in enumerate(names):
            mean, low, high = result["predictors"][name][kind]
            axes.errorbar(
                mean, row + shift, xerr=[[mean - low], [high - mean]], color=_COLOURS[name], marker=marker,
                markersize=5, capsize=2, linewidth=1.2,
            )  # fmt: skip
            axes.annotate(f"{mean:.2f}", (high, row + shift), (4, -3), textcoords="offset points", fontsize=8)
        axes.plot([], [], color=palette.INK, marker=marker, linestyle="none", label=kind.upper())
    axes.set_yticks(range(len(names)), [name.replace(", ", ",\n") for name in names], fontsize=9)
    axes.set_xscale("log")
    axes.set_xticks([0.5, 1, 2, 4], ["0.5", "1", "2", "4"])
    axes.minorticks_off()
    axes.set_xlim(right=7)
    axes.set_xlabel("error (m)")
    axes.set_title(f"(b) mean over {result['people']['held_out']} people, 95 % interval", fontsize=10)
    axes.legend(frameon=False, fontsize=9, loc="lower right")
    _plain(axes)


def _draw_people(axes, result):
    baseline, calibrated = (np.array(result["held_out_ade"][name]) for name in (CONSTANT_VELOCITY, CALIBRATED))
    limit = 1.05 * max(baseline.max(), calibrated.max())
    axes.plot([0, limit], [0, limit], color=palette.FAINT_INK, linewidth=0.8)
    axes.scatter(baseline, calibrated, s=14, color=_COLOURS[CALIBRATED], alpha=0.6, linewidth=0)
    better = np.mean(calibrated < baseline)
    axes.set_xlim(0, limit)
    axes.set_ylim(0, limit)
    axes.set_aspect("equal")
    axes.set_xlabel("ADE of constant velocity (m)")
    axes.set_ylabel("ADE of calibrated ORCA (m)")
    axes.set_title(f"(c) {better:.0%} of people are predicted better", fontsize=10)
    _plain(axes)


def _figure(width, height):
    figure = Figure(figsize=(width, height), dpi=_DPI, facecolor="white", layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def _plain(axes):
    axes.grid(color="#E3E6EA", linewidth=0.7)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
