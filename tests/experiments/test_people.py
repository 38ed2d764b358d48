"""The study of other people's pedestrians: its worlds are real, its robots are made up, and it goes on."""

import json
from types import SimpleNamespace

import jax
import numpy as np
import pytest

from experiments import people as program
from jaxnav.agents.scripted import StraightLine
from jaxnav.training.config import preset
from jaxnav.world import Params


@pytest.fixture
def recording(tmp_path):
    """A file of six people who walk to and fro along x, 8 m each."""
    lines = [
        f"{6 * (k + 4 * n)} {n} {(k if n % 2 else 19 - k) * 0.4} {0.8 * n}" for n in range(6) for k in range(20)
    ]  # fmt: skip
    path = tmp_path / "recording.txt"
    path.write_text("\n".join(lines), encoding="utf-8")
    return str(path)


def test_a_row_for_each_scene_and_model_and_it_goes_on(tmp_path, recording, monkeypatch, capsys):
    """The straight-line robot in place of trained ones, ten steps long; its plays are those of the worlds."""
    done = []

    def trained(config, name, console):
        return SimpleNamespace(policy_of=lambda actor: StraightLine()), None

    def setting(options, cell, real=program.setting):
        done.append(cell)
        world, params = real(options, cell)
        assert world.config.people == program.CELLS[cell][1]
        return world, params.replace(max_steps=10.0)

    monkeypatch.setattr(program.study, "trained", trained)
    monkeypatch.setattr(program, "setting", setting)
    monkeypatch.setattr(program, "BLOCK", 4)
    monkeypatch.setattr(program, "CELLS", {cell: program.CELLS[cell] for cell in list(program.CELLS)[-3:]})
    arguments = ["--out", str(tmp_path), "--runs", str(tmp_path / "runs"), "--recording", recording]
    arguments += ["--episodes", "4", "--robots", "2", "--pedestrians", "3", "--crowd", "2"]
    program.main(arguments)
    table = (tmp_path / "people.md").read_text()
    assert capsys.readouterr().out == table
    assert [line.split("|")[2].strip() for line in table.splitlines()[4:]] == ["orca", "social-force", "recorded"]
    result = json.loads((tmp_path / "people.json").read_text())
    assert result["rows"]["recording/recorded"]["episodes"] == 4 and result["git_commit"]
    before = list(result["rows"])
    for seed in range(2):
        (tmp_path / "runs" / f"quick-{seed}").mkdir(parents=True)
        (tmp_path / "runs" / f"quick-{seed}" / "config.json").touch()
    monkeypatch.setattr(program, "plays", lambda *_: pytest.fail("it was played already"))
    program.main(arguments)
    assert list(json.loads((tmp_path / "people.json").read_text())["rows"]) == before
    with pytest.raises(SystemExit) as stop:
        program.main([*arguments, "--crowd", "1"])
    assert stop.value.code == 2 and "crowd differ" in capsys.readouterr().err


def test_shares_and_paired_differences():
    """Two robots, eight episodes: all arrive among ORCA people, three and five of eight among others."""
    rows = {}
    for people, counts in (("orca", (8, 8)), ("social-force", (3, 5))):
        arrived = [np.arange(8) < count for count in counts]
        played = [
            SimpleNamespace(
                arrived=one, hit_pedestrian=~one, truncated=np.zeros(8), comfortable_steps=np.full(8, 3.0),
                steps=np.full(8, 4.0),
            )
            for one in arrived
        ]  # fmt: skip
        source = {"device": "cpu", "git_commit": "abc"}
        rows[f"square/{people}"] = program.row(f"square/{people}", played) | source
    result = {"rows": rows, "steps": 1, "robots": 2, "episodes": 8, "seed": 7, "crowd": 6, "pedestrians": 16}
    last = program.table(result).splitlines()[-1]
    assert "| 0.500 (0.280-0.720) | 0.500 (0.280-0.720) | 0.000 | 0.750 | -0.500 (-0.625 to -0.375) |" in last


def test_the_robot_and_its_episodes_are_those_of_the_training_but_for_the_people():
    options = program.Options()
    (one, params), (other, _) = (program.setting(options, f"square/{people}") for people in program.SIMULATED)
    assert one.config.observation == preset("quick").world.observation and params == preset("quick").world.params
    starts = [jax.jit(world.reset)(jax.random.key(0), Params()) for world in (one, other)]
    jax.tree.map(np.testing.assert_array_equal, *(start.robot for start in starts))
