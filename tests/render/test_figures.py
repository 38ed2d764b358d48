"""The figures hold the numbers they were given, and every word of them can be read."""

import itertools
import math

import cv2
import numpy as np
import pytest
from matplotlib.collections import LineCollection
from matplotlib.colors import to_hex
from matplotlib.text import Text

from jaxnav.render.figures import learning_curve, trajectories
from jaxnav.render.labels import along, free_spot
from jaxnav.render.palette import scene_colours
from jaxnav.render.words import ending, in_short, utterances
from jaxnav.world import SCENES

TEMPERATURES = {"twist_temperature": "#0072b2", "request_temperature": "#d55e00"}


def _texts(figure):
    """All texts of the figure that are drawn."""
    off = set()
    for axes in figure.findobj(lambda artist: hasattr(artist, "get_xaxis")):
        for axis in (axes.xaxis, axes.yaxis):
            low, high = sorted(axis.get_view_interval())
            for tick in [*axis.get_major_ticks(), *axis.get_minor_ticks()]:
                if not axes.axison or not axis.get_visible() or not low - 1e-9 <= tick.get_loc() <= high + 1e-9:
                    off |= {tick.label1, tick.label2}
                off |= {label for label in (tick.label1, tick.label2) if not label.get_visible()}
    return [text for text in figure.findobj(Text) if text.get_text().strip() and text.get_visible() and text not in off]


def _assert_legible(figure):
    """Every text lies within the figure, and no two of them overlap."""
    renderer = figure.canvas.get_renderer()
    boxes = [(text.get_text(), text.get_window_extent(renderer)) for text in _texts(figure)]
    assert len(boxes) > 10
    width, height = figure.canvas.get_width_height()
    for words, box in boxes:
        inside = box.x0 >= 0 and box.y0 >= 0 and box.x1 <= width and box.y1 <= height
        assert inside, f"{words!r} is cut off: {box}"
    for (words, box), (other_words, other) in itertools.combinations(boxes, 2):
        apart = box.x1 <= other.x0 or other.x1 <= box.x0 or box.y1 <= other.y0 or other.y1 <= box.y0
        assert apart, f"{words!r} overlaps {other_words!r}: {box}, {other}"


def _assert_drawn(path, figure):
    """The file is a picture of the figure's size, with ink on all four quarters."""
    picture = cv2.imread(str(path))
    width, height = figure.canvas.get_width_height()
    assert picture.shape == (height, width, 3)
    for quarter in itertools.product(np.array_split(np.arange(height), 2), np.array_split(np.arange(width), 2)):
        assert (picture[np.ix_(*quarter)] < 128).any(axis=-1).mean() > 0.003


def _panels(figure):
    """{(row, column): axes} of the trajectories, rows from the top."""
    axes = [a for a in figure.axes if a.get_aspect() == 1.0]
    rows = sorted({round(a.get_position().y1, 3) for a in axes}, reverse=True)
    columns = sorted({round(a.get_position().x0, 3) for a in axes})
    return {(rows.index(round(a.get_position().y1, 3)), columns.index(round(a.get_position().x0, 3))): a for a in axes}


def test_trajectories_show_the_paths_as_recorded(world, params, episodes, tmp_path):
    path = tmp_path / "trajectories.png"
    figure = trajectories(world, episodes, path, params)
    _assert_drawn(path, figure)
    _assert_legible(figure)
    panels = _panels(figure)
    assert set(panels) == set(itertools.product(range(2), range(3)))
    by_start = {(float(e.states.robot.x[0]), float(e.states.robot.y[0])): e for e in episodes}
    latest = 0.0
    for (row, column), axes in panels.items():
        (line,) = [c for c in axes.collections if isinstance(c, LineCollection)]
        segments = np.array(line.get_segments())
        episode = by_start[tuple(segments[0, 0].tolist())]
        assert episode.scene == world.config.scenes[row]
        assert (ending(episode) == "arrived") == (column < 2)
        robot, walkers = episode.states.robot, episode.states.pedestrians
        np.testing.assert_allclose(segments[:, 1], np.stack([robot.x, robot.y], axis=-1)[1:])
        np.testing.assert_allclose(line.get_array(), 0.4 * np.arange(len(robot.x) - 1), rtol=1e-6)
        (dots,) = [c for c in axes.collections if not isinstance(c, LineCollection)]
        np.testing.assert_allclose(dots.get_offsets(), np.stack([walkers.x[:, 0], walkers.y[:, 0]], axis=-1))
        latest = max(latest, 0.4 * (len(robot.x) - 1))
        assert ending(episode) in axes.get_title()
        assert {text.get_text() for text in axes.texts} == {in_short(said) for said in utterances(episode)}
        (x0, y0), (x1, y1) = axes.transData.transform([(0.0, 0.0), (1.0, 1.0)])
        assert x1 - x0 == pytest.approx(y1 - y0)  # a metre is a metre in both directions
    (bar,) = [a for a in figure.axes if a.get_ylabel() == "time (s)"]
    assert bar.get_ylim() == pytest.approx((0.0, latest))
    assert {"asks: stop", "hears: stop"} <= {text.get_text() for text in _texts(figure)}


