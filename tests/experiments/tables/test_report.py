"""What the Markdown of a table says of a result, and the paper's own numbers."""

import itertools

import numpy as np
import pytest
from scipy.stats import trim_mean

from experiments.tables import report
from jaxnav import statistics
from jaxnav.statistics import wilson_interval
from jaxnav.world import SUITES

from .made_up import LEARNT, fields, made_up, row_of, scenes, scripted, success_of


def table_below(text, heading):
    """Cells of the rows of the table below the line that starts with a heading."""
    lines = text.splitlines()
    start = next(i for i, line in enumerate(lines) if line.startswith(heading))
    assert lines[start + 1] == "" and lines[start + 3].startswith("| --- |")
    rows = itertools.takewhile(lambda line: line.startswith("|"), lines[start + 2 :])
    header, _, *cells = [[cell.strip() for cell in row[1:-1].split("|")] for row in rows]
    assert {len(row) for row in cells} == {len(header)}
    return cells


def test_the_papers_tables_agree_with_each_other_where_they_are_of_the_same_robot():
    assert {table: len(methods["square"]) for table, methods in report.PAPER.items()} == {
        "table1": 4, "table2": 2, "table3": 2
    }  # fmt: skip
    for scene in SUITES["parity"]:
        ours = report.PAPER["table1"][scene]["HSAC-LLM"]
        four, language = report.PAPER["table2"][scene]["4 requests"], report.PAPER["table3"][scene]["with language"]
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


def test_the_facts_come_first():
    text = report.markdown(made_up()).split("\n\n**")[0]
    for fact in (
        "Methods. Our scenes are not the paper's.",
        "paper (128,000 environment steps), converged (1,000,000 environment steps). 4 seeds, ",
        "Encoder lidar; ", "TD3, PPO and A2C are given the message itself", "The planner knows the map",
        "Device: Abacus. Commits of the rows", "c0ffee, decaf.",
        "All trainings of this table took 206 min", "[trajectories](trajectories)",
    ):  # fmt: skip
        assert fact in text
    assert "muted" not in text.lower(), "what isn't in the table isn't explained"


def test_a_row_has_all_measures():
    rows = table_below(report.markdown(made_up()), "**hard suite, paper budget of 128,000 steps**")
    assert [row[:2] for row in rows[:4]] == [["narrow", name] for name in (*LEARNT[:3], "**HSAC-LLM**")]
    assert [row[0] for row in rows[::4]] == list(SUITES["hard"])
    low, high = statistics.measure(success_of("hard", "paper", "doorway", "TD3"))["ci95"]
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
    found = statistics.suite_iqm(scenes(*runs))
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
