"""The robustness study with made-up plays: what is played, what it says, and that it goes on; and `tricks.arrival`."""

import json
import pathlib
from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib.figure import Figure

from experiments import robustness as program
from experiments import study, tricks

SCENES = ("square", "hallway", "crosswalk")


@pytest.fixture
def played(monkeypatch):
    """The values that a study plays, in order. The plain robot is worse the further `crowd_size` is from 1."""
    done = []

    def trained(config, robot, console):
        world = SimpleNamespace(scenes=[SimpleNamespace(name=name) for name in SCENES])
        return SimpleNamespace(world=world), robot

    def player(run):
        def arrived(actor, params, seed, episodes):
            done.append((actor, float(params.crowd_size), float(params.max_speed) >= float(params.preferred_speed)))
            share = 0.9 if actor == "robust" else 0.95 - 0.05 * float(params.crowd_size)
            return np.tile(np.arange(episodes) < share * episodes, (3, 1))

        return arrived

    monkeypatch.setattr(study, "trained", trained)
    monkeypatch.setattr(program, "player", player)
    return done


def test_every_robot_plays_every_value_once(tmp_path, played, capsys):
    arguments = ["--out", str(tmp_path), "--episodes", "1000"]
    program.main(arguments)
    values = sum(len(values) for _, values in program.AXES.values())
    assert len(played) == 2 * values and all(legal for *_, legal in played)
    result = json.loads((tmp_path / "robustness.json").read_text())
    assert result["rows"]["plain/crowd_size/8"]["success"] == pytest.approx(dict.fromkeys(SCENES, 0.55))
    table = (tmp_path / "robustness.md").read_text()
    assert capsys.readouterr().out == table
    assert "| 8 | 0.550 (0.532-0.568) | 0.900 (0.889-0.910) |" in table
    result["rows"]["plain/crowd_size/8"]["git_commit"] = "one before"
    (tmp_path / "robustness.json").write_text(json.dumps(result))
    program.main(arguments)
    assert len(played) == 2 * values
    now = result["rows"]["plain/crowd_size/1"]["git_commit"]
    assert f"commit: {', '.join(sorted({str(now), 'one before'}))}." in (tmp_path / "robustness.md").read_text()
    with pytest.raises(SystemExit) as stop:
        program.main(["--out", str(tmp_path), "--episodes", "2000"])
    assert stop.value.code == 2 and "episodes differ" in capsys.readouterr().err


def test_what_is_missing_is_played_again_by_the_same_robot_or_all_of_it_by_another(tmp_path, played):
    arguments = ["--out", str(tmp_path / "out"), "--runs", str(tmp_path / "runs")]
    program.main(arguments)
    values = len(played) // 2
    result = json.loads((tmp_path / "out" / "robustness.json").read_text())
    del result["rows"]["plain/crowd_size/8"]
    for there, count in ((True, 1), (False, values)):
        if there:
            (tmp_path / "runs" / "plain").mkdir(parents=True)
            (tmp_path / "runs" / "plain" / "config.json").touch()
        else:
            (tmp_path / "runs" / "plain" / "config.json").unlink()
        (tmp_path / "out" / "robustness.json").write_text(json.dumps(result))
        played.clear()
        program.main(arguments)
        assert [robot for robot, *_ in played] == ["plain"] * count


def test_an_interrupted_training_does_not_keep_the_plays_of_the_one_before(tmp_path, played, monkeypatch):
    arguments = ["--out", str(tmp_path / "out"), "--runs", str(tmp_path / "runs")]
    program.main(arguments)
    values, path = len(played) // 2, tmp_path / "out" / "robustness.json"
    result = json.loads(path.read_text())
    del result["rows"]["plain/crowd_size/8"]
    path.write_text(json.dumps(result))
    whole = study.trained

    def interrupted(config, robot, console):
        pathlib.Path(config.out).mkdir(parents=True)
        pathlib.Path(config.out, "config.json").touch()
        raise KeyboardInterrupt

    monkeypatch.setattr(study, "trained", interrupted)
    with pytest.raises(KeyboardInterrupt):
        program.run(program.Options(out=tmp_path / "out", runs=tmp_path / "runs"))
    monkeypatch.setattr(study, "trained", whole)
    played.clear()
    program.main(arguments)
    assert [robot for robot, *_ in played] == ["plain"] * values


def test_the_figure_shows_what_was_measured(tmp_path, played, monkeypatch):
    figures = []
    monkeypatch.setattr(Figure, "savefig", lambda self, path, **options: figures.append(self))
    program.main(["--out", str(tmp_path)])
    panels = [axes for axes in figures[0].axes if axes.get_xlabel()]
    assert [axes.get_xlabel() for axes in panels] == [label for label, _ in program.AXES.values()]
    crowd = panels[list(program.AXES).index("crowd_size")]
    plain = next(bars for bars in crowd.containers if bars.get_label() == "plain")
    np.testing.assert_allclose(plain.lines[0].get_ydata(), [0.9, 0.85, 0.8, 0.75, 0.65, 0.55], atol=1e-6)


def test_the_preset_covers_every_axis():
    ranges = {name: (low, high) for name, low, high in program.preset("robust").world.randomise}
    assert ranges.keys() == program.AXES.keys()


def test_arrival_needs_two_evaluations_in_a_row():
    def lines(*worst):
        return [{"success": [[1.0, value]], "updates": 10 * i} for i, value in enumerate(worst, 1)]

    assert tricks.arrival(lines(0.9, 0.96, 0.94, 0.95, 0.99), 0)["updates"] == 40
    assert tricks.arrival(lines(0.96, 0.94, 0.97), 0) is None
