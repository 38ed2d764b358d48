"""A run played again from outside: jaxnav evaluate, compare, render and export."""

import json
import os
import re
import shutil

import pytest

from jaxnav import cli

from .conftest import content, fails


def test_evaluate_prints_one_json_object(jaxnav, trained):
    folder, _ = trained
    before = content(folder)
    done = jaxnav("evaluate", folder, "--episodes", 500, "--json")
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.count("\n") == 1
    result, stored = json.loads(done.stdout), json.loads((folder / "evaluation.json").read_text())
    # The checkpoint holds the very policy that training evaluated.
    assert result["scenes"] == stored["scenes"]
    assert content(folder) == before


def test_a_policy_plays_in_other_scenes_and_the_result_says_what_changed(capsys, trained, tmp_path):
    folder, file = trained[0], tmp_path / "yard.py"
    file.write_text(
        "import dataclasses\nfrom jaxnav import SCENES\nYARD = dataclasses.replace(SCENES['square'], name='yard')\n"
    )
    cli.main(["evaluate", str(folder), "--scene", f"{file}:YARD,hallway", "--episodes", "20", "--json"])
    result = json.loads(capsys.readouterr().out)
    assert list(result["scenes"]) == ["yard", "hallway"]
    assert result["trained_in"] == ["square"]
    assert result["changed"] == {"world.nearest": 1, "world.scenes": [f"{file}:YARD", "hallway"]}
    # The yard is a square of another name: the same episodes end in the same way.
    cli.main(["evaluate", str(folder), "--episodes", "20", "--json"])
    here = json.loads(capsys.readouterr().out)
    assert here["scenes"]["square"] == result["scenes"]["yard"] and "trained_in" not in here


def test_compare_plays_runs_on_the_same_episodes(capsys, trained):
    folder = str(trained[0])
    cli.main(["compare", folder, folder, "--episodes", "20", "--json"])
    result = json.loads(capsys.readouterr().out)
    first, second = result["players"]
    found = result["scenes"]["square"]
    assert found["differences"] == [{"one": first, "other": second, "difference": 0.0, "ci95": [0.0, 0.0]}]
    assert found["players"][first] == found["players"][second]
    cli.main(["compare", folder, folder, "--episodes", "20"])
    assert f"{first} (open)" in " ".join(capsys.readouterr().out.split())
    assert "give the folders of at least two runs" in fails(capsys, "compare", folder)


def test_render_draws_the_pictures_again(jaxnav, trained, tmp_path):
    folder, pictures = tmp_path / "run", ("trajectories.png", "episode.gif", "learning_curve.png")
    shutil.copytree(trained[0], folder)
    for name in pictures:
        (folder / name).unlink()
    done = jaxnav("render", folder)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.splitlines() == [str(folder / name) for name in pictures]
    for name in pictures:
        assert (folder / name).read_bytes()[:4] in (b"\x89PNG", b"GIF8"), name


def test_export_writes_a_bundle_that_verifies(capsys, trained, tmp_path):
    """The one that training wrote is the same; the policy that did best is another one."""
    folder, _ = trained
    cli.main(["export", str(folder), "--out", str(tmp_path / "last")])
    assert f"{tmp_path / 'last'}: " in capsys.readouterr().out
    assert content(tmp_path / "last") == content(folder / "bundle")
    cli.main(["export", "--verify", str(tmp_path / "last")])
    assert "is whole; selftest passed, 128 recorded inputs" in capsys.readouterr().out
    origin = json.loads((folder / "bundle" / "contract.json").read_text())["origin"]
    stored = json.loads((folder / "config.json").read_text())
    assert origin["run"] == "run" and origin["policy"] == "last" and origin["git_commit"] == stored["git_commit"]
    assert origin["evaluation"] == json.loads((folder / "evaluation.json").read_text())
    assert origin["config"]["train"] == stored["config"]["train"]
    said = fails(capsys, "export", folder, "--out", tmp_path / "last")
    assert "already holds a bundle: give another --out" in said


def test_what_can_be_wrong_about_an_export_is_one_line(capsys, trained, tmp_path):
    folder, _ = trained
    assert "no run is given: jaxnav export RUN" in fails(capsys, "export")
    assert "give it alone" in fails(capsys, "export", folder, "--verify", folder / "bundle")
    assert "holds no bundle" in fails(capsys, "export", "--verify", tmp_path)
    assert "holds no run" in fails(capsys, "export", tmp_path)
    assert "'worst'" in fails(capsys, "export", folder, "--policy", "worst")
    bare = tmp_path / "bare"
    bare.mkdir()
    shutil.copy(folder / "config.json", bare)
    assert "holds no checkpoint" in fails(capsys, "export", bare)
    out = tmp_path / "out"
    assert "can't be run" in fails(capsys, "export", folder, "--out", out, "--torchscript", tmp_path / "python")
    assert not out.exists() and sorted(path.name for path in tmp_path.iterdir()) == ["bare"]


@pytest.mark.parametrize("command", ["evaluate", "render", "export"])
def test_a_damaged_checkpoint_is_one_line(jaxnav, trained, tmp_path, command):
    folder = tmp_path / "run"
    shutil.copytree(trained[0], folder)
    newest = folder / "checkpoints" / "step_60"
    os.truncate(max((path for path in newest.rglob("*") if path.is_file()), key=lambda path: path.stat().st_size), 100)
    before = content(folder)
    done = jaxnav(command, folder)
    assert (done.returncode, done.stdout) == (2, "")
    assert re.fullmatch(rf"error: {re.escape(str(newest))} is damaged: [^\n]+\n", done.stderr)
    assert content(folder) == before
