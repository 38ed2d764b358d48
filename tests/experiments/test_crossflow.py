"""The study of crossflow with made-up plays: what is trained, what is compared, and that it goes on."""

import json

import crossflow as program
import numpy as np
import pytest

from jaxnav.training.dataclass_json import to_json
from jaxnav.training.rollout import EpisodeSummary

EPISODES = 200
# Episodes that fail, of the first ones: one more with each seed.
FAILURES = {name: 40 - 5 * i for i, name in enumerate(program.VARIANTS)}


def summary(failures):
    arrived = np.array([np.arange(EPISODES) >= count for count in failures])
    zero, no = np.zeros(arrived.shape, int), np.zeros(arrived.shape, bool)
    return EpisodeSummary(
        arrived=arrived, collided=~arrived, hit_pedestrian=~arrived, truncated=no, steps=zero + 20,
        min_distance=zero + 0.5, comfortable_steps=zero + 15, request=zero, replied=no, agreed=no,
    )  # fmt: skip


@pytest.fixture
def done(monkeypatch):
    """The variants that are trained, in order."""
    names = []

    def trained(name, options, console):
        names.append(name)
        row = program._row(name, "trained", summary([FAILURES[name], FAILURES[name] + 2]), [0, 1])
        config = to_json(program.configuration(name, options.steps))
        return row | {"env_steps": options.steps, "train_seconds": 1.0, "config": config, "excluded": [], "device": "x"}

    planner = program._row("planner", "none", summary([10]), []) | {"device": "x"}
    monkeypatch.setattr(program, "trained", trained)
    monkeypatch.setattr(program, "planned", lambda options: planner)
    return names


def test_each_variant_is_trained_once_and_compared_over_the_same_episodes(tmp_path, done, capsys):
    arguments = ["--seeds", "2", "--episodes", str(EPISODES), "--out", str(tmp_path)]
    second = list(program.VARIANTS)[1]
    program.main([*arguments, "--variants", second])
    assert done == [second] and "| -" in capsys.readouterr().out  # no robot of the tables to compare it with yet
    program.main(arguments)
    assert sorted(done) == sorted(program.VARIANTS)
    table = (tmp_path / "crossflow.md").read_text()
    assert capsys.readouterr().out == table
    row = next(line for line in table.splitlines() if line.startswith(f"| {second} "))
    # 35 and 37 failures of 200: 5 fewer than the tables' robots, and 26 more than the planner on average.
    assert "0.820 (0.825 0.815)" in row and "| +2.5 (+2.5 to +2.5) | -13.0 (-13.5 to -12.5) |" in row
    result = json.loads((tmp_path / "crossflow.json").read_text())
    result["rows"][second]["config"]["world"]["nearest"] = 3
    (tmp_path / "crossflow.json").write_text(json.dumps(result))
    with pytest.raises(SystemExit) as stop:
        program.main(arguments)
    message = capsys.readouterr().err
    assert stop.value.code == 2 and second in message and "world.nearest" in message


def test_every_variant_is_a_configuration_that_differs_in_what_it_names():
    usual = program.configuration(program.BASE, 256_000)
    assert usual.world.scenes == (program.SCENE,) and usual.train.total_steps * usual.train.episodes == 256_000
    for name, (world, agent, longer) in program.VARIANTS.items():
        config = program.configuration(name, 256_000)
        assert all(getattr(config.world, field) == value for field, value in world.items())
        assert all(getattr(config.agent, field) == value for field, value in agent.items())
        assert config.train.total_steps == longer * usual.train.total_steps
        assert (to_json(config) == to_json(usual)) == (name == program.BASE)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [(["--variants", "none"], "'none'"), (["--steps", "1000"], "--steps is 1000"), (["--seeds", "0"], "--seeds is 0")],
)
def test_what_is_not_possible_is_named(arguments, said, tmp_path, capsys):
    with pytest.raises(SystemExit) as stop:
        program.main([*arguments, "--out", str(tmp_path / "out")])
    assert stop.value.code == 2 and said in capsys.readouterr().err and not (tmp_path / "out").exists()
