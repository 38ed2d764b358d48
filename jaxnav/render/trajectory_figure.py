"""Trajectories of a run's episodes with their times and utterances, drawn with matplotlib."""

import itertools
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import LinearSegmentedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from ..training.rollout import Episode
from ..world import Params, Scene, World
from . import palette
from .labels import along, free_spot
from .words import ending, in_short, scene_title, utterances

_DPI = 150
_SUCCESSES, _FAILURES = 2, 1  # panels a scene
# Violet to green: the yellow end of viridis is lost on white paper.
_TIME_COLOURS = LinearSegmentedColormap.from_list(
    "time", ["#440154", "#414487", "#2A788E", "#22A884", "#7AD151", "#C8D62B"]
)


def trajectories(
    world: World, episodes: Sequence[Episode], path: str | Path, params: Params = Params(), played: int | None = None
) -> Figure:
    """Draw a few `Episode` s of each scene, a row each, successes left and a failure right; write a PNG to ``path``.

    Time is colour. Successes in which the robot asks or a pedestrian speaks are preferred. played: number of episodes
    of a scene from which the given ones were chosen, failures first; by default all are given. ValueError: no episodes.
    """
    rows = [(scene, [e for e in episodes if e.scene == scene.name]) for scene in world.scenes]
    rows = [(scene, own) for scene, own in rows if own]
    if not rows:
        raise ValueError("episodes is empty: give at least one of the world's scenes to draw")
    shown = [_choose(own) for _, own in rows]
    latest = max(len(e.outcomes.arrived) for panels in shown for e in panels if e is not None) * params.dt
    norm = Normalize(0.0, latest)

    limits = [_limits(scene) for scene, _ in rows]
    columns, width = _SUCCESSES + _FAILURES, 3.5
    heights = [width * (high[1] - low[1]) / (high[0] - low[0]) for low, high in limits]
    left, right, top, bottom, gap, between = 1.0, 1.05, 0.72, 1.2, 0.25, 0.62
    total_width = left + columns * width + (columns - 1) * gap + right
    total_height = top + sum(heights) + (len(rows) - 1) * between + bottom
    figure = Figure(figsize=(total_width, total_height), dpi=_DPI, facecolor="white")
    canvas = FigureCanvasAgg(figure)

    panels = []
    y = total_height - top
    for (scene, own), (low, high), height, chosen in zip(rows, limits, heights, shown, strict=True):
        y -= height
        middle = (y + height / 2) / total_height
        figure.text(0.22 / total_width, middle, scene_title(scene.name), rotation=90, size=12, weight="bold",
                    ha="center", va="center", color=palette.scene_colours([scene.name])[scene.name])  # fmt: skip
        for column, episode in enumerate(chosen):
            x = left + column * (width + gap)
            box = (x / total_width, y / total_height, width / total_width, height / total_height)
            axes = figure.add_axes(box, xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
            if episode is None:
                _draw_absence(axes, own, column, played or len(own))
            else:
                panels.append((axes, scene, episode))
                _draw_episode(axes, scene, episode, norm, params)
            axes.tick_params(labelleft=column == 0, labelsize=8, colors=palette.FAINT_INK, length=3)
            axes.xaxis.set_major_locator(MaxNLocator(5, integer=True))
            axes.yaxis.set_major_locator(MaxNLocator(5, integer=True))
            axes.spines[:].set_color("#C9CDD3")
            if column == 0:
                axes.set_ylabel("y (m)", size=8, color=palette.FAINT_INK, labelpad=1)
            if scene is rows[-1][0]:
                axes.set_xlabel("x (m)", size=8, color=palette.FAINT_INK, labelpad=1)
        y -= between

    for name, first, count in (("Successes", 0, _SUCCESSES), ("Failures", _SUCCESSES, _FAILURES)):
        x = left + first * (width + gap) + (count * (width + gap) - gap) / 2
        figure.text(x / total_width, 1 - 0.22 / total_height, name, size=12, weight="bold", ha="center", va="center")
    _draw_time_bar(figure, norm, left + columns * width + (columns - 1) * gap, bottom, top)
    figure.legend(
        handles=_trajectory_legend(), loc="lower center", ncols=4, frameon=False, fontsize=9,
        bbox_to_anchor=((left + total_width - right) / 2 / total_width, 0.05 / total_height), columnspacing=2.0,
    )  # fmt: skip
    canvas.draw()
    for axes, scene, episode in panels:
        _label_speech(axes, scene, episode, world.config.hearing, canvas.get_renderer())
    figure.savefig(path, format="png")
    return figure


def _choose(episodes: Sequence[Episode]) -> list[Episode | None]:
    """The episodes of a scene's panels, None where there is none to show."""
    successes = [e for e in episodes if ending(e) == "arrived"]
    failures = [e for e in episodes if ending(e) != "arrived"]
    chosen: list[Episode] = []
    for speaker in ("robot", "pedestrian"):
        speaking = [e for e in successes if any(said.speaker == speaker for said in utterances(e))]
        chosen += [e for e in speaking if not any(e is other for other in chosen)][:1]
    chosen += [e for e in successes if not any(e is other for other in chosen)]
    chosen = chosen[:_SUCCESSES]
    return [*chosen, *[None] * (_SUCCESSES - len(chosen)), *failures[:_FAILURES], *[None] * (_FAILURES - len(failures))]


def _limits(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """Corners of a scene's panel, metres. A flat one gets room for words above and below."""
    corners = np.concatenate([np.array(chain) for chain in scene.chains])
    low, high = corners.min(axis=0) - 0.3, corners.max(axis=0) + 0.3
    missing = max(0.0, 0.55 * (high[0] - low[0]) - (high[1] - low[1]))
    room = np.array([0.0, missing / 2])
    return low - room, high + room


def _draw_absence(axes: Axes, episodes: Sequence[Episode], column: int, played: int) -> None:
    count = sum(ending(e) == "arrived" for e in episodes)
    kind = "success" if column < _SUCCESSES else "failure"
    number = {0: "no"}.get(count, f"only {count}") if kind == "success" else "no"
    plural = "" if played == 1 else "s"
    text = f"{number} {kind} in\n{played} episode{plural}"
    axes.set_facecolor("#F7F8FA")
    axes.text(0.5, 0.5, text, transform=axes.transAxes, ha="center", va="center", size=11, color=palette.FAINT_INK)


def _draw_episode(axes: Axes, scene: Scene, episode: Episode, norm: Normalize, params: Params) -> None:
    axes.set_facecolor(palette.OUTSIDE)
    for i, chain in enumerate(scene.chains):
        x, y = np.array([*chain, chain[0]]).T
        axes.fill(x, y, facecolor=palette.FLOOR if i == 0 else palette.OUTSIDE, zorder=0)
        axes.plot(x, y, color=palette.WALL, linewidth=2.0, zorder=1, solid_joinstyle="miter")
    robot, walkers = episode.states.robot, episode.states.pedestrians
    time = np.arange(len(robot.x)) * params.dt
    for i in episode.present:
        there = walkers.present[:, i]
        x, y = walkers.x[there, i], walkers.y[there, i]
        axes.scatter(x, y, c=time[there], cmap=_TIME_COLOURS, norm=norm, s=9, linewidths=0, zorder=3)
        axes.plot(x[0], y[0], **_MARKERS["pedestrian's start"], zorder=4)
    points = np.stack([robot.x, robot.y], axis=-1)
    line = LineCollection(
        list(np.stack([points[:-1], points[1:]], axis=1)), cmap=_TIME_COLOURS, norm=norm, linewidths=3, capstyle="round"
    )
    line.set_array(time[:-1])
    line.set_zorder(3)
    axes.add_collection(line, autolim=False)
    axes.plot(*points[0], **_MARKERS["robot's start"], zorder=4)
    axes.plot(robot.goal_x[0], robot.goal_y[0], **_MARKERS["robot's goal"], zorder=4)
    end = ending(episode)
    if end == "collision":
        axes.plot(*points[-1], **_MARKERS["collision"], zorder=6)
    whom = " with pedestrian" if end == "collision" and episode.outcomes.hit_pedestrian[-1] else ""
    whom = " with wall" if end == "collision" and not whom else whom
    title = f"{end or 'cut off'}{whom}, {time[-1]:.1f} s"
    axes.set_title(title, size=10, color=palette.ENDINGS.get(end, palette.FAINT_INK), pad=4)


_MARKERS: dict[str, dict[str, Any]] = {
    "robot's start": {"marker": "o", "markersize": 8, "color": palette.ROBOT, "markeredgecolor": "white"},
    "pedestrian's start": {"marker": "o", "markersize": 6, "color": palette.PEDESTRIAN, "markeredgecolor": "white"},
    "robot's goal": {"marker": "*", "markersize": 13, "color": palette.GOAL, "markeredgecolor": "white"},
    "robot asks": {"marker": "D", "markersize": 7, "color": palette.ROBOT, "markeredgecolor": "white"},
    "robot hears": {"marker": "s", "markersize": 7, "color": palette.PEDESTRIAN, "markeredgecolor": "white"},
    "collision": {"marker": "X", "markersize": 10, "color": palette.COLLISION, "markeredgecolor": "white"},
}


def _trajectory_legend() -> list[Line2D]:
    grey = "#5A5F68"
    return [
        Line2D([], [], color=grey, linewidth=3, label="robot's path"),
        Line2D([], [], color=grey, linestyle="none", marker="o", markersize=3, label="pedestrian's path"),
        *(Line2D([], [], linestyle="none", label=label, **style) for label, style in _MARKERS.items()),
    ]


def _draw_time_bar(figure: Figure, norm: Normalize, left: float, below: float, above: float) -> None:
    """The colour bar to the right of the panels. left, below, above: inches that they and their margins take."""
    width, height = figure.get_size_inches()
    length = min(3.5, height - below - above)
    middle = below + (height - below - above) / 2
    axes = figure.add_axes(((left + 0.22) / width, (middle - length / 2) / height, 0.14 / width, length / height))
    bar = figure.colorbar(ScalarMappable(norm, _TIME_COLOURS), cax=axes)
    bar.set_label("time (s)", size=10)
    bar.ax.tick_params(labelsize=9)
    bar.outline.set_visible(False)


def _label_speech(axes: Axes, scene: Scene, episode: Episode, hearing: bool, renderer: Any) -> None:
    """Mark the robot's place at each utterance, and write the utterance on the nearest free spot."""
    robot, walkers = episode.states.robot, episode.states.pedestrians
    to_pixels, to_data = axes.transData.transform, axes.transData.inverted().transform
    unit = renderer.points_to_pixels(1.0)
    lines = [
        np.stack([robot.x, robot.y], axis=-1),
        *(np.stack([walkers.x[:, i], walkers.y[:, i]], axis=-1)[walkers.present[:, i]] for i in episode.present),
    ]
    lines += [np.array([*chain, chain[0]]) for chain in scene.chains]
    ink = np.concatenate([along(to_pixels(line)) for line in lines])
    groups = [(t, list(group)) for t, group in itertools.groupby(utterances(episode), key=lambda said: said.t)]
    marks: list[Any] = [(robot.x[t], robot.y[t]) for t, _ in groups]
    taken = [_box(to_pixels(point), 7 * unit) for point in [*marks, (robot.goal_x[0], robot.goal_y[0])]]
    words = []
    for mark, (_, group) in zip(marks, groups, strict=True):
        speakers = {said.speaker for said in group}
        if "pedestrian" in speakers:
            axes.plot(*mark, **_MARKERS["robot hears"], zorder=5)
        if "robot" in speakers:
            # Both in one step: the smaller diamond lies on the square.
            style: dict[str, Any] = _MARKERS["robot asks"] | ({"markersize": 5} if len(speakers) > 1 else {})
            axes.plot(*mark, **style, zorder=5)
        colour = palette.INK if len(speakers) > 1 else {"robot": palette.ROBOT, "pedestrian": "#A84600"}[speakers.pop()]
        label = "\n".join(dict.fromkeys(in_short(said, hearing) for said in group))
        text = axes.text(0, 0, label, size=9, color=colour, ha="center", va="center", zorder=7, linespacing=1.1)
        extent = text.get_window_extent(renderer)
        half = np.array([extent.width, extent.height]) / 2 + 2 * unit
        anchor = to_pixels(mark)
        centre = free_spot(anchor, half, axes.get_window_extent(renderer).extents, taken, words, ink, unit)
        x, y = to_data(centre)
        text.set_position((x, y))
        # The leader ends at the edge of the words.
        edge = centre + (anchor - centre) / max(np.abs((anchor - centre) / half).max(), 1.0)
        x, y = to_data(np.array([anchor, edge])).T
        axes.plot(x, y, color=colour, linewidth=0.8, zorder=4)
        taken.append(_box(centre, half))
        words.append(taken[-1])
        ink = np.concatenate([ink, along(np.array([anchor, edge]))])


def _box(centre: np.ndarray, half: np.ndarray | float) -> tuple[float, ...]:
    return (*(centre - half), *(centre + half))
