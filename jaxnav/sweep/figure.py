"""The picture of a sweep: importance, values of the good trials, learning curves, and the confirmation."""

import textwrap
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import ListedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.lines import Line2D
from matplotlib.ticker import LogLocator, MaxNLocator, PercentFormatter, StrMethodFormatter

from ..render import palette
from .numbers import name_of, number
from .progress import is_measured
from .results import Results, Trial

Summary = dict[str, Any]

_WINNER = palette.PEDESTRIAN
_FAINT = "#B4B9C0"
_GRID = "#E3E6EA"


def figure_of(results: Results, summary: Summary) -> Figure:
    """A `Figure` that is 1600 pixels wide. summary: of `report.summarise`, of the same results."""
    rows = len(summary["confirmed"])
    height = 9.8 + max(0.0, 0.22 * (rows - 12))
    layout = ConstrainedLayoutEngine(w_pad=0.12, h_pad=0.12, wspace=0.03, hspace=0.04)
    figure = Figure(figsize=(12.8, height), dpi=125, facecolor="white", layout=layout)
    FigureCanvasAgg(figure)
    halves: Any = figure.subfigures(2, 1, height_ratios=(5, height - 5))
    importance, parallel = halves[0].subplots(1, 2, width_ratios=(1, 4))
    curves, confirmed = halves[1].subplots(1, 2, width_ratios=(1.5, 1))
    colours = _colours(summary, [trial.score for trial in _coloured(results)])
    _draw_importance(importance, summary["importance"])
    _draw_parallel(parallel, results, summary, colours)
    _draw_curves(curves, results, summary, colours)
    _draw_confirmed(confirmed, summary)
    for axes in (importance, curves, confirmed):
        axes.spines[["top", "right"]].set_visible(False)
        axes.set_axisbelow(True)
    return figure


def _known(results: Results) -> list[Trial]:
    """Trials of the search with an objective."""
    return [trial for trial in results.phases.get("search", ()) if is_measured(trial)]


def _coloured(results: Results) -> list[Trial]:
    """Complete trials; before there is one, the running ones."""
    states = {trial.state for trial in _known(results)}
    return [t for t in _known(results) if t.state == ("complete" if "complete" in states else "running")]


def _colours(summary: Summary, objectives: Sequence[float]) -> ScalarMappable:
    """The colour of an objective, the best the darkest."""
    low, high = (min(objectives), max(objectives)) if objectives else (0.0, 1.0)
    name = "viridis_r" if summary["direction"] == "maximize" else "viridis"
    # Without the palest tenth, which can't be seen on white.
    pale = colormaps[name](np.linspace(0.1, 1, 256) if name.endswith("_r") else np.linspace(0, 0.9, 256))
    return ScalarMappable(Normalize(low, high if high > low else low + 1e-3), ListedColormap(pale))


def _nothing(axes: Axes, text: str) -> None:
    axes.text(0.5, 0.5, textwrap.fill(text, 28), transform=axes.transAxes, ha="center", va="center",
              color=palette.FAINT_INK)  # fmt: skip
    axes.set_xticks([])
    axes.set_yticks([])
    axes.spines[:].set_visible(False)


def _short(names: Sequence[str]) -> dict[str, str]:
    """The last part of each dotted name, or the whole name where two end alike."""
    last = [name.rpartition(".")[2] for name in names]
    return {name: short if last.count(short) == 1 else name for name, short in zip(names, last, strict=True)}


def _wrapped(name: str, width: int) -> str:
    """A name in lines, broken after underscores and dots."""
    lines = [""]
    for part in name.replace("_", "_ ").replace(".", ". ").split():
        if lines[-1] and len(lines[-1] + part) > width:
            lines.append("")
        lines[-1] += part
    return "\n".join(lines)


def _draw_importance(axes: Axes, found: dict[str, Any]) -> None:
    axes.set_title("What mattered", loc="left", size=11)
    if found["shares"] is None:
        _nothing(axes, f"Not known: {found['why']}")
        return
    short = _short(list(found["shares"]))
    names, shares = [_wrapped(short[name], 18) for name in found["shares"]], list(found["shares"].values())
    axes.barh(range(len(names)), shares, height=0.65, color=palette.ROBOT)
    for y, share in enumerate(shares):
        axes.text(share + 0.02 * max(shares), y, f"{share:.0%}", va="center", size=9)
    axes.set_yticks(range(len(names)), names, size=9)
    axes.set_ylim(max(len(names), 3) - 0.4, -0.6)
    axes.set_xlim(0, 1.2 * max(shares))
    axes.xaxis.set_major_locator(MaxNLocator(3))
    axes.xaxis.set_major_formatter(PercentFormatter(1, 0))
    axes.set_xlabel("share of importance")
    axes.tick_params(axis="y", length=0)


