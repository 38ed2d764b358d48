"""Tables on the terminal."""

import pytest
from rich.console import Console

from jaxnav.cli.output import lead, print_comparison, print_result

METRICS = {
    "success": 0.998, "success_ci95": [0.98, 1.0], "collision": 0.001, "human_collision": 0.0005, "timeout": 0.001,
    "steps": 123.4, "min_distance": 0.33, "comfort": 0.9, "straight_line_success": 0.3, "muted_success": 0.2,
    "muted_min_distance": None, "requests": {"none": 0.1, "stop": 0.2, "right": 0.3, "left": 0.4}, "complied": None,
}  # fmt: skip


def shown(capsys, show, result):
    show(Console(width=80), result)
    return capsys.readouterr().out.splitlines()


def test_five_scenes_are_columns_and_six_are_rows(capsys):
    for count, rows in ((5, 0), (6, 2)):
        scenes = {f"scene{i}": METRICS for i in range(count)}
        lines = shown(capsys, print_result, {"policy": "last", "episodes": 9, "seed": 0, "scenes": scenes})
        begin = [line.split()[0] for line in lines if line[:1] not in (" ", "")]
        assert begin.count("scene5") == rows
        assert max(map(len, lines)) <= 80 and not any("…" in line for line in lines[1:] if rows)
    assert any("0.980-1.000" in line and "123.4" in line and "0.33" in line for line in lines)


def test_a_result_elsewhere_says_where_it_was_trained(capsys):
    result = {"policy": "last", "episodes": 9, "seed": 0, "scenes": {"narrow": METRICS}, "trained_in": ["square"]}
    assert "trained in" in " ".join(" ".join(shown(capsys, print_result, result)).split())


def test_a_comparison_says_who_is_first_and_whether_that_is_open(capsys):
    def found(a, b, low, high):
        players = {"a": METRICS | {"success": a}, "b": METRICS | {"success": b}}
        difference = {"one": "a", "other": "b", "difference": a - b, "ci95": [low, high]}
        return {"players": players, "differences": [difference]}

    scenes = {"square": found(0.5, 0.8, -0.35, -0.25), "hallway": found(0.81, 0.8, -0.02, 0.04)}
    lines = shown(capsys, print_comparison, {"episodes": 9, "seed": 0, "players": ["a", "b"], "scenes": scenes})
    start = next(i for i, line in enumerate(lines) if line.startswith("square"))
    assert [line.split() for line in lines[start : start + 2]] == [
        ["square", "0.500", "0.800", "b", "+0.300", "+0.250", "to", "+0.350"],
        ["hallway", "0.810", "0.800", "a", "(open)", "+0.010", "-0.020", "to", "+0.040"],
    ]
    assert "9 episodes don't say which is first" in lines[start + 2]


def test_the_lead_is_that_of_the_first_over_the_second():
    pairs = [("a", "b", 0.1, 0.2), ("a", "c", -0.4, -0.2), ("b", "c", -0.5, -0.3)]
    differences = [{"one": a, "other": b, "difference": (x + y) / 2, "ci95": [x, y]} for a, b, x, y in pairs]
    first, second, difference, interval = lead({"a": 0.5, "b": 0.3, "c": 0.8}, differences)
    assert (first, second) == ("c", "a")
    assert difference == pytest.approx(0.3) and interval == pytest.approx((0.2, 0.4))
