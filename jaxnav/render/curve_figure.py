"""The learning curve of a run, drawn with matplotlib from the lines of its metrics.jsonl."""

import itertools
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.lines import Line2D
from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter, StrMethodFormatter

from . import palette
from .words import scene_title

_DPI = 150
Lines = Sequence[dict[str, Any]]

_THRESHOLD = 0.95  # the success rate at which a scene counts as learned


def learning_curve(lines: Lines, path: str | Path) -> Figure:
    """Draw success, losses, entropies and temperatures of a run; write a PNG to ``path``.

    lines: the dicts of metrics.jsonl in order: updates, wall_seconds, critic_loss, actor_loss, twist_entropy,
    request_entropy, twist_temperature, request_temperature, success (scene -> rate in recent training or None) and, on
    some lines, evaluation (scene -> rate). A value may be missing or None. ValueError: no lines.
    """
    if not lines:
        raise ValueError("metrics.jsonl holds no line: train before drawing a learning curve")
    layout = ConstrainedLayoutEngine(w_pad=0.1, h_pad=0.1, wspace=0.03, hspace=0.06, rect=(0, 0, 0.985, 1))
    figure = Figure(figsize=(12, 7.2), dpi=_DPI, facecolor="white", layout=layout)
    canvas = FigureCanvasAgg(figure)
    grid = figure.add_gridspec(2, 4, height_ratios=(1.35, 1))
    updates = _column(lines, "updates")
    success = figure.add_subplot(grid[0, :])
    handles = _draw_success(success, lines, updates)
    # Outside: success rises early and then stays near 1, or it doesn't; no corner is free for certain.
    figure.legend(handles=handles, loc="outside upper center", ncols=len(handles), frameon=False, fontsize=10)
    below = [figure.add_subplot(grid[1, i]) for i in range(4)]
    blue, orange = palette.ROBOT, palette.PEDESTRIAN
    _draw_measures(below[0], lines, updates, "Critic loss", {"critic_loss": ("critic", "#3C3F45")})
    _draw_measures(below[1], lines, updates, "Actor loss", {"actor_loss": ("actor", "#3C3F45")})
    _draw_measures(
        below[2], lines, updates, "Entropy (nats)",
        {"twist_entropy": ("twist", blue), "request_entropy": ("request", orange)}, logarithmic=False,
    )  # fmt: skip
    _draw_measures(
        below[3], lines, updates, "Temperature",
        {"twist_temperature": ("twist", blue), "request_temperature": ("request", orange)},
    )  # fmt: skip
    for axes in (success, *below):
        axes.set_xlabel("updates")
        axes.set_xlim(*_span(updates))
        axes.xaxis.set_major_locator(MaxNLocator(8 if axes is success else 3, integer=True, steps=(1, 2, 5, 10)))
        axes.xaxis.set_major_formatter(StrMethodFormatter("{x:,.0f}"))
        axes.grid(color="#E3E6EA", linewidth=0.8)
        axes.set_axisbelow(True)
        axes.spines[["top", "right"]].set_visible(False)
    canvas.draw()
    _draw_seconds(success, updates, _column(lines, "wall_seconds"))
    figure.savefig(path, format="png")
    return figure


def _column(lines: Lines, name: str) -> np.ndarray:
    """Values of a metric `[lines]`, NaN where there is none."""
    return np.array([np.nan if line.get(name) is None else line[name] for line in lines], float)


def _span(updates: np.ndarray) -> tuple[float, float]:
    """Limits of the axis of updates, with room for a single line."""
    seen = updates[np.isfinite(updates)]
    high = max(seen.max(initial=0.0), 1.0)
    return -0.02 * high, 1.02 * high


