"""gymnax: its signature, its spaces, its auto-reset, and the check of its neighbour gymnasium."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

gymnax_world = pytest.importorskip("jaxnav.adapters.gymnax", exc_type=ImportError)

import gymnasium
from gymnasium.utils.env_checker import check_env
from gymnax.environments import spaces
from gymnax.wrappers import GymnaxToGymWrapper

from jaxnav import World, WorldConfig

STAND = jnp.array([-1.0, 0.0]), jnp.int32(0)
AHEAD = jnp.array([1.0, 0.0]), jnp.int32(0)


class Checkable(GymnaxToGymWrapper):
    """gymnax's own wrapper for gymnasium, and what gymnasium's check wants besides: its generator seeded, and numpy."""

    def reset(self, *, seed=None, options=None):
        gymnasium.Env.reset(self, seed=seed)
        observation, info = super().reset(seed=seed, options=options)
        return np.asarray(observation), info

    def step(self, action):
        observation, reward, terminated, truncated, info = super().step(action)
        info = jax.tree.map(np.asarray, info)
        return np.asarray(observation), float(reward), bool(terminated), bool(truncated), info


@pytest.fixture(scope="module")
def wrapped(world, params):
    """The wrapper copies the environment: its copy is the one that all tests here compile and share."""
    return Checkable(gymnax_world.GymnaxWorld(world), params)


@pytest.fixture(scope="module")
def env(wrapped):
    return wrapped._env


def play(env, action, params, steps):
    """Observations before each step, and what each step returned."""
    observation, state = env.reset(jax.random.key(3), params)
    before, returned = [], []
    for key in jax.random.split(jax.random.key(4), steps):
        before.append(observation)
        observation, state, *rest = env.step(key, state, action, params)
        returned.append((observation, state, *rest))
    return before, returned


def pose(observation):
    return np.asarray(observation[:9]).reshape(3, 3)


def test_it_passes_the_check_of_gymnasium(wrapped):
    check_env(wrapped, skip_render_check=True)


def test_spaces_hold_what_is_sampled_and_what_is_observed(env, params):
    action_space, observation_space = env.action_space(params), env.observation_space(params)
    assert isinstance(action_space, spaces.Tuple)
    action = action_space.sample(jax.random.key(0))
    assert action_space.contains(action)
    assert not action_space.contains((action[0], jnp.int32(4)))
    observation, _ = env.reset(jax.random.key(1), params)
    assert observation.shape == observation_space.shape
    assert observation.dtype == observation_space.dtype
    assert observation_space.contains(observation)


def test_time_truncates_and_the_last_observation_is_kept(env, params, follows, is_first):
    before, returned = play(env, STAND, params, 11)
    assert [bool(truncated) for *_, truncated, _ in returned] == [False] * 4 + [True] + [False] * 4 + [True, False]
    assert not any(terminated for _, _, _, terminated, _, _ in returned)
    for previous, (observation, state, _, _, truncated, info) in zip(before, returned, strict=True):
        assert follows(pose(previous), pose(info["final_observation"]))
        assert is_first(pose(observation)) == bool(truncated) == (state.t == 0)
    # Every episode has its own beginning.
    assert not np.array_equal(returned[4][0], returned[9][0])


def test_an_episode_that_ends_by_itself_is_terminated(env, params):
    _, returned = play(env, AHEAD, params.replace(max_steps=1000.0), 30)
    ends = [(truncated, info) for *_, terminated, truncated, info in returned if terminated]
    assert len(ends) >= 2
    for truncated, info in ends:
        assert not truncated
        assert info["arrived"] != info["collided"]


def test_gradients_flow_only_through_the_copy_that_is_made_for_them(env, params, full):
    if not full:
        pytest.skip("compiles the gradient of a step twice: pytest --full")
    _, state = env.reset(jax.random.key(0), params)

    def ahead(env, v):
        return env.step(jax.random.key(1), state, (jnp.stack([v, 0.0]), jnp.int32(0)), params)[1].robot.x

    assert jax.grad(lambda v: ahead(env, v))(0.0) == 0.0
    # Half of the top speed for one step of 0.4 s along the heading, which does not change.
    slope = 0.5 * params.max_v * params.dt * np.cos(state.robot.heading)
    np.testing.assert_allclose(jax.grad(lambda v: ahead(env.with_transition_gradients(), v))(0.0), slope, rtol=1e-5)


def test_people_are_those_of_the_worlds_scenes():
    assert gymnax_world.GymnaxWorld(World(WorldConfig(scenes=("corner",)))).default_params.preferred_speed == 1.2
