"""brax: states that its wrappers can carry, ends and fresh beginnings, and its own PPO on top."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

brax_world = pytest.importorskip("jaxnav.adapters.brax", exc_type=ImportError)

from brax.envs import base
from brax.training.agents.ppo import networks, train

from jaxnav import Params, World, WorldConfig

COUNT = 4
STAND = jnp.tile(jnp.array([-1.0, 0.0, 1.0, 0.0, 0.0, 0.0]), (COUNT, 1))


@pytest.fixture(scope="module")
def env(world, params):
    return brax_world.BraxWorld(world, params)


@pytest.fixture(scope="module")
def history(env):
    """The states `[12, COUNT]` of eleven steps of robots that stand still, under brax's wrappers."""
    wrapped = brax_world.wrap(env, env.episode_length)

    def one(state, _):
        state = wrapped.step(state, STAND)
        return state, state

    def episode(keys):
        first = wrapped.reset(keys)
        return first, jax.lax.scan(one, first, None, 11)[1]

    first, later = jax.jit(episode)(jax.random.split(jax.random.PRNGKey(0), COUNT))
    return jax.tree.map(lambda one, many: np.concatenate([one[None], many]), first, later)


def pose(observations):
    return observations[..., :9].reshape(*observations.shape[:-1], 3, 3)


def test_sizes_are_those_of_what_it_returns(env, history):
    assert history.obs.shape == (12, COUNT, env.observation_size)
    assert env.action_size == STAND.shape[1]
    assert env.episode_length == 5
    assert set(history.metrics) == {"arrived", "collided", "hit_pedestrian"}


def test_time_truncates_and_every_episode_is_a_new_one(history, follows, is_first):
    for step in range(1, 12):
        ended = step in (5, 10)
        assert history.done[step].tolist() == [ended] * COUNT
        assert history.info["truncation"][step].tolist() == [ended] * COUNT
        assert follows(pose(history.obs[step - 1]), pose(history.info["final_obs"][step]))
        assert is_first(pose(history.obs[step])) == ended == (history.pipeline_state.t[step] == 0).all()
    begins = history.obs[[0, 5, 10]].reshape(3 * COUNT, -1)
    assert len(np.unique(begins, axis=0)) == 3 * COUNT


def test_the_greatest_preference_is_the_request_that_is_said(env, monkeypatch):
    said = []

    def step(key, state, action, params):
        said.append((action.twist.tolist(), int(action.request)))
        raise StopIteration

    monkeypatch.setattr(env.world, "step", step)
    with pytest.raises(StopIteration):
        env.step(
            base.State(None, None, None, None, info={"rng": jax.random.PRNGKey(0)}),
            jnp.array([0.25, -0.5, -0.9, 0.1, 0.7, 0.3]),
        )
    assert said == [([0.25, -0.5], 2)]


def test_its_own_ppo_learns_in_it(monkeypatch, full):
    """A learner of others takes a few steps: its losses are finite, and its policy is no longer the first."""
    if not full:
        pytest.skip("compiles a learner of others: pytest --full")
    if not hasattr(jax, "device_put_replicated"):  # jax 0.10 has removed it, brax 0.14 still calls it

        def replicated(tree, devices):
            return jax.tree.map(lambda leaf: jnp.stack([leaf] * len(devices)), tree)

        monkeypatch.setattr(jax, "device_put_replicated", replicated, raising=False)
    # The world that compiles fastest: goal, twist, pedestrians.
    config = WorldConfig(scenes=("square",), observation=("pedestrians",), swept_collisions=False)
    env = brax_world.BraxWorld(World(config))
    small = functools.partial(
        networks.make_ppo_networks, policy_hidden_layer_sizes=(16,), value_hidden_layer_sizes=(16,)
    )
    _, _, metrics = train.train(
        env, num_timesteps=1024, episode_length=env.episode_length, wrap_env_fn=brax_world.wrap, num_envs=32,
        batch_size=32, num_minibatches=2, unroll_length=8, num_updates_per_batch=1, reward_scaling=0.01,
        run_evals=False, network_factory=small,
    )  # fmt: skip
    assert np.isfinite(metrics["training/total_loss"])
    assert metrics["training/v_loss"] > 0
    assert metrics["training/kl_mean"] > 0


def test_what_cannot_be_is_said(env):
    with pytest.raises(ValueError, match=r"world.params.robot_radius is -1.0"):
        brax_world.BraxWorld(params=Params(robot_radius=-1.0))
    with pytest.raises(ValueError, match="randomization_fn is given"):
        brax_world.wrap(env, 5, randomization_fn=lambda system: system)


def test_people_and_delays_are_those_of_the_world():
    world = World(WorldConfig(scenes=("narrow",), control_delay=1))
    assert brax_world.BraxWorld(world).params.preferred_speed == 1.2
    assert brax_world.BraxWorld(world, Params(control_latency=1)).params.control_latency == 1
    with pytest.raises(ValueError, match=r"world.params.control_latency is 2: give .* world.control_delay, which is 1"):
        brax_world.BraxWorld(world, Params(control_latency=2))