def _draw_success(axes: Axes, lines: Lines, updates: np.ndarray) -> list[Line2D]:
    """The large panel. Returns handles for the legend."""
    recent, tested = ([line.get(kind) or {} for line in lines] for kind in ("success", "evaluation"))
    names = list(dict.fromkeys(name for rates in (*recent, *tested) for name in rates))
    colours = palette.scene_colours(names)
    axes.axhline(_THRESHOLD, color=palette.FAINT_INK, linestyle="--", linewidth=1.2)
    handles = []
    for name, marker in zip(names, itertools.cycle("os^Dv"), strict=False):
        rates = _column(recent, name)
        axes.plot(updates, rates, color=colours[name], linewidth=1.2, alpha=0.8, **_lone_mark(rates))
        style = {"color": colours[name], "marker": marker, "markersize": 8, "markeredgecolor": "white"}
        axes.plot(updates, _column(tested, name), linestyle="none", **style)
        handles.append(Line2D([], [], linewidth=1.2, label=scene_title(name), **style))
    grey = "#5A5F68"
    handles += [
        Line2D([], [], color=grey, linewidth=1.2, label="training, recent episodes"),
        Line2D([], [], color=grey, linestyle="none", marker="o", markersize=8, label="evaluation"),
    ]
    axes.set_ylim(-0.03, 1.05)
    axes.set_yticks([0.0, 0.25, 0.5, 0.75, _THRESHOLD], ["0", "0.25", "0.50", "0.75", f"{_THRESHOLD}"])
    axes.set_ylabel("success")
    return handles


def _draw_measures(
    axes: Axes,
    lines: Lines,
    updates: np.ndarray,
    title: str,
    measures: dict[str, tuple[str, str]],
    logarithmic: bool = True,
) -> None:
    """Curves of one panel. measures: metric -> (label, colour). Logarithmic where positive and not all alike."""
    values = {name: _column(lines, name) for name in measures}
    seen = np.concatenate(list(values.values()))
    seen = seen[np.isfinite(seen)]
    measures = {name: style for name, style in measures.items() if np.isfinite(values[name]).any()}
    for name, (label, colour) in measures.items():
        axes.plot(updates, values[name], color=colour, linewidth=1.5, label=label, **_lone_mark(values[name]))
    if not len(seen):
        axes.text(0.5, 0.5, "not recorded", transform=axes.transAxes, ha="center", va="center", color=palette.FAINT_INK)
        axes.set_yticks([])
    elif logarithmic and seen.min() > 0 and seen.max() > 3 * seen.min():
        axes.set_yscale("log")
        axes.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5) if seen.max() < 300 * seen.min() else (1,)))
        axes.yaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
        axes.yaxis.set_minor_formatter(NullFormatter())
    if len(measures) > 1 and len(seen):
        axes.legend(frameon=False, fontsize=9, loc="best", handlelength=1.5)
    axes.set_title(title, size=11, loc="left")


def _lone_mark(values: np.ndarray) -> dict[str, Any]:
    """The style that shows a line through a single value, which is invisible otherwise."""
    return {"marker": ".", "markersize": 7} if np.isfinite(values).sum() == 1 else {}


def _draw_seconds(axes: Axes, updates: np.ndarray, seconds: np.ndarray) -> None:
    """A second axis on top: the wall time of each update."""
    known = np.isfinite(updates) & np.isfinite(seconds)
    top = axes.secondary_xaxis("top")
    top.set_xlabel("wall time (s)")
    if not known.any():
        top.set_xticks([])
        return
    updates, seconds = updates[known], np.maximum.accumulate(seconds[known])
    low, high = axes.get_xlim()
    positions, labels = [], []
    ticks = [seconds[0]] if len(seconds) == 1 else MaxNLocator(8).tick_values(seconds[0], seconds[-1])
    for tick in ticks:
        # No curve is known outside the recorded times, and many seconds may pass between two updates.
        if not seconds[0] <= tick <= seconds[-1]:
            continue
        position = np.interp(tick, seconds, updates)
        if not positions or position - positions[-1] > 0.05 * (high - low):
            positions.append(position)
            labels.append(f"{tick:,.0f}")
    top.set_xticks(positions, labels)
