"""The picture of a sweep holds the numbers it was given, and every word of it can be read."""

import dataclasses
import itertools

import numpy as np
import pytest
from matplotlib.text import Text

from jaxnav.sweep.figure import figure_of
from jaxnav.sweep.report import summarise

from .made_up import at, identity, results, searched, whole


def draw(found):
    figure = figure_of(found, summarise(found))
    figure.canvas.draw()
    return figure


def panel(figure, title):
    (axes,) = [axes for axes in figure.axes if axes.get_title(loc="left").startswith(title)]
    return axes


def line(axes, label):
    (found,) = [found for found in axes.lines if found.get_label() == label]
    return np.transpose(found.get_data())


def texts(figure):
    """Boxes of all texts that are drawn, by their words."""
    renderer, found = figure.canvas.get_renderer(), []
    for axes in figure.axes:
        if axes.axison:
            for axis in (axes.xaxis, axes.yaxis):
                low, high = sorted(axis.get_view_interval())
                found += [tick.label1 for tick in axis.get_major_ticks() if low <= tick.get_loc() <= high]
                found += [tick.label2 for tick in axis.get_major_ticks() if low <= tick.get_loc() <= high]
                found.append(axis.label)
        legend = axes.get_legend()
        found += [axes._left_title, *axes.texts, *(legend.get_texts() if legend else ())]
    assert all(isinstance(text, Text) for text in found)
    drawn = [text for text in found if text.get_visible() and text.get_text().strip()]
    return [(text.get_text(), text.get_window_extent(renderer)) for text in drawn]


CASES = {
    "two values": {},
    "two values, five trials, one seed": {"count": 5, "candidates": 1, "seeds": 1},
    "seven values": {"floats": 5, "sizes": 2, "count": 40},
    "ten values": {"floats": 8, "sizes": 2, "candidates": 5},
    "one value": {"floats": 1, "count": 12},
    "twenty confirmed": {"candidates": 20, "finals": np.linspace(0.9, 0.95, 21), "guard": False},
    "nothing yet": None,
}


@pytest.mark.parametrize("case", CASES)
def test_every_word_can_be_read(case):
    options = CASES[case]
    found = results(trials=64, confirmations=3, known=identity(3, 1)) if options is None else whole(**options)
    figure = draw(found)
    width, height = figure.canvas.get_width_height()
    assert width == 1600
    boxes = texts(figure)
    assert len(boxes) > 8
    for words, box in boxes:
        inside = box.x0 >= 0 and box.y0 >= 0 and box.x1 <= width and box.y1 <= height
        assert inside, f"{words!r} is cut off: {box}"
    for (words, box), (other_words, other) in itertools.combinations(boxes, 2):
        apart = box.x1 <= other.x0 or other.x1 <= box.x0 or box.y1 <= other.y0 or other.y1 <= box.y0
        assert apart, f"{words!r} overlaps {other_words!r}: {box}, {other}"


def test_lines_cross_the_axes_where_their_values_lie():
    found = whole(2, 1, 40)
    summary = summarise(found)
    axes = panel(draw(found), "Trials of the search")
    # Of a size the choices are at equal distances, of a float its logarithm; `at` is the way back.
    points = line(axes, f"trial {summary['winner']['trial']}, the winner")
    values, space = summary["winner"]["values"], found.identity["space"]
    assert points[0, 1] == [1, 2, 4].index(values["agent.updates_per_step"]) / 2
    for (name, known), (_, share) in zip(space.items(), points[1:], strict=True):
        assert at(known, share) == pytest.approx(values[name])
    assert line(axes, "base")[:, 1] == pytest.approx([0, 0.5, 0.5])
    states = [trial.state for trial in found.phases["search"]]
    others, complete = axes.collections[:2]
    assert len(others.get_segments()) == states.count("stopped")
    assert len(complete.get_segments()) == states.count("complete")


@pytest.mark.parametrize("direction", ["maximize", "minimize"])
def test_the_best_is_the_darkest(direction):
    found = results(searched(30, identity(2, direction=direction)), known=identity(2, direction=direction))
    lines = panel(draw(found), "Trials of the search").collections[1]
    # They are drawn in order, the best last, so above the others.
    lightness = lines.get_colors()[:, :3] @ [0.299, 0.587, 0.114]
    assert (np.diff(lightness) < 1e-3).all() and lightness[0] - lightness[-1] > 0.4


def test_bars_are_the_shares():
    found = whole(5, 2)
    shares = summarise(found)["importance"]["shares"]
    axes = panel(draw(found), "What mattered")
    assert [bar.get_width() for bar in axes.patches] == pytest.approx(list(shares.values()))
    labels = [label.get_text().replace("\n", "") for label in axes.get_yticklabels()]
    assert labels == [name.rpartition(".")[2] for name in shares]


def test_curves_are_those_of_the_trials():
    found = whole(count=30)
    summary = summarise(found)
    axes = panel(draw(found), "How the trials learnt")
    winner = found.phases["search"][summary["winner"]["trial"]]
    assert line(axes, f"trial {winner.number}, the winner").tolist() == [
        [row["env_steps"], row["objective"]] for row in winner.curve
    ]
    assert len(axes.lines) == 30 + 1  # and a rung
    assert sum(found.get_label() == "the ten best" for found in axes.lines) == 9


def test_confirmed_candidates_have_their_seeds_means_and_intervals():
    found = whole()
    rows = summarise(found)["confirmed"]
    axes = panel(draw(found), "Confirmed")
    names = [label.get_text().split("   ")[0] for label in axes.get_yticklabels()]
    assert names == ["base", f"trial {rows[1]['trial']} wins", *(f"trial {row['trial']}" for row in rows[2:])]
    spans = [collection.get_segments()[0] for collection in axes.collections]
    for y, (row, span) in enumerate(zip(rows, spans, strict=True)):
        assert span.tolist() == [[row["objective"]["ci95"][0], y], [row["objective"]["ci95"][1], y]]
    seeds = [list(mark.get_xdata()) for mark in axes.lines if mark.get_marker() == "o"]
    assert seeds == [row["objective"]["per_seed"] for row in rows]
    means = [mark.get_xdata()[0] for mark in axes.lines if mark.get_marker() == "D"]
    assert means == [row["objective"]["mean"] for row in rows]


def test_base_outside_of_the_space_stays_on_its_axis():
    found = whole(count=12, candidates=1)
    low = dict(found.identity["base"], hyper={"actor_lr": 1e-5, "tau": 0.2})
    found = dataclasses.replace(found, identity=found.identity | {"base": low})
    assert line(panel(draw(found), "Trials of the search"), "base")[:, 1].tolist() == [0, 1]
