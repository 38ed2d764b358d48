"""The study of crossflow with made-up robots: what is trained and played, what is compared, and that it goes on."""

import json

import numpy as np
import pytest

from experiments import crossflow as program
from experiments.tables import methods
from jaxnav.training.dataclass_json import to_json
from jaxnav.training.evaluation import VALIDATION_SEED
from jaxnav.training.population import Trained
from jaxnav.training.rollout import EpisodeSummary

EPISODES = 200


def summary(failures):
    """Plays in which the first so many episodes fail, by seed."""
    arrived = np.array([np.arange(EPISODES) >= count for count in failures])
    zero, no = np.zeros(arrived.shape, int), np.zeros(arrived.shape, bool)
    return EpisodeSummary(
        arrived=arrived, collided=~arrived, hit_pedestrian=~arrived, truncated=no, steps=zero + 20,
        min_distance=zero + 0.5, comfortable_steps=zero + 15, request=zero, replied=no, agreed=no,
    )  # fmt: skip


class FakePrograms:
    """Trains nothing. Unchanged robots fail 40 and 42 episodes, those that observe eight people 35 and 37; the second
    seed breaks where four people are observed with lidar-approach."""

    done: list

    def __init__(self, config, seeds, is_told=False, phrases="test"):
        assert not is_told and phrases == "validation"
        self.population, self.config, self.members = self, config, seeds

    def start(self, seeds, hyper, scene):
        assert list(seeds) == list(range(self.members)) and hyper is self.config.hyper and scene == 0
        return "loop"

    def train(self, loop, hyper, steps, report):
        FakePrograms.done.append((self.config.world.nearest, self.config.agent.encoder, steps))
        breaks = self.config.agent.encoder == "lidar-approach" and self.config.world.nearest != 8
        broken = (None, 6400) if breaks else (None, None)
        return loop, Trained(env_steps=steps * self.config.train.episodes, policies="policies", broken=broken)

    def play(self, policies, method, scene, seed, episodes):
        assert (policies, scene, seed, episodes) == ("policies", 0, VALIDATION_SEED, EPISODES)
        assert method == methods.METHODS["HSAC"]
        least = 35 if self.config.world.nearest == 8 else 40
        return summary([least, least + 2])


@pytest.fixture
def done(monkeypatch):
    """What is trained, in order."""
    FakePrograms.done = []

    def playing(world, params):
        assert [scene.name for scene in world.scenes] == ["crossflow"]

        def play(player, scene, seed, episodes):
            assert player is methods.SCRIPTED["planner"]
            return EpisodeSummary(*(leaf[0] for leaf in summary([10])))

        return play

    monkeypatch.setattr(methods, "Programs", FakePrograms)
    monkeypatch.setattr(methods, "Playing", playing)
    return FakePrograms.done


def test_each_variant_is_trained_once_and_compared_over_the_same_episodes(tmp_path, done, capsys):
    arguments = ["--seeds", "2", "--episodes", str(EPISODES), "--out", str(tmp_path)]
    program.main([*arguments, "--variants", "eight"])
    assert done == [(8, "lidar", 1000)] and "| - | -13.0" in capsys.readouterr().out
    program.main(arguments)
    assert len(done) == len(set(done)) == len(program.VARIANTS)
    table = (tmp_path / "crossflow.md").read_text()
    assert capsys.readouterr().out == table
    rows = {line.split(" | ")[0].strip("| "): line for line in table.splitlines() if line.startswith("| ")}
    # 35 and 37 failures of 200: 5 fewer than unchanged, and 26 more than the planner on average.
    assert (
        "0.820 (0.825 0.815)" in rows["eight"] and "| +2.5 (+2.5 to +2.5) | -13.0 (-13.5 to -12.5) |" in rows["eight"]
    )
    assert "without seeds [1]" in rows["approach"] and "0.800 (0.800)" in rows["approach"]
    assert "| 512,000 |" in rows["approach-eight-twice"] and "| 0.950 |" in rows["planner"]
    program.main(arguments)
    assert len(done) == len(program.VARIANTS)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (
            lambda result: result["rows"]["eight"]["config"]["world"].update(nearest=3),
            "eight of another configuration (world.n",
        ),
        (
            lambda result: result["rows"]["planner"]["config"]["params"].update(max_v=9),
            "planner of another configuration (par",
        ),
        (lambda result: result["rows"].update(old=result["rows"]["eight"]), "'old', which is no row"),
        (lambda result: result.update(seeds=3), "seeds differ"),
    ],
)
def test_results_of_something_else_are_refused(change, said, tmp_path, done, capsys):
    arguments = ["--seeds", "2", "--episodes", str(EPISODES), "--out", str(tmp_path), "--variants", "eight"]
    program.main(arguments)
    path = tmp_path / "crossflow.json"
    result = json.loads(path.read_text())
    change(result)
    path.write_text(json.dumps(result))
    with pytest.raises(SystemExit) as stop:
        program.main(arguments)
    assert stop.value.code == 2 and said in capsys.readouterr().err
    assert json.loads(path.read_text()) == result


def test_every_variant_is_a_configuration_that_differs_in_what_it_names():
    usual = program.configuration(program.UNCHANGED, 256_000)
    assert usual.world.scenes == (program.SCENE,) and usual.train.total_steps * usual.train.episodes == 256_000
    for name, (_, world, agent, longer) in program.VARIANTS.items():
        config = program.configuration(name, 256_000)
        assert all(getattr(config.world, field) == value for field, value in world.items())
        assert all(getattr(config.agent, field) == value for field, value in agent.items())
        assert config.train.total_steps == longer * usual.train.total_steps
        assert (to_json(config) == to_json(usual)) == (name == program.UNCHANGED)
        assert name in program.Options.__doc__


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--variants", "none"], "'none'"),
        (["--steps", "38400"], "--steps is 38400"),
        (["--seeds", "0"], "--seeds is 0"),
    ],
)
def test_what_is_not_possible_is_named(arguments, said, tmp_path, capsys):
    with pytest.raises(SystemExit) as stop:
        program.main([*arguments, "--out", str(tmp_path / "out")])
    assert stop.value.code == 2 and said in capsys.readouterr().err and not (tmp_path / "out").exists()
