"""Parts of the paper's tables: numbers over seeds against closed forms, and what Markdown and picture say of them."""

import functools
import itertools

import cv2
import numpy as np
import pytest
import report
from hypothesis import given, settings
from hypothesis import strategies as st
from matplotlib.colors import to_hex
from scipy.stats import binomtest, bootstrap, trim_mean

from jaxnav.render import palette
from jaxnav.training.evaluation import wilson_interval
from jaxnav.world import SUITES

SHARE = st.integers(0, 200).map(lambda count: count / 200)
SHARES = st.lists(SHARE, min_size=1, max_size=8)
EXAMPLES = settings(max_examples=40)  # each is a bootstrap
LEARNT = ("A2C", "TD3", "PPO", "HSAC-LLM")
SCRIPTED = ("straight line", "planner")


# --- a made-up result


@functools.cache
def measured(values, trials=None):
    """`report.measure`, once: most rows have the same numbers."""
    return report.measure(values, trials)


def fields(success):
    """Every measure of a row of 200 episodes; half of the failures hit a person."""
    alike = {"timeout": (0.0, 200), "comfort": (0.875, None), "steps": (21.125, None), "min_distance": (0.375, None)}
    return {
        "success": measured(tuple(success), 200), "collision": measured(tuple(1 - s for s in success), 200),
        "human_collision": measured(tuple((1 - s) / 2 for s in success), 200),
        **{field: measured((value,) * len(success), trials) for field, (value, trials) in alike.items()},
    }  # fmt: skip


def success_of(suite, budget, scene, method):
    """Success of seeds 0 to 3, another one everywhere; HSAC-LLM's is the best of those learnt."""
    best = 0.5 + 0.1 * LEARNT.index(method) + 0.05 * (budget == "converged") - 0.3 * (suite == "hard")
    return [best, best + 0.005 * (1 + SUITES[suite].index(scene)), best - 0.05, best + 0.035]


def learnt(suite, budget, scene, method):
    """A row of a learnt method."""
    steps, seconds = {"paper": 128_000, "converged": 1_000_000}[budget], 110 * (1 + LEARNT.index(method))
    return {
        "suite": suite, "scene": scene, "method": method, "budget": budget, "env_steps": steps, "seeds": [0, 1, 2, 3],
        "encoder": "lidar", "excluded": {}, "episodes": 200, **fields(success_of(suite, budget, scene, method)),
        "train_seconds": seconds, "commit": "c0ffee", "device": "Abacus",
    }  # fmt: skip


def scripted(suite, scene, method):
    """A row of a scripted robot; the planner is better than all that is learnt."""
    return {
        "suite": suite, "scene": scene, "method": method, "budget": "none", "env_steps": 0, "seeds": [],
        "excluded": {}, "episodes": 200, **fields([0.995 if method == "planner" else 0.25]), "train_seconds": 0,
        "commit": "decaf", "device": "Abacus",
    }  # fmt: skip


def made_up(suites=("parity", "hard"), budgets=("paper", "converged"), without=(), table="table1"):
    """A result of these suites and budgets, without the rows of some (suite, budget, scene, method)."""
    places = [(suite, scene) for suite in suites for scene in SUITES[suite]]
    rows = [
        learnt(suite, budget, scene, method)
        for budget, (suite, scene), method in itertools.product(budgets, places, LEARNT)
        if (suite, budget, scene, method) not in without
    ]
    rows += [scripted(suite, scene, method) for suite, scene in places for method in SCRIPTED]
    pair = {
        "suite": "hard", "scene": "narrow", "budget": "paper", "one": "HSAC-LLM", "other": "TD3", "field": "success",
        "difference": -0.0525, "ci95_half": 0.0175, "episodes": 600, "seeds": 4, "seeds_ci95": [-0.08, 0.0125],
    }  # fmt: skip
    return {
        "table": table, "rows": rows, "pairs": [pair, pair | {"field": "steps", "difference": 1.5, "ci95_half": 0.25}],
        "config": {}, "commit": "c0ffee", "device": "Abacus", "versions": {}, "wall_seconds": 12_345.0,
    }  # fmt: skip


def row_of(result, *place):
    """The row of a (suite, budget, scene, method)."""
    return next(row for row in result["rows"] if tuple(row[n] for n in ("suite", "budget", "scene", "method")) == place)


