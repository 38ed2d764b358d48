"""A map as a scene of the world: the same episodes with walls looked up by cell and with all of them."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxnav import Action, Params, World, WorldConfig
from jaxnav.agents.scripted import StraightLine
from jaxnav.maps import polygons, visibility
from jaxnav.training.config import WorldSettings
from jaxnav.world.geometry import Vec2
from jaxnav.world.walls import time_to_walls, wall_clearance

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
            state, outcome = world.step(key, state, Action(twist=twist, request=jnp.int32(1)), params)
            late = params.replace(scan_latency=2.0)
            return state, (state, outcome, world.observe(state, params).scan, world.observe(state, late).scan)

        start = world.reset(key_reset, params)
        return jax.lax.scan(step, start, (jax.random.split(key_steps, STEPS), twists))[1]

    return world, jax.tree.map(np.asarray, episode(jax.random.split(jax.random.key(0), EPISODES)))


@pytest.fixture(scope="module")
def played(office):
    return play(office, 4)


def test_walls_by_cell_give_the_episodes_of_all_walls(office, played):
    _, (states, outcomes, *scans) = played
    _, (all_states, all_outcomes, *all_scans) = play(dataclasses.replace(office, cells=None), 4)
    ended = np.cumsum(outcomes.terminated, axis=1) - outcomes.terminated > 0  # a robot in a wall may see otherwise
    np.testing.assert_allclose(states.pedestrians.x, all_states.pedestrians.x, atol=1e-4)
    np.testing.assert_allclose(states.pedestrians.y, all_states.pedestrians.y, atol=1e-4)
    np.testing.assert_array_equal(outcomes.collided[~ended], all_outcomes.collided[~ended])
    for scan, other in zip(scans, all_scans, strict=True):
        np.testing.assert_allclose(scan[~ended], other[~ended], atol=1e-3, rtol=1e-3)
    assert outcomes.collided.any() and ended.mean() < 0.8


def test_pedestrians_stay_within_the_walls(played):
    world, (states, *_) = played
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
            return world.step(key, state, StraightLine()(state, world, params), params)[0], None

        return jax.lax.scan(step, world.reset(key, params), jax.random.split(key, 30))[0].min_distance

    assert np.mean(np.asarray(minimum(jax.random.split(jax.random.key(1), 512))) < 0.3) > 0.3


def test_a_laser_that_reaches_farther_than_the_map_was_loaded_for_is_refused(office):
    world = World(WorldConfig(scenes=(office.name,)), [office])
    with pytest.raises(ValueError, match=r"scan_range is 20.*office.yaml.*12"):
        world.reset(jax.random.key(0), Params(scan_range=20.0))


@pytest.mark.parametrize("change", [{"dt": 2.0}, {"max_v": 0.7}, {"robot_radius": 0.2}, {"dt": np.array([0.4, 0.5])}])
def test_a_body_that_gets_farther_than_the_map_was_loaded_for_is_refused(office, change):
    """Walls that it might touch could be missing in the list of its cell."""
    world = World(WorldConfig(scenes=(office.name,)), [office])
    ((name, value),) = change.items()
    with pytest.raises(ValueError, match=r"world.params.dt is .*office.yaml.* 0.3 m; give smaller ones") as error:
        world.reset(jax.random.key(0), Params(**change))
    assert f"world.params.{name} is {value}" in str(error.value)


def test_settings_load_a_map_for_their_own_laser_and_body(office):
    params = Params(dt=1.0, max_v=1.5, robot_radius=0.25, scan_range=20.0)
    world = WorldSettings(scenes=(office.name,), params=params).world()
    assert world.walls(0).cells.margin == pytest.approx(1.0) and world.walls(0).cells.scan_range == 20.0
    jax.eval_shape(lambda key: world.reset(key, jax.tree.map(np.float32, params)), jax.random.key(0))


@pytest.mark.parametrize("seed", range(4))
def test_contacts_are_those_with_all_walls_up_to_the_margin(office, flat, seed):
    """Bodies of 0.5 m that drive 2.5 m from anywhere in a cave of sharp corners, by the world's own search."""
    radius, chord = 0.5, 2.5
    chains = polygons.wall_chains(polygons.simple_border(flat.blobs(seed, (24, 30))), 1.0)
    flat_walls = flat.wall_array(chains)
    rng = np.random.default_rng(seed)
    points = rng.uniform((0, 0), (30, 24), (20_000, 2))
    points = points[flat.inside(points, flat_walls)]
    points = points[flat.distances(points, flat_walls) > radius]
    west, east = points[np.argmin(points[:, 0])], points[np.argmax(points[:, 0])]

    def meet(numbers, *_):
        return [[jnp.full_like(numbers[0], a) for a in route] for route in ((*west, *east), (*east, *west, *west))]

    cave = dataclasses.replace(
        office, chains=tuple(tuple(map(tuple, chain.tolist())) for chain in chains), meet=meet,
        cells=visibility.visible_walls(chains, 0.5, radius + chord, 12.0),
    )  # fmt: skip
    walls = World(WorldConfig(scenes=(cave.name,)), [cave]).walls(0)
    angles = rng.uniform(-np.pi, np.pi, len(points))

    def time(x, y, angle, walls):
        return time_to_walls(Vec2(x, y), chord * Vec2(jnp.cos(angle), jnp.sin(angle)), walls.near(x, y), radius)

    listed, every = (
        np.asarray(jax.jit(jax.vmap(time, in_axes=(0, 0, 0, None)))(*points.T, angles, w))
        for w in (walls, walls.replace(cells=None))
    )
    np.testing.assert_allclose(listed, every, atol=1e-5)
    assert np.isfinite(every).sum() > 50
