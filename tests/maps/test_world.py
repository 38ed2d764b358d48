"""A map as a scene of the world: the same episodes with walls looked up by cell and with all of them."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxnav import Action, Params, World, WorldConfig
from jaxnav.agents.scripted import straight_line
from jaxnav.world.walls import wall_clearance

EPISODES, STEPS = 64, 25


def play(scene, pedestrians):
    """States after each of the steps of random robots, and their scans."""
    world, params = World(WorldConfig(scenes=(scene.name,), pedestrians=pedestrians, scan_delay=2), [scene]), Params()

    @jax.jit
    @jax.vmap
    def episode(key):
        key_reset, key_twist, key_steps = jax.random.split(key, 3)
        twists = jax.random.uniform(key_twist, (STEPS, 2), minval=jnp.array([-0.2, -1.0]), maxval=1.0)

        def step(state, key_and_twist):
            key, twist = key_and_twist
            state, outcome = world.step(key, state, Action(twist=twist, code=jnp.int32(1)), params)
            late = params.replace(scan_latency=2.0)
            return state, (state, outcome, world.observe(state, params).scan, world.observe(state, late).scan)

        start = world.reset(key_reset, params)
        return jax.lax.scan(step, start, (jax.random.split(key_steps, STEPS), twists))[1]

    return world, jax.tree.map(np.asarray, episode(jax.random.split(jax.random.key(0), EPISODES)))


def test_walls_by_cell_give_the_episodes_of_all_walls(office):
    _, (states, outcomes, *scans) = play(office, 4)
    _, (all_states, all_outcomes, *all_scans) = play(dataclasses.replace(office, cells=None), 4)
    ended = np.cumsum(outcomes.terminated, axis=1) - outcomes.terminated > 0  # a robot in a wall may see otherwise
    np.testing.assert_allclose(states.pedestrians.x, all_states.pedestrians.x, atol=1e-4)
    np.testing.assert_allclose(states.pedestrians.y, all_states.pedestrians.y, atol=1e-4)
    np.testing.assert_array_equal(outcomes.collided[~ended], all_outcomes.collided[~ended])
    for scan, other in zip(scans, all_scans, strict=True):
        np.testing.assert_allclose(scan[~ended], other[~ended], atol=1e-3, rtol=1e-3)
    assert outcomes.collided.any() and ended.mean() < 0.8


def test_pedestrians_stay_within_the_walls(office):
    world, (states, *_) = play(office, 4)
    walls = world.walls(0)
    clear = wall_clearance(states.pedestrians.x.ravel(), states.pedestrians.y.ravel(), walls)
    assert clear.min() >= Params().body_radius - 1e-3


def test_a_straight_robot_meets_somebody(office):
    """People are timed to be met: a scene worth training on."""
    world = World(WorldConfig(scenes=(office.name,)), [office])
    params = Params()

    @jax.jit
    @jax.vmap
    def minimum(key):
        def step(state, key):
            return world.step(key, state, straight_line(None, state, world, params), params)[0], None

        return jax.lax.scan(step, world.reset(key, params), jax.random.split(key, 30))[0].min_distance

    assert np.mean(np.asarray(minimum(jax.random.split(jax.random.key(1), 512))) < 0.3) > 0.3


def test_a_laser_that_reaches_farther_than_the_map_was_loaded_for_is_refused(office):
    world = World(WorldConfig(scenes=(office.name,)), [office])
    with pytest.raises(ValueError, match=r"scan_range is 20.*office.yaml.*12"):
        world.reset(jax.random.key(0), Params(scan_range=20.0))