def table_below(text, heading):
    """Cells of the rows of the table below the line that starts with a heading."""
    lines = text.splitlines()
    start = next(i for i, line in enumerate(lines) if line.startswith(heading))
    assert lines[start + 1] == "" and lines[start + 3].startswith("| --- |")
    rows = itertools.takewhile(lambda line: line.startswith("|"), lines[start + 2 :])
    header, _, *cells = [[cell.strip() for cell in row[1:-1].split("|")] for row in rows]
    assert {len(row) for row in cells} == {len(header)}
    return cells


# --- numbers


@pytest.mark.parametrize(
    ("values", "mean", "iqm"),
    [
        ([0.9, 0.0, 0.2, 0.1], 0.3, 0.15),  # the middle two
        ([0.5, 0.1, 0.3], 0.3, 0.3),  # a quarter of three is none
        ([0.0, 1.0, 0.5, 0.6, 0.7], 0.56, 0.6),
        ([0.0] * 2 + [0.2, 0.3, 0.4, 0.5] + [1.0] * 2, 0.425, 0.35),
        ([0.7], 0.7, 0.7),
    ],
)
def test_mean_and_interquartile_mean(values, mean, iqm):
    found = report.measure(values)
    assert (found["mean"], found["iqm"]) == pytest.approx((mean, iqm))
    assert found["per_seed"] == values and "wilson95" not in found


def test_the_interval_is_that_of_all_resamples():
    values = [0.1, 0.35, 0.4, 0.75, 0.95]
    means = np.mean(list(itertools.product(values, repeat=5)), axis=1)
    found = report.measure(values)["ci95"]
    assert found == pytest.approx(np.percentile(means, (2.5, 97.5)), abs=0.011)
    assert report.measure([0.0, 1.0])["ci95"] == [0.0, 1.0]  # both seeds the same one in half of the resamples


@EXAMPLES
@given(SHARES, st.randoms(use_true_random=False))
def test_a_measure_lies_among_its_values_whatever_their_order(values, random):
    found = report.measure(values, 200)
    low, high = found["ci95"]
    assert low - 1e-12 <= found["mean"] <= high + 1e-12
    assert min(values) <= found["iqm"] <= max(values)
    if len(values) > 1:
        assert min(values) <= low and high <= max(values)
    for value, (below, above) in zip(values, found["wilson95"], strict=True):
        assert below <= value <= above and below < above
    other = random.sample(values, len(values))
    again = report.measure(other, 200)
    assert again["per_seed"] == other
    assert {**again, "per_seed": 0, "wilson95": sorted(again["wilson95"])} == {
        **found, "per_seed": 0, "wilson95": sorted(found["wilson95"])
    }  # fmt: skip


@pytest.mark.parametrize("value", [0.1, 1 / 3, 1.0, 27.1])
@pytest.mark.parametrize("seeds", [2, 3, 10])
def test_the_interval_of_seeds_that_agree_is_a_point(value, seeds):
    found = report.measure([value] * seeds)
    assert (found["mean"], found["ci95"], found["iqm"]) == (value, [value, value], value)


def test_one_seed_has_wilsons_interval_of_a_proportion_and_none_of_anything_else():
    found = report.measure([0.95], 200)
    assert found["ci95"] == pytest.approx(list(binomtest(190, 200).proportion_ci(method="wilson")))
    assert found["wilson95"] == [found["ci95"]] == [wilson_interval(190, 200)]
    assert report.measure([1.0], 200)["ci95"][1] == 1.0
    assert report.measure([27.1])["ci95"] is None


def test_wilsons_intervals_are_of_each_seeds_episodes():
    found = report.measure([0.29, 0.57], 100)  # 0.29 * 100 is 28.999999999999996
    assert found["wilson95"] == [wilson_interval(29, 100), wilson_interval(57, 100)]


def test_what_has_no_value_is_left_out_of_the_mean():
    found = report.measure([None, 20.0, 22.0])
    assert (found["mean"], found["per_seed"]) == (21.0, [None, 20.0, 22.0])
    assert report.measure([None, 20.0]) == {"mean": 20.0, "ci95": None, "per_seed": [None, 20.0], "iqm": 20.0}
    nothing = {"mean": None, "ci95": None, "iqm": None}
    assert report.measure([None]) == {**nothing, "per_seed": [None]}
    assert report.measure([], 200) == {**nothing, "per_seed": [], "wilson95": []}
    assert report.measure([None, 0.5], 200)["wilson95"] == [None, wilson_interval(100, 200)]