def test_an_empty_panel_says_why(world, params, episodes, tmp_path):
    arrived = [e for e in episodes if ending(e) == "arrived" and e.scene == "hallway"]
    failed = [e for e in episodes if ending(e) != "arrived" and e.scene == "square"]
    figure = trajectories(world, [*arrived, *failed[:1]], tmp_path / "t.png", params)
    _assert_legible(figure)
    words = [text.get_text().replace("\n", " ") for text in _texts(figure)]
    assert f"no failure in {len(arrived)} episodes" in words
    assert words.count("no success in 1 episode") == 2
    # A scene without episodes has no row.
    alone = trajectories(world, arrived[:1], tmp_path / "t.png", params)
    _assert_legible(alone)
    words = [text.get_text().replace("\n", " ") for text in _texts(alone)]
    assert "Square" not in words
    assert "only 1 success in 1 episode" in words


def test_trajectories_of_a_crowd_are_legible(crowd, params, tmp_path):
    world, episodes = crowd
    figure = trajectories(world, episodes, tmp_path / "t.png", params)
    _assert_drawn(tmp_path / "t.png", figure)
    _assert_legible(figure)
    for axes in _panels(figure).values():
        paths = [c for c in axes.collections if not isinstance(c, LineCollection)]
        assert len(paths) in (0, 5)


def test_no_episodes_is_an_error(world, tmp_path):
    with pytest.raises(ValueError, match="episodes is empty"):
        trajectories(world, [], tmp_path / "t.png")


def test_a_label_takes_the_nearest_spot_that_is_free():
    half, frame = np.array([20.0, 5.0]), (0.0, 0.0, 200.0, 200.0)
    anchor = np.array([100.0, 100.0])
    marker = (94.0, 94.0, 106.0, 106.0)
    line = along([(0.0, 100.0), (200.0, 100.0)], 100)
    x, y = free_spot(anchor, half, frame, [marker], [], line, 1.0)
    assert abs(x - 100.0) <= 20.0 + 6.0
    assert 5.0 + 1.0 <= abs(y - 100.0) <= 5.0 + 6.0 + 5.0  # beside the line, no farther than a step of the search
    # In a corner it stays inside.
    x, y = free_spot(np.array([0.0, 0.0]), half, frame, [(-6.0, -6.0, 6.0, 6.0)], [], line, 1.0)
    assert x >= 20.0
    assert y >= 5.0
    # With the nearest spots taken, it goes elsewhere.
    wall = (0.0, 80.0, 200.0, 120.0)
    x, y = free_spot(anchor, half, frame, [wall], [], line, 1.0)
    assert abs(y - 100.0) >= 20.0 + 5.0


def test_points_along_a_line_are_on_it():
    points = along([(0.0, 0.0), (4.0, 0.0), (4.0, 2.0)], 4)
    assert len(points) == 9
    np.testing.assert_allclose(points[[0, 1, 4, 6, 8]], [(0, 0), (1, 0), (4, 0), (4, 1), (4, 2)])


def _line(i, **changes):
    updates = 40 * max(0, i - 2)
    line = {
        "env_steps": 256 * i, "updates": updates, "wall_seconds": 20.0 + 1.5 * i,
        "critic_loss": 4.0 * 0.9**i, "actor_loss": 0.5 - 0.1 * i, "twist_entropy": -0.1 * i, "request_entropy": 1.3,
        "twist_temperature": 0.5 * 0.9**i, "request_temperature": 0.2 * 0.9**i,
        "success": {"square": min(1.0, 0.05 * i), "hallway": 0.5, "crosswalk": None if i < 5 else 0.25},
    }  # fmt: skip
    if i % 10 == 9:
        line["evaluation"] = {"square": 0.9, "hallway": 0.6, "crosswalk": 0.3}
    return line | changes