class _Axis:
    """The axis of a searched float: the height of a value, from 0 to 1, and its labels."""

    def __init__(self, found: dict[str, Any], values: Sequence[float]) -> None:
        self.log, low, high = found["log"], found["low"], found["high"]
        values = [value for value in values if value > 0 or not self.log]
        self.low, self.high = min([low, *values]), max([high, *values])

    def __call__(self, value: Any) -> float:
        low, high = self._scaled(self.low), self._scaled(self.high)
        return float(np.clip((self._scaled(max(value, self.low)) - low) / (high - low), 0, 1))

    def _scaled(self, value: float) -> float:
        return np.log(value) if self.log else value

    def ticks(self) -> list[tuple[Any, str]]:
        """(value, label) each."""
        if self.log:
            ticks = LogLocator(subs=(1,) if self.high > 300 * self.low else (1, 2, 5)).tick_values(self.low, self.high)
        else:
            ticks = MaxNLocator(5).tick_values(self.low, self.high)
        return [(tick, f"{tick:.6g}") for tick in ticks if self.low * (1 - 1e-9) <= tick <= self.high * (1 + 1e-9)]


class _Sizes:
    """The axis of a static size: its choices at equal distances."""

    def __init__(self, choices: Sequence[Any], values: Sequence[Any]) -> None:
        plain = [_label(value) for value in (*choices, *values)]
        self._places = {text: i for i, text in enumerate(dict.fromkeys(plain))}
        self._choices = list(dict.fromkeys(plain))

    def __call__(self, value: Any) -> float:
        return 0.5 if len(self._places) == 1 else self._places[_label(value)] / (len(self._places) - 1)

    def ticks(self) -> list[tuple[Any, str]]:
        return [(text, text) for text in self._choices]


def _label(value: Any) -> str:
    return " ".join(map(str, value)) if isinstance(value, tuple | list) else str(value)


def _draw_parallel(axes: Axes, results: Results, summary: Summary, colours: ScalarMappable) -> None:
    axes.set_title("Trials of the search, a line each, the best the darkest", loc="left", size=11)
    trials, identity = _known(results), results.identity
    ways = [row["values"] for row in (summary["winner"], *summary["confirmed"][:1]) if row]
    scales = {
        name: kind(found, [values[name] for values in (*(t.values for t in trials), *ways) if name in values])
        for kind, part in ((_Sizes, "sizes"), (_Axis, "space"))
        for name, found in identity[part].items()
    }

    def line(values: dict[str, Any]) -> list[tuple[float, float]]:
        return [(x, scale(values[name])) for x, (name, scale) in enumerate(scales.items())]

    coloured = _coloured(results)
    numbers = {trial.number for trial in coloured}
    others = [line(trial.values) for trial in trials if trial.number not in numbers]
    axes.add_collection(LineCollection(others, colors=_FAINT, linewidths=0.8, alpha=0.4))
    coloured.sort(key=lambda t: t.score, reverse=summary["direction"] == "minimize")  # the best above the others
    shades = colours.to_rgba(np.array([trial.score for trial in coloured]))
    width, alpha = (1.4, 0.9) if len(coloured) < 60 else (0.9, 0.6)
    lines = [line(trial.values) for trial in coloured]
    axes.add_collection(LineCollection(lines, colors=shades, linewidths=width, alpha=alpha))
    handles = [
        Line2D([], [], color=_FAINT, lw=1, label="stopped, broken or not yet complete"),
        *_draw_ways(axes, summary, line),
    ]
    _draw_scales(axes, scales)
    axes.legend(handles=handles, loc="upper center", bbox_to_anchor=(0.5, -0.02), ncols=3, frameon=False, fontsize=9)
    if coloured:
        bar = axes.figure.colorbar(colours, ax=axes, pad=0.01, aspect=30)
        bar.set_label(summary["objective"])
        bar.outline.set_visible(False)


def _draw_ways(axes: Axes, summary: Summary, line: Callable[[dict[str, Any]], Any]) -> list[Line2D]:
    """The lines of base and of the winner. Returns their handles."""
    ways = [(row["values"], palette.INK, "--", "base") for row in summary["confirmed"][:1] if row["trial"] is None]
    winner = summary["winner"]
    if winner and winner["trial"] is not None:
        ways.append((winner["values"], _WINNER, "-", f"{name_of(winner['trial'])}, the winner"))
    handles = []
    for values, colour, style, label in ways:
        handles += axes.plot(*zip(*line(values), strict=True), style, color=colour, lw=2.6, label=label, zorder=5)
    return handles