@pytest.mark.parametrize("bad", [float("nan"), float("inf")])
def test_a_measure_refuses_what_is_not_finite(bad):
    with pytest.raises(ValueError, match="leave out what isn't finite"):
        report.measure([0.5, bad])


def scenes(*values):
    """Rows of a scene each with these successes."""
    return [{"scene": f"scene {k}", "success": {"per_seed": list(one)}} for k, one in enumerate(values)]


def test_the_interquartile_mean_of_a_suite_is_over_all_its_runs():
    found = report.suite_iqm(scenes([0.0, 0.95, 0.9, 1.0], [0.8, 0.7, 0.96, 0.1]))
    assert found["iqm"] == pytest.approx((0.7 + 0.8 + 0.9 + 0.95) / 4)
    assert (found["min"], found["reached"], found["runs"], found["scenes"]) == (0.0, 3 / 8, 8, 2)


def test_the_interval_of_a_suite_is_stratified_by_scene():
    """Scenes that differ from one another, not from seed to seed, leave nothing uncertain."""
    found = report.suite_iqm(scenes([0.25] * 4, [0.75] * 4))
    assert (found["iqm"], found["ci95"]) == (0.5, [0.5, 0.5])
    low, high = report.suite_iqm(scenes([0.25, 0.75] * 4))["ci95"]
    assert high - low > 0.2


def test_the_interval_of_a_scene_is_scipys():
    values = np.array([0.1, 0.35, 0.4, 0.5, 0.62, 0.75, 0.8, 0.95])
    other = bootstrap(
        (values,), lambda x, axis: trim_mean(x, 0.25, axis=axis), n_resamples=20_000, method="percentile",
        random_state=1, vectorized=True,
    )  # fmt: skip
    assert report.suite_iqm(scenes(values))["ci95"] == pytest.approx(other.confidence_interval, abs=0.02)


def test_scenes_with_one_seed_or_none_left():
    found = report.suite_iqm(scenes([0.5], [0.2, 0.8], []))
    assert (found["runs"], found["scenes"]) == (3, 2)
    assert found["ci95"] == pytest.approx([(0.5 + 0.4) / 3, (0.5 + 1.6) / 3])
    assert report.suite_iqm(scenes([0.5], [0.7]))["ci95"] is None
    assert report.suite_iqm(scenes([], [])) is report.suite_iqm([]) is None


@EXAMPLES
@given(st.lists(SHARES, min_size=1, max_size=4), st.randoms(use_true_random=False))
def test_a_suites_number_lies_in_its_interval_whatever_the_order(values, random):
    rows = scenes(*values)
    found = report.suite_iqm(rows)
    runs = list(itertools.chain(*values))
    assert found["min"] == min(runs) <= found["iqm"] <= max(runs)
    if found["ci95"] is not None:
        low, high = found["ci95"]
        assert low - 1e-12 <= found["iqm"] <= high + 1e-12
    other = [row | {"success": {"per_seed": random.sample(s := row["success"]["per_seed"], len(s))}} for row in rows]
    assert report.suite_iqm(random.sample(other, len(other))) == found


# --- the paper's numbers


def test_the_papers_tables_agree_with_each_other_where_they_are_of_the_same_robot():
    assert {table: len(methods["square"]) for table, methods in report.PAPER.items()} == {
        "table1": 4, "table2": 2, "table3": 2
    }  # fmt: skip
    for scene in SUITES["parity"]:
        ours = report.PAPER["table1"][scene]["HSAC-LLM"]
        four, language = report.PAPER["table2"][scene]["4 codes"], report.PAPER["table3"][scene]["with language"]
        assert {**ours, **four, "train_hours": round(four["train_hours"], 1)} == ours
        assert {**ours, **language} == ours


