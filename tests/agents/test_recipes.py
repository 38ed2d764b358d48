"""The learner and the encoder of docs/recipes, as an outsider adds them; and parts that do not fit are refused."""

import dataclasses
import json
import re
from pathlib import Path
from types import SimpleNamespace

import flax.linen as nn
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxnav.agents import (
    ENCODERS,
    LEARNERS,
    PPO,
    Encoder,
    PPOConfig,
    PPOHyperparameters,
    SilentLearner,
    TorchTwin,
    register_encoder,
    register_learner,
)
from jaxnav.agents.encoders import find_encoder
from jaxnav.agents.learner import find_learner
from jaxnav.errors import UserError
from jaxnav.export.bundle import write_bundle
from jaxnav.export.contract import origin_of
from jaxnav.export.verify import verify
from jaxnav.training.config import preset, resolve
from jaxnav.training.run import Run

RECIPES = Path(__file__).parents[2] / "docs" / "recipes"


@pytest.fixture(autouse=True)
def _registries_without_odd_parts():
    yield
    for registry in (ENCODERS, LEARNERS):
        registry.pop("odd", None)


def lines(name):
    return (RECIPES / name).read_text().count("\n")


def test_an_encoder_from_one_file_is_exported_with_its_twin(tmp_path):
    pytest.importorskip("torch")
    assert lines("encoder.py") <= 60
    encoder = f"{RECIPES / 'encoder.py'}:SECTORS"
    base = preset("quick", "td3")
    agent = dataclasses.replace(base.agent, encoder=encoder, encoder_widths=(8, 4), actor_widths=(16,))
    params = base.world.params.replace(max_steps=8.0)
    world = dataclasses.replace(base.world, params=params, scenes=("square",), beams=12)
    run = Run(resolve(dataclasses.replace(base, agent=agent, world=world, out=str(tmp_path / "run"))))
    state = jax.eval_shape(run.world.reset, jax.random.key(0), run.params)
    observation = jax.tree.map(
        lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), jax.eval_shape(run.world.observe, state, run.params)
    )
    actor = run.agent.policy(run.agent.init(jax.random.key(1), observation, run.config.hyper))
    write_bundle(run, actor, tmp_path / "bundle", origin_of(run, "last", {}, None))
    network = json.loads((tmp_path / "bundle" / "contract.json").read_text())["network"]
    assert network["encoder_widths"] == {"scan": 8, "talk": 4} and "scan" in network["inputs"]
    assert "selftest passed" in verify(tmp_path / "bundle")
    (tmp_path / "bundle" / "twin.py").unlink()
    with pytest.raises(UserError, match=r"twin\.py is missing"):
        verify(tmp_path / "bundle")
    odd = register_encoder(dataclasses.replace(find_encoder(encoder), name="odd", twin=None))
    agent = type(run.agent)(dataclasses.replace(run.agent.config, encoder=odd.name))
    with pytest.raises(UserError, match="'odd' has no torch twin"):
        write_bundle(SimpleNamespace(agent=agent), actor, tmp_path / "other", {})
    assert not (tmp_path / "other").exists()


def test_a_learner_from_one_file_learns_the_twist_that_pays(blank_observation, random_batch):
    assert lines("learner.py") <= 80
    record = find_learner(f"{RECIPES / 'learner.py'}:DQN")
    twists = np.float32([(v, w) for v in (-1, 0, 1) for w in (-1, -0.5, 0, 0.5, 1)])
    agent = record.make(record.config(critic_widths=(16,)))
    hyper = record.hyper(lr=1e-2, discount=0.0)
    rng = np.random.default_rng(0)
    twist = rng.choice(twists, 64)
    reward = np.float32(-100 * np.abs(twist - [0.0, 0.5]).sum(axis=-1))
    batch = random_batch(rng, (64,), observation=blank_observation(True, (64,)), twist=twist, reward=reward)

    @jax.jit
    def learnt(key):
        start = agent.init(key, blank_observation(), hyper)
        state, _ = jax.lax.scan(
            lambda state, key: agent.update(key, state, batch, hyper), start, jax.random.split(key, 300)
        )
        return agent.best_action(agent.policy(state), batch.observation), agent.act(
            key, state, batch.observation, hyper
        )

    best, tried = learnt(jax.random.key(0))
    assert (np.asarray(best.twist) == [0.0, 0.5]).all(axis=-1).mean() > 0.9
    assert 0.5 < (np.asarray(tried.twist) == np.asarray(best.twist)).all(axis=-1).mean() < 1.0


class _Takes(nn.Module):
    @nn.compact
    def __call__(self, observation):
        return observation.twist


class _Sums(nn.Module):
    @nn.compact
    def __call__(self, observation, heard):
        return nn.Dense(1)(observation.twist).sum()


class _Deaf(SilentLearner):
    replays, horizon = False, 1


class _Short(PPO):
    def act(self, key, state):
        pass


@pytest.mark.parametrize(
    ("register", "said"),
    [
        (lambda: register_encoder(Encoder("lidar", _Sums, ())), "'lidar' is registered already"),
        (lambda: register_encoder(Encoder("odd", _Sums, ("smell",))), "reads 'smell', which is no part"),
        (lambda: register_encoder(Encoder("odd", _Sums, (), {"a": 0})), "has widths {'a': 0}: give whole numbers"),
        (lambda: register_encoder(Encoder("odd", _Sums, (), {"a": 1})), "can't be made of its widths"),
        (lambda: register_encoder(Encoder("odd", _Takes, ())), "can't be called with (observation, heard)"),
        (lambda: register_learner("td3", PPO, PPOConfig, PPOHyperparameters), "'td3' is registered already"),
        (lambda: register_learner("odd", PPO, int, PPOHyperparameters), "give a dataclass that extends LearnerConfig"),
        (lambda: register_learner("odd", PPO, PPOConfig, Encoder), "lack discount, final_lr"),
        (lambda: register_learner("odd", _Deaf, PPOConfig, PPOHyperparameters), "has no method init"),
        (
            lambda: register_learner("odd", _Short, PPOConfig, PPOHyperparameters),
            "act has to take (key, state, observation, hyper)",
        ),
        (
            lambda: register_learner("odd", lambda config: _Deaf(), PPOConfig, PPOHyperparameters).make(PPOConfig()),
            "has no config",
        ),
    ],
)
def test_parts_that_do_not_fit_are_refused_by_name(register, said):
    with pytest.raises(UserError, match=re.escape(said)):
        register()


def test_an_encoder_that_returns_no_features_is_told_before_it_trains(blank_observation):
    register_encoder(Encoder("odd", _Sums, ("scan",)))
    agent = PPO(PPOConfig(encoder="odd"))
    with pytest.raises(UserError, match=r"_Sums returns .*: it has to return \[features\]"):
        agent.init(jax.random.key(0), blank_observation(), PPOHyperparameters())
    with pytest.raises(ValueError, match=r"agent\.encoder 'even' is unknown: choose from lidar"):
        find_encoder("even")


def test_a_twin_that_makes_no_arrays_is_told():
    from jaxnav.export.weights import torch_weights

    encoder = dataclasses.replace(ENCODERS["lidar"], twin=TorchTwin("LidarEncoder", lambda params: params["nothing"]))
    with pytest.raises(UserError, match=r"agent\.encoder lidar: the arrays of its twin can't be made"):
        torch_weights({"params": {"state_encoder": {}}}, 1, encoder)
