"""The study of exported policies with made-up findings: what is done, what it says, and that it goes on."""

import json

import numpy as np
import pytest

from experiments.exporting import exported as program

PARITY = {"states": 100, "v": 2e-7, "w": 6e-7, "requests": 0, "ties": 1, "replays": [{"error": 5e-7, "where": "here"}]}


@pytest.fixture
def done(monkeypatch):
    """What a study does, in order."""
    found = []

    def drive(suite, options, console):
        found.append(suite)
        seen = {"success": 0.99, "walls": 0, "interventions": 0.0123, "steps": 5000}
        return {
            "policy": {"episodes": 204, "alike": 203, "same_steps": 202}, "jax": {"success": 0.995, "episodes": 2000},
            "navigator": seen, "unsafe": seen | {"walls": 3}, "cost": [-0.1, -0.3, 0.1], "from_jax": [0.0, 0.0, 0.0],
            "adversary": {"worlds": 1000, "steps": 80_000, "walls": 0, "people": 7},
        }  # fmt: skip

    monkeypatch.setattr(program, "compare", lambda name, options, console: found.append(name) or PARITY)
    monkeypatch.setattr(program, "drive", drive)
    return found


def test_it_does_everything_once(tmp_path, done, capsys):
    program.main(["--out", str(tmp_path)])
    assert done == [*program.CONFIGURATIONS, *program.SUITES] and len(done) == 20
    table = (tmp_path / "exported.md").read_text()
    assert capsys.readouterr().out == table
    assert "| grid, per-request, phrases | 2.0e-07 | 6.0e-07 | 0 | 5.0e-07 |" in table
    assert "| exported network: episodes that end alike | 203 of 204 | 203 of 204 |" in table
    assert "| safety layer, points of success | -0.10 (-0.30 to +0.10) |" in table
    assert "| commands that the layer slowed | 1.23 % | 1.23 % |" in table
    assert "0 in 1000 worlds, 80,000 steps" in table
    path = tmp_path / "exported.json"
    result = json.loads(path.read_text())
    del result["rows"]["drive hard"]
    path.write_text(json.dumps(result))
    program.main(["--out", str(tmp_path)])
    assert done[20:] == ["hard"]
    del result["rows"]["drive parity"]
    path.write_text(json.dumps(result))
    program.main(["--out", str(tmp_path), "--suites", "hard"])
    assert done[21:] == ["hard"] and "| | hard |" in (tmp_path / "exported.md").read_text()
    with pytest.raises(SystemExit) as stop:
        program.main(["--out", str(tmp_path), "--states", "5"])
    assert stop.value.code == 2 and "states differ" in capsys.readouterr().err


@pytest.mark.parametrize("option", ["states", "episodes", "drives", "worlds"])
def test_numbers_out_of_range_are_refused(option, tmp_path, done, capsys):
    with pytest.raises(SystemExit) as stop:
        program.main(["--out", str(tmp_path), f"--{option}", "0"])
    assert stop.value.code == 2 and f"--{option} is 0: give a whole number from 1" in capsys.readouterr().err
    assert not done and not list(tmp_path.iterdir())


def test_pairs_are_of_the_same_episodes():
    before, after = np.array([1, 1, 0, 0], bool), np.array([1, 0, 0, 0], bool)
    change, low, high = program._paired(before, after)
    assert change == -25.0 and low < -60 and high > 10