def test_rates_of_the_paper_are_rates():
    rows = [
        (scene, method, numbers)
        for table in report.PAPER.values()
        for scene, methods in table.items()
        for method, numbers in methods.items()
    ]
    assert len(rows) == 24
    for _, _, numbers in rows:
        assert 0 < numbers["success"] + numbers["collision"] < 1 + 1e-9
        assert 19 < numbers["steps"] < 60
    # In one row the paper has more collisions with people than collisions.
    odd = {(scene, method) for scene, method, n in rows if n.get("human_collision", 0) > n["collision"]}
    assert odd == {("hallway", "TD3")}


# --- Markdown


def test_the_facts_come_first():
    text = report.markdown(made_up()).split("\n\n**")[0]
    for fact in (
        "Methods. Our scenes are not the paper's.",
        "paper (128,000 environment steps), converged (1,000,000 environment steps). 4 seeds, ",
        "Encoder lidar; ", "TD3, PPO and A2C are given the message itself", "The planner knows the map",
        "Device: Abacus. Commits of the rows", "c0ffee, decaf.",
    ):  # fmt: skip
        assert fact in text
    assert "muted" not in text.lower(), "what isn't in the table isn't explained"


def test_a_row_has_all_measures():
    rows = table_below(report.markdown(made_up()), "**hard suite, paper budget of 128,000 steps**")
    assert [row[:2] for row in rows[:4]] == [["narrow", name] for name in (*LEARNT[:3], "**HSAC-LLM**")]
    assert [row[0] for row in rows[::4]] == list(SUITES["hard"])
    low, high = report.measure(success_of("hard", "paper", "doorway", "TD3"))["ci95"]
    assert rows[5][2:] == [
        "4 x 200", f"0.299 ({low:.3f}-{high:.3f})", "0.701", "0.351", "0.000", "21.12", "0.38", "0.875", "220"
    ]  # fmt: skip


def test_the_best_learnt_method_of_each_scene_is_bold():
    result = made_up()
    row_of(result, "parity", "paper", "hallway", "A2C").update(fields([0.99, 0.97, 0.98]))
    for scene, less in (("square", 0.0001), ("crosswalk", 0.001)):  # in the square as good as each other, as printed
        best = row_of(result, "parity", "paper", scene, "HSAC-LLM")["success"]
        row_of(result, "parity", "paper", scene, "PPO")["success"] = best | {"mean": best["mean"] - less}
    text = report.markdown(result)
    rows = table_below(text, "**parity suite, paper budget")
    bold = [(scene, method) for scene, method, *_ in rows if "**" in method]
    assert bold == [
        ("square", "**PPO**"), ("square", "**HSAC-LLM**"), ("hallway", "**A2C**"), ("crosswalk", "**HSAC-LLM**")
    ]  # fmt: skip
    assert all(row[3].startswith("**") == row[1].startswith("**") for row in rows)
    scripted_rows = table_below(text, "**parity suite, scripted robots**")
    assert len(scripted_rows) == 6 and "**" not in str(scripted_rows)
    low, high = wilson_interval(199, 200)
    assert scripted_rows[1][:4] == ["square", "planner", "200", f"0.995 ({low:.3f}-{high:.3f})"]
    assert scripted_rows[1][-1] == "-"  # nothing is trained


@pytest.mark.parametrize(("table", "number", "rows"), [("table1", "I", 12), ("table2", "II", 6), ("table3", "III", 6)])
def test_the_papers_numbers_stand_apart_as_another_simulators(table, number, rows):
    text = report.markdown(made_up(table=table))
    heading = f"**The paper's Table {number}: another simulator's numbers, not comparable with ours**"
    assert text.index("**parity suite, scripted") < text.index(heading) < text.index("**hard suite")
    found = table_below(text, heading)
    assert len(found) == rows
    assert found[-1][2:5] == ["0.91", "0.09", "32.80"]
    assert ("could hear or ask is not said" in text) == (table == "table1")


def test_without_the_parity_suite_the_paper_has_no_numbers():
    assert "The paper's Table" not in report.markdown(made_up(suites=("hard",)))


def test_a_seed_left_out_is_named():
    result = made_up()
    row_of(result, "hard", "paper", "narrow", "TD3").update(excluded={"4": 51_200})
    text = report.markdown(result)
    sentence = "seed 4 of TD3 in narrow turned non-finite by step 51,200 and is left out"
    assert text.splitlines()[-1] == f"- paper budget: {sentence}"
    assert ". 4 to 5 seeds, " in text
    assert report.markdown(made_up()).splitlines()[-1] == "No seed turned non-finite."


