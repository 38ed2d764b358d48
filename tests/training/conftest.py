"""A world, a run and a robot that are small enough to be trained in a test."""

import dataclasses
import functools
import time

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxnav.agents.a2c import A2CConfig
from jaxnav.agents.hsac import HSACConfig
from jaxnav.agents.scripted import StraightLine
from jaxnav.training import evaluation
from jaxnav.training.config import TrainConfig, WorldSettings, resolve, run_class
from jaxnav.training.policy import Policy
from jaxnav.training.rollout import Either, record
from jaxnav.training.run import Run
from jaxnav.training.train import train as train_run
from jaxnav.world import Action, Params, World, WorldConfig


@pytest.fixture(scope="session", autouse=True)
def _light_runs():
    """Evaluations of 8 episodes at a time instead of 500."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(evaluation, "BLOCK", 8)
        yield


def tiny(out="", algo="hsac", **train):
    """A `RunConfig` of seconds: 4 chunks of 5 steps of 16 episodes in the square."""
    sizes = {"episodes": 16, "replay_rows": 20, "steps_per_chunk": 5, "total_steps": 20, "checkpoint_seconds": 0.0}
    agent = HSACConfig(actor_widths=(16,), critic_widths=(16,), batch=32, updates_per_step=2)
    if algo == "a2c":
        agent = A2CConfig(actor_widths=(16,), critic_widths=(16,), horizon=5)
    return resolve(
        run_class(algo)(
            out=str(out),
            world=WorldSettings(scenes=("square",), beams=16, params=Params(max_steps=12.0)),
            agent=agent,
            train=TrainConfig(**sizes | train),
        )
    )


@pytest.fixture(scope="session", name="tiny")
def _tiny():
    return tiny


def train(config, report=lambda line: None):
    """(Run, Progress) after preparing the folder and training to the end."""
    run = Run(config)
    run.prepare_folder()
    return run, train_run(run, report, time.monotonic())


@pytest.fixture(scope="session", name="train")
def _train():
    return train


@pytest.fixture(scope="session")
def finished(tmp_path_factory):
    """(Run, Progress) of a run that was left alone. Copy its folder before you change it."""
    return train(tiny(tmp_path_factory.mktemp("finished") / "run"))


def assert_same(a, b):
    """Two pytrees are equal bit for bit, random keys included."""
    assert jax.tree.structure(a) == jax.tree.structure(b)
    for (path, x), y in zip(jax.tree_util.tree_leaves_with_path(a), jax.tree.leaves(b), strict=True):
        if jnp.issubdtype(x.dtype, jax.dtypes.prng_key):
            assert jax.random.key_impl(x) == jax.random.key_impl(y)
            x, y = jax.random.key_data(x), jax.random.key_data(y)
        assert x.dtype == y.dtype, jax.tree_util.keystr(path)
        np.testing.assert_array_equal(np.asarray(x), np.asarray(y), err_msg=jax.tree_util.keystr(path))


@pytest.fixture(scope="session", name="assert_same")
def _assert_same():
    return assert_same


@dataclasses.dataclass(frozen=True)
class Talker:
    """An agent without a network: full speed toward the goal, and a request that depends on how far it is."""

    config: None = None

    def vocabulary(self, split):
        return None

    def policy(self, learner):
        return learner.actor

    def best_action(self, actor, observation, voice=True, vocabulary=None):
        x, y = observation.pose[2, 0], observation.pose[2, 1]
        request = 1 + (10.0 * jnp.hypot(x, y)).astype(jnp.int32) % 3
        twist = jnp.stack([jnp.float32(actor), jnp.clip(2.0 * jnp.arctan2(y, x), -1.0, 1.0)])
        return Action(twist=twist, request=jnp.where(observation.may_request & voice, request, 0))


@dataclasses.dataclass(frozen=True)
class Talk:
    """How the `Talker` of `recorded` plays: two and a half blocks in each of two scenes."""

    actor: float = 0.7
    episodes: int = 20
    seed: int = 5

    def keys(self):
        """(keys, scene indices) of the episodes, as `Evaluator` promises them."""
        keys = evaluation.episode_keys(self.seed, jnp.arange(self.episodes))
        return jnp.tile(keys, 2), jnp.repeat(jnp.arange(2), self.episodes)


@pytest.fixture(scope="session")
def talk():
    return Talk()


@pytest.fixture(scope="session")
def evaluator():
    world = World(WorldConfig(scenes=("square", "hallway"), beams=4))
    return evaluation.Evaluator(world, Params(max_steps=24.0, goal_tolerance=1.0, compliance=0.5))


def talker(evaluator, speed):
    """The `Policy` of a `Talker`. speed: its only parameter."""
    return Policy(speed, learner=Talker(), world=evaluator.world)


@pytest.fixture(scope="session", name="talker")
def _talker(evaluator):
    return functools.partial(talker, evaluator)


@pytest.fixture(scope="session")
def recorded(evaluator, talk):
    """{"talker": its episodes, "straight": those of the straight-line robot}, the ones in the square first."""
    world, params, policy = evaluator.world, evaluator.params, talker(evaluator, talk.actor)
    # One program records both.
    return {
        name: record(world, params, Either(straight, StraightLine(), policy), *talk.keys(), 24)
        for name, straight in (("talker", False), ("straight", True))
    }
