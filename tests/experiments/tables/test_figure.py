"""What the picture of a table shows of a result, and that nothing in it is cut off or covered."""

import itertools

import cv2
import numpy as np
import pytest
from matplotlib.colors import to_hex

from experiments.tables import figure as table_figure
from jaxnav.render import palette
from jaxnav.world import SUITES

from .made_up import LEARNT, SCRIPTED, fields, made_up, row_of


def artist(axes, label):
    """x and y of the artist with a label in a panel."""
    (line,) = [line for line in axes.lines if line.get_label() == label]
    return line.get_xdata(), line.get_ydata()


def spans(axes, method):
    """(x, low, high) of the intervals of a method in a panel."""
    (lines,) = [lines for lines in axes.collections if lines.get_label() == f"{method} interval"]
    return [(x, low, high) for (x, low), (_, high) in lines.get_segments()]


@pytest.fixture(scope="module")
def figure():
    return table_figure.figure_of(made_up())


def test_panels_are_of_a_suite_a_budget_and_a_field(figure):
    panels = np.reshape(figure.axes, (4, 2))
    for j, suite in enumerate(("parity", "hard")):
        for k in range(4):
            assert [label.get_text() for label in panels[k, j].get_xticklabels()] == list(SUITES[suite])
    titles = [axes.get_title() for axes in figure.axes if axes.get_title()]
    assert titles == [
        f"{suite} suite\n{budget} steps"
        for budget in ("paper budget of 128,000", "converged budget of 1,000,000")
        for suite in ("parity", "hard")
    ]
    assert [axes.get_ylabel() for axes in panels[:, 0]] == ["success", "human collisions"] * 2
    for k in (0, 1):  # heights are compared between suites and budgets
        assert len({axes.get_ylim() for axes in panels[k::2].ravel()}) == 1
    assert panels[0, 0].get_ylim() != panels[1, 0].get_ylim()


def test_panels_carry_seeds_means_and_intervals(figure):
    result, panels = made_up(), np.reshape(figure.axes, (4, 2))
    places = itertools.product(enumerate(("paper", "converged")), enumerate(("parity", "hard")), (0, 1))
    for (i, budget), (j, suite), k in places:
        axes, field, middles = panels[2 * i + k, j], ("success", "human_collision")[k], []
        for method in (*LEARNT, *SCRIPTED):
            own = "none" if method in SCRIPTED else budget
            rows = [row_of(result, suite, own, scene, method)[field] for scene in SUITES[suite]]
            x, means = artist(axes, f"{method} mean")
            assert list(np.round(x)) == list(range(len(rows)))  # above its scene's name
            assert list(means) == [row["mean"] for row in rows]
            assert np.array(spans(axes, method)) == pytest.approx(
                np.array([(at, *row["ci95"]) for at, row in zip(x, rows, strict=True)])
            )
            middles.append(x)
            if method in LEARNT:
                beside, seeds = artist(axes, f"{method} seeds")
                assert list(seeds) == list(itertools.chain(*(row["per_seed"] for row in rows)))
                assert np.abs(beside - np.repeat(x, 4)).max() < 1 / 14  # nearer to it than to its neighbours
        assert np.diff(middles, axis=0) == pytest.approx(1 / 7)


def test_scripted_robots_look_otherwise(figure):
    marks = {}
    for line in figure.axes[0].lines:
        marks[line.get_label()] = (line.get_marker(), to_hex(line.get_color()).upper(), line.get_markerfacecolor())
    assert {marks[f"{method} mean"][0] for method in LEARNT} == {"_"}
    assert len({marks[f"{method} mean"][1] for method in LEARNT} - {palette.FAINT_INK}) == 4
    assert [marks[f"{method} mean"] for method in SCRIPTED] == [(m, palette.FAINT_INK, "white") for m in "Ds"]
    assert not any(f"{method} seeds" in marks for method in SCRIPTED)
    (legend,) = figure.legends
    assert [text.get_text() for text in legend.get_texts()] == [*LEARNT, *SCRIPTED]
    for handle, method in zip(legend.legend_handles, (*LEARNT, *SCRIPTED), strict=True):
        assert to_hex(handle.get_color()).upper() == marks[f"{method} mean"][1]


def test_what_is_missing_or_left_out_has_a_word_in_its_place():
    result = made_up(suites=("parity",), budgets=("paper",), without=[("parity", "paper", "crosswalk", "TD3")])
    row_of(result, "parity", "paper", "square", "PPO").update(fields([]))
    axes = table_figure.figure_of(result).axes[0]
    words = {text.get_text(): text.get_position()[0] for text in axes.texts}
    place, (across, _) = artist(axes, "A2C mean")[0][2], artist(axes, "TD3 mean")
    assert words["not run"] == pytest.approx(place + 1 / 7) and len(across) == 2
    assert words["left out"] == pytest.approx(artist(axes, "A2C mean")[0][0] + 2 / 7)
    assert len(words) == 2


@pytest.mark.parametrize(
    ("suites", "budgets", "methods"),
    [
        (("parity",), ("paper",), (*LEARNT, *SCRIPTED)),
        (("parity",), ("paper",), LEARNT[:2]),
        (("parity", "hard", "hard-laser"), ("paper", "converged"), (*LEARNT, *SCRIPTED)),
        (("parity", "hard"), ("paper", "converged"), LEARNT[:2]),
        (("hard",), (), SCRIPTED),
    ],
)
def test_no_text_is_cut_off_or_covers_another(suites, budgets, methods):
    result = made_up(suites, budgets)
    result["rows"] = [row for row in result["rows"] if row["method"] in methods]
    for row in result["rows"]:
        if (row["budget"], row["method"]) == ("converged", "TD3"):
            row["env_steps"] = 2_500_000  # "1,000,000 to 2,500,000": the longest title
    picture = table_figure.figure_of(result)
    picture.draw_without_rendering()
    boxes = [text.get_window_extent() for text in (*picture.legends, *picture.texts)]
    for axes in picture.axes:
        assert not axes.get_window_extent().overlaps(boxes[0])
        low, high = axes.get_ylim()
        ticks = [tick.label1 for tick in axes.yaxis.get_major_ticks() if low <= tick.get_loc() <= high]
        texts = [axes.title, axes.yaxis.label, *axes.get_xticklabels(), *ticks]
        boxes += [text.get_window_extent() for text in texts if text.get_text()]
    assert len(boxes) > 2 + len(picture.axes) * 6
    for box in boxes:
        assert picture.bbox.x0 <= box.x0 and box.x1 <= picture.bbox.x1
        assert picture.bbox.y0 <= box.y0 and box.y1 <= picture.bbox.y1
    for one, other in itertools.combinations(boxes, 2):
        assert not one.overlaps(other)


def test_a_picture_is_written(tmp_path):
    table_figure.draw(made_up(suites=("parity",), budgets=("paper",)), tmp_path / "table1.png")
    picture = cv2.imread(str(tmp_path / "table1.png"))
    assert min(picture.shape[:2]) > 600 and np.ptp(picture) > 200