def _curves(axes, colour):
    return [line for line in axes.lines if to_hex(line.get_color()) == colour.lower()]


def test_the_learning_curve_holds_the_lines(tmp_path):
    lines = [_line(i) for i in range(30)]
    figure = learning_curve(lines, tmp_path / "curve.png")
    _assert_drawn(tmp_path / "curve.png", figure)
    _assert_legible(figure)
    success, critic, actor, entropies, temperatures = figure.axes[:5]
    colours = scene_colours(["square", "hallway", "crosswalk"])
    updates = [line["updates"] for line in lines]
    for name, colour in colours.items():
        recent, tested = _curves(success, colour)
        np.testing.assert_array_equal(recent.get_xdata(), updates)
        expected = [math.nan if line["success"][name] is None else line["success"][name] for line in lines]
        np.testing.assert_array_equal(recent.get_ydata(), expected)
        assert recent.get_linewidth() < 1.5
        measured = np.isfinite(tested.get_ydata())
        assert np.flatnonzero(measured).tolist() == [9, 19, 29]
        assert tested.get_marker() not in ("None", None, "")
    (threshold,) = [line for line in success.lines if line.get_linestyle() == "--"]
    assert set(threshold.get_ydata()) == {0.95}
    assert [axes.get_yscale() for axes in (critic, actor, entropies, temperatures)] == [
        "log",
        "linear",
        "linear",
        "log",
    ]
    for name, colour in TEMPERATURES.items():
        (curve,) = _curves(temperatures, colour)
        np.testing.assert_allclose(curve.get_ydata(), [line[name] for line in lines])


def test_the_top_axis_tells_when_an_update_was_done(tmp_path):
    lines = [_line(i) for i in range(30)]
    success = learning_curve(lines, tmp_path / "curve.png").axes[0]
    (top,) = success.child_axes
    assert top.get_xlabel() == "wall time (s)"
    ticks = [
        (tick, float(label.get_text())) for tick, label in zip(top.get_xticks(), top.get_xticklabels(), strict=True)
    ]
    assert len(ticks) >= 4
    for update, seconds in ticks:
        # Update 40 (i - 2) was done at 20 + 1.5 i seconds.
        assert seconds == pytest.approx(20.0 + 1.5 * (update / 40 + 2), abs=0.5)


@pytest.mark.parametrize(
    "line",
    [
        _line(12),
        _line(0, critic_loss=None, actor_loss=None, success={"square": None, "hallway": None}),
        {"updates": 0, "wall_seconds": 31.0, "success": {}},
        {"updates": 500, "wall_seconds": None, "success": {"hard-corner": 0.5}, "critic_loss": math.nan},
    ],
    ids=["whole", "before learning", "bare", "unknown scene"],
)
def test_a_single_line_is_drawn_as_marks(line, tmp_path):
    figure = learning_curve([line], tmp_path / "curve.png")
    assert cv2.imread(str(tmp_path / "curve.png")) is not None
    _assert_legible(figure)
    for axes, name in zip(figure.axes[1:3], ("critic_loss", "actor_loss"), strict=True):
        value = line.get(name)
        known = value is not None and math.isfinite(value)
        assert ("not recorded" in [text.get_text() for text in axes.texts]) == (not known)
        if known:
            (curve,) = axes.lines
            assert curve.get_ydata().tolist() == [value]
            assert curve.get_marker() != "None"
    for name, rate in line["success"].items():
        curves = _curves(figure.axes[0], scene_colours([name])[name])
        assert any(np.isfinite(curve.get_ydata()).any() for curve in curves) == (rate is not None)


def test_a_metric_that_starts_late_leaves_a_gap(tmp_path):
    lines = [_line(i, critic_loss=None if i < 4 else 2.0**-i) for i in range(12)]
    critic = learning_curve(lines, tmp_path / "curve.png").axes[1]
    np.testing.assert_array_equal(np.isfinite(critic.lines[0].get_ydata()), [i >= 4 for i in range(12)])
    assert critic.get_yscale() == "log"


def test_no_lines_is_an_error(tmp_path):
    with pytest.raises(ValueError, match="holds no line"):
        learning_curve([], tmp_path / "curve.png")


def test_a_scene_has_one_colour_whoever_else_is_shown():
    every = scene_colours([*SCENES, "new"])
    assert len(set(every.values())) == len(every)
    for name in SCENES:
        assert scene_colours([name]) == {name: every[name]}
