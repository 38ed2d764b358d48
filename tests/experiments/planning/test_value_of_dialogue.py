"""The study from end to end, small: what it plays, what it doesn't play again, what it writes and what it refuses."""

import json

import cv2
import numpy as np
import pytest

from experiments import study
from experiments.planning import value_of_dialogue as program

FILES = ("value_of_dialogue.json", "value_of_dialogue.md", "value_of_dialogue.png")


@pytest.fixture
def played(monkeypatch):
    """The scenes that a study plays, in order; every robot's success is made up. The commit is "abc"."""
    names = []

    def play_scene(name, episodes, seed, advance):
        del advance
        names.append(name)
        share = dict(zip(program.ROBOTS, (0.9, 0.8, 0.7, 0.6, 0.5, 0.4), strict=True))
        return {
            robot: {
                "success": success, "success_ci95": [success - 0.02, success + 0.01], "collision": 1 - success,
                "human_collision": 1 - success, "timeout": 0.0, "given": [episodes, seed],
            }
            for robot, success in share.items()
        }  # fmt: skip

    monkeypatch.setattr(program, "play_scene", play_scene)
    at_commit(monkeypatch, "abc")
    return names


def at_commit(monkeypatch, commit):
    monkeypatch.setattr(study, "provenance", lambda: {"versions": {}, "git_commit": commit, "device": "none"})


def test_a_scene_is_played_by_all_robots_and_written_three_times(tmp_path, monkeypatch, capsys):
    """The one test that plays, all but one robot of a program of its own: 11 episodes are two blocks of 8."""
    monkeypatch.setattr(program, "BLOCK", 8)
    monkeypatch.setitem(program.PLAYERS, "ORCA", program.PLAYERS["planner"])
    program.main(["--scenes", "narrow", "--episodes", "11", "--seed", "3", "--out", str(tmp_path / "new")])
    assert sorted(path.name for path in (tmp_path / "new").iterdir()) == sorted(FILES)
    result = json.loads((tmp_path / "new" / FILES[0]).read_text())
    assert (result["episodes"], result["seed"]) == (16, 3)
    assert {"command", "versions", "git_commit", "device"} <= result.keys()
    robots = result["rows"]["narrow"]["robots"]
    assert tuple(robots) == program.ROBOTS
    for row in robots.values():
        assert row["success"] + row["collision"] + row["timeout"] == pytest.approx(1.0)
        assert row["human_collision"] <= row["collision"]
        low, high = row["success_ci95"]
        assert low <= row["success"] <= high
        assert (16 * row["success"]) % 1 == 0
    assert robots["planner"]["success"] > robots["straight line"]["success"]
    assert capsys.readouterr().out == (tmp_path / "new" / FILES[1]).read_text()


def test_the_table_says_what_words_are_worth(tmp_path, played):
    program.main(["--episodes", "2000", "--out", str(tmp_path), "--scenes", "corner", "square"])
    header, _, *rows = (tmp_path / FILES[1]).read_text().splitlines()[2:]
    assert header.split("|")[2:-1] == [f" {name} " for name in (*program.ROBOTS, *WORTH)]
    cells = "| 0.900 | 0.800 | 0.700 | 0.600 | 0.500 | 0.400 | +10.0 points | +20.0 points |"
    assert rows == [f"| square {cells}", f"| corner {cells}"]  # as in `SCENES`
    assert "2,000 episodes a scene, seed 0" in (tmp_path / FILES[1]).read_text()


WORTH = ("hearing is worth", "speaking is worth")


def test_the_picture_has_a_panel_a_suite(tmp_path, played):
    widths = []
    for scenes in (["square"], ["square", "narrow", "corner-laser"]):
        program.main(["--out", str(tmp_path), "--scenes", *scenes])
        picture = cv2.imread(str(tmp_path / FILES[2]))
        assert picture is not None and np.ptp(picture) > 200
        widths.append(picture.shape[1])
    assert widths[1] == 3 * widths[0]