def _draw_scales(axes: Axes, scales: dict[str, _Axis | _Sizes]) -> None:
    short, width = _short(list(scales)), max(11, 90 // len(scales))
    for x, (name, scale) in enumerate(scales.items()):
        axes.vlines(x, 0, 1, palette.INK, lw=1, zorder=6)
        axes.text(x, 1.04, _wrapped(short[name], width), ha="center", va="bottom", size=9)
        for value, text in scale.ticks():
            y = scale(value)
            axes.plot([x, x + 0.012 * len(scales)], [y, y], color=palette.INK, lw=1, zorder=6)
            axes.text(x + 0.018 * len(scales), y, text, size=8, va="center", zorder=7,
                      bbox={"boxstyle": "square,pad=0.1", "fc": "white", "ec": "none", "alpha": 0.75})  # fmt: skip
    axes.set_xlim(-0.06 * len(scales), len(scales) - 1 + 0.07 * len(scales))
    axes.set_ylim(-0.04, 1.2)
    axes.axis("off")


def _draw_curves(axes: Axes, results: Results, summary: Summary, colours: ScalarMappable) -> None:
    axes.set_title("How the trials learnt", loc="left", size=11)
    trials, best = _known(results), {row["trial"] for row in summary["best"] if row["state"] != "stopped"}
    if not trials:
        _nothing(axes, "No trial has been judged yet")
        return
    winner = summary["winner"] and summary["winner"]["trial"]
    handles = {}
    for trial in sorted(trials, key=lambda trial: (trial.number == winner, trial.number in best)):
        if trial.number == winner:
            style = {"color": _WINNER, "lw": 2.6, "label": f"{name_of(winner)}, the winner"}
        elif trial.number in best:
            style = {"color": colours.to_rgba(np.array(trial.score)), "lw": 1.5, "label": "the ten best"}
        else:
            style = {"color": _FAINT, "lw": 0.7, "alpha": 0.6, "label": "the others"}
        points = [(row["env_steps"], row["objective"]) for row in trial.curve if row["objective"] is not None]
        mark = {"marker": ".", "ms": 5} if len(points) == 1 else {}  # which has no line
        (handles[style["label"]],) = axes.plot(*zip(*points, strict=True), **style, **mark)
    for rung in results.identity["rungs"]:
        handles["rungs"] = axes.axvline(
            rung * results.identity["base"]["train"]["episodes"], color=_FAINT, ls=":", lw=1.2, label="rungs"
        )
    axes.legend(handles=list(handles.values())[::-1], frameon=False, fontsize=9, loc="best")
    axes.set_xlabel("environment steps")
    axes.set_ylabel(summary["objective"])
    axes.set_xlim(0, None)
    axes.xaxis.set_major_locator(MaxNLocator(6))
    axes.xaxis.set_major_formatter(StrMethodFormatter("{x:,.0f}"))
    axes.grid(color=_GRID, lw=0.8)


def _draw_confirmed(axes: Axes, summary: Summary) -> None:
    axes.set_title("Confirmed with fresh seeds", loc="left", size=11)
    rows = [row for row in summary["confirmed"] if row["objective"]["mean"] is not None]
    if not rows:
        _nothing(axes, "Nothing was confirmed" if not summary["budget"]["confirm"] else "Nothing is confirmed yet")
        return
    winner = summary["winner"] or {"trial": -1}
    for y, row in enumerate(rows):
        colour = _WINNER if row["trial"] == winner["trial"] else palette.INK if row["trial"] is None else palette.ROBOT
        seeds = [value for value in row["objective"]["per_seed"] if value is not None]
        axes.plot(seeds, np.full(len(seeds), y + 0.2), "o", ms=5, color=colour, alpha=0.4, mec="none")
        if row["objective"]["ci95"]:
            low, high = row["objective"]["ci95"]
            axes.hlines(y, low, high, colour, lw=2.5)
        axes.plot(row["objective"]["mean"], y, "D", ms=7, color=colour, mec="white")
        if row["trial"] is None:
            axes.axvline(row["objective"]["mean"], color=palette.FAINT_INK, ls="--", lw=1, zorder=0)
    names = [name_of(row["trial"]) + " wins" * (row["trial"] == winner["trial"]) for row in rows]
    means = [number(row["objective"]["mean"]) for row in rows]
    labels = [f"{name}   {mean}" for name, mean in zip(names, means, strict=True)]
    axes.set_yticks(range(len(rows)), labels, size=9)
    axes.set_ylim(max(len(rows), 3) - 0.4, -0.7)
    axes.margins(x=0.1)
    axes.xaxis.set_major_locator(MaxNLocator(5))
    axes.set_xlabel(f"{summary['objective']}\ndots: seeds; diamond and line: mean and 95 % interval")
    axes.grid(axis="x", color=_GRID, lw=0.8)
    axes.tick_params(axis="y", length=0)