def test_a_method_without_a_seed_left_has_no_numbers():
    result = made_up(suites=("parity",), budgets=("paper",))
    for scene, method in (("square", "TD3"), *(("hallway", method) for method in LEARNT)):
        row_of(result, "parity", "paper", scene, method).update(fields([]), excluded=dict.fromkeys("0123", 9))
    text = report.markdown(result)
    rows = table_below(text, "**parity suite, paper budget")
    assert rows[1] == ["square", "TD3", "0 x 200", *["-"] * 7, "220"]
    assert [row[0] for row in rows if "**" in row[1]] == ["square", "crosswalk"]  # none is the best of nothing
    suites = table_below(text, "**Success over suites**")
    assert [row[-1] for row in suites] == [
        f"{runs} in {of} of 3 scenes" for runs, of in ((8, 2), (4, 1), (8, 2), (8, 2), (3, 3), (3, 3))
    ]


def test_what_is_missing_is_not_run():
    without = [("hard", "converged", "corner", "PPO"), *(("hard", "paper", "doorway", method) for method in LEARNT)]
    without += [("parity", "converged", scene, method) for scene in SUITES["parity"] for method in LEARNT]
    result = made_up(without=without)
    result["rows"].remove(row_of(result, "parity", "none", "square", "planner"))
    text = report.markdown(result)
    missing = {
        (suite, budget, row[0], row[1])
        for suite, budget in (("parity", "paper"), ("hard", "paper"), ("hard", "converged"))
        for row in table_below(text, f"**{suite} suite, {budget} budget")
        if row[2:] == ["not run", *[""] * 8]
    }
    assert missing == {place for place in without if place[:2] != ("parity", "converged")}
    lines = text.splitlines()
    assert lines[lines.index("**parity suite, converged budget: not run**") + 2].startswith("**parity suite, scripted")
    assert text.count("not run") == 1 + len(missing) + 1
    assert "| square | planner | not run |" in text
    assert "**HSAC-LLM**" in text and "| 12 in 3 of 4 scenes |" in text


def test_a_table_that_has_just_begun():
    one = made_up()
    one["rows"], one["pairs"] = [], []
    assert "No seed turned non-finite." in report.markdown(one)
    one["rows"] = [scripted("hard", "corner", "planner")]
    text = report.markdown(one)
    assert [row[:3] for row in table_below(text, "**hard suite, scripted robots**")] == [
        [scene, "planner", "200" if scene == "corner" else "not run"] for scene in SUITES["hard"]
    ]
    assert "budget" not in text.split("interquartile")[0].split("\n", 1)[1] and "Paired" not in text


def test_suites_and_pairs():
    text = report.markdown(made_up())
    rows = {tuple(row[:3]): row[3:] for row in table_below(text, "**Success over suites**")}
    assert len(rows) == 2 * (2 * 4 + 2)
    runs = [success_of("hard", "converged", scene, "TD3") for scene in SUITES["hard"]]
    found = report.suite_iqm(scenes(*runs))
    low, high = found["ci95"]
    assert rows["hard", "converged", "TD3"] == [
        f"{trim_mean(np.ravel(runs), 0.25):.3f} ({low:.3f}-{high:.3f})", "0.300", "0 %", "16 in 4 of 4 scenes"
    ]  # fmt: skip
    assert rows["parity", "none", "planner"] == ["0.995", "0.995", "100 %", "3 in 3 of 3 scenes"]
    assert table_below(text, "**Paired differences**") == [
        [
            "hard",
            "narrow",
            "paper",
            "HSAC-LLM minus TD3",
            "success",
            "-5.25 ± 1.75 points",
            "600 x 4",
            "-8.00 to +1.25",
        ],
        ["hard", "narrow", "paper", "HSAC-LLM minus TD3", "steps", "+1.50 ± 0.25", "600 x 4", "-0.08 to +0.01"],
    ]


# --- the picture


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
    return report.figure_of(made_up())


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
    axes = report.figure_of(result).axes[0]
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
    picture = report.figure_of(result)
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
    report.draw(made_up(suites=("parity",), budgets=("paper",)), tmp_path / "table1.png")
    picture = cv2.imread(str(tmp_path / "table1.png"))
    assert min(picture.shape[:2]) > 600 and np.ptp(picture) > 200