def test_what_was_played_is_not_played_again(tmp_path, played):
    """An interrupted study goes on with what is missing; another scene joins those that are there."""
    out = ["--out", str(tmp_path), "--episodes", "1500"]
    program.main([*out, "--scenes", "narrow"])
    program.main([*out, "--scenes", "square", "narrow", "corner"])
    program.main([*out, "--scenes", "narrow", "--episodes", "2000"])  # rounded up they are the same
    assert played == ["narrow", "square", "corner"]
    assert list(json.loads((tmp_path / FILES[0]).read_text())["rows"]) == ["square", "narrow", "corner"]


def test_an_interrupted_study_keeps_the_scenes_that_are_done(tmp_path, played, monkeypatch):
    whole = program.play_scene

    def until_corner(name, *rest):
        if name == "corner":
            raise KeyboardInterrupt
        return whole(name, *rest)

    monkeypatch.setattr(program, "play_scene", until_corner)
    options = program.Options(scenes=("narrow", "corner"), out=tmp_path)
    with pytest.raises(KeyboardInterrupt):
        program.run(options)
    monkeypatch.setattr(program, "play_scene", whole)
    program.run(options)
    assert played == ["narrow", "corner"]


def test_scenes_of_another_commit_are_kept_and_named(tmp_path, played, monkeypatch):
    program.main(["--out", str(tmp_path), "--scenes", "narrow"])
    at_commit(monkeypatch, "def")
    program.main(["--out", str(tmp_path), "--scenes", "narrow", "square"])
    assert played == ["narrow", "square"]
    rows = json.loads((tmp_path / FILES[0]).read_text())["rows"]
    assert {name: row["git_commit"] for name, row in rows.items()} == {"square": "def", "narrow": "abc"}
    assert "commit: abc, def." in (tmp_path / FILES[1]).read_text()


@pytest.mark.parametrize(("option", "value"), [("seed", "1"), ("episodes", "3000")])
def test_another_seed_or_number_is_another_study(tmp_path, played, capsys, option, value):
    program.main(["--out", str(tmp_path), "--scenes", "narrow"])
    before = (tmp_path / FILES[0]).read_text()
    with pytest.raises(SystemExit) as stop:
        program.main(["--out", str(tmp_path), "--scenes", "square", f"--{option}", value])
    assert stop.value.code == 2 and played == ["narrow"]
    assert f"is of another configuration ({option} differ): give another --out" in capsys.readouterr().err
    assert (tmp_path / FILES[0]).read_text() == before


def test_without_names_all_scenes_are_played(tmp_path, played):
    program.main(["--out", str(tmp_path)])
    assert played == list(program.SCENES)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--scenes", "square", "moon"], "error: --scenes names 'moon': choose from square, "),
        (["--episodes", "0"], "error: --episodes is 0: give a whole number from 1 to 1000000"),
        (["--episodes", "1000001"], "error: --episodes is 1000001: give"),
        (["--seed", "-1"], "error: --seed is -1: give a whole number from 0 to 4294967295"),
        (["--seed", "4294967296"], "error: --seed is 4294967296: give"),
    ],
)
def test_bad_options_end_in_one_line_and_exit_request_2(tmp_path, played, capsys, options, message):
    with pytest.raises(SystemExit) as exit_:
        program.main([*options, "--out", str(tmp_path / "new")])
    assert exit_.value.code == 2
    printed = capsys.readouterr()
    assert (printed.out, played) == ("", [])
    assert printed.err.startswith(message) and printed.err.count("\n") == 1
    assert not (tmp_path / "new").exists()


def test_a_damaged_file_of_results_is_named_and_kept(tmp_path, played, capsys):
    (tmp_path / "value_of_dialogue.json").write_text("{}")
    with pytest.raises(SystemExit) as stop:
        program.main(["--scenes", "narrow", "--out", str(tmp_path)])
    assert stop.value.code == 2
    assert "value_of_dialogue.json is no result" in capsys.readouterr().err
    assert (tmp_path / "value_of_dialogue.json").read_text() == "{}"


def test_a_file_in_place_of_the_folder_is_named_before_anything_is_played(tmp_path, played, capsys):
    (tmp_path / "taken").touch()
    with pytest.raises(SystemExit) as stop:
        program.main(["--out", str(tmp_path / "taken")])
    assert (stop.value.code, played) == (2, [])
    assert "taken: File exists: choose a folder" in capsys.readouterr().err
