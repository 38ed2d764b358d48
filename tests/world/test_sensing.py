"""What the robot senses: maps against an independent rasteriser, frames, history, order, and snapshots that suffice."""

import itertools
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxnav.world import SCENES, Params, World, WorldConfig, sensing
from jaxnav.world.config import OBSERVATION_PARTS
from jaxnav.world.scenes import SIGHTS

PARAMS = Params()
FREE, UNKNOWN, HIT, ROBOT = 1.0, 200 / 255, 0.0, 100 / 255


def rasterise(ranges):
    """The sensor map `[48, 48]` in float64, cell by cell: where does the beam that is nearest to the cell end?"""
    beams = np.linspace(-np.pi / 2, np.pi / 2, len(ranges))
    grid = np.full((48, 48), UNKNOWN)
    for row in range(48):
        for column in range(48):
            x, y = 3 - (row + 0.5) * 0.125, 3 - (column + 0.5) * 0.125
            distance, angle = np.hypot(x, y), np.arctan2(y, x)
            if distance <= 0.17:
                grid[row, column] = ROBOT
            elif x > 0:
                r = float(ranges[np.argmin(np.abs(beams - angle))])
                # Where a beam through the cell's centre would end, in cells.
                at = np.floor(np.array([3 - r * np.cos(angle), 3 - r * np.sin(angle)]) / 0.125)
                grid[row, column] = HIT if np.all(at == [row, column]) else FREE if r > distance else UNKNOWN
    return grid


@pytest.mark.parametrize("seed", range(6))
def test_sensor_map_is_the_rasterised_scan(seed):
    """Random ranges, coherent ones like walls, a near miss of everything."""
    rng = np.random.default_rng(seed)
    ranges = [
        rng.uniform(0.2, 4.0, 180), np.repeat(rng.uniform(0.3, 3.5, 18), 10), np.full(180, 12.0), np.full(180, 0.1),
        1.7 / np.maximum(np.cos(np.linspace(-np.pi / 2, np.pi / 2, 180)), 0.1), rng.uniform(0.2, 4.0, 37),
    ][seed].astype(np.float32)  # fmt: skip
    np.testing.assert_allclose(sensing.sensor_map(ranges, PARAMS), rasterise(ranges), atol=1e-6)


def test_sensor_map_is_ahead_in_row_0_and_left_in_column_0():
    ranges = np.full(181, 12.0, np.float32)
    ranges[135] = 2.0  # 45 degrees to the left
    grid = np.asarray(sensing.sensor_map(ranges, PARAMS))
    assert np.argwhere(grid == HIT).tolist() == [[12, 12]]  # x = y = 1.41: 1.59 / 0.125 = 12.7 from the top and left
    assert grid[11, 11] == pytest.approx(UNKNOWN)
    assert grid[13, 13] == FREE
    assert grid[12, 35] == FREE  # its mirror image to the right
    np.testing.assert_allclose(grid[23:25, 23:25], ROBOT)
    np.testing.assert_allclose(grid[26:], UNKNOWN)


def test_pedestrian_map_against_a_rasteriser():
    rng = np.random.default_rng(0)
    for _ in range(5):
        listed = rng.uniform(-3.3, 3.3, (4, 4)).astype(np.float32)
        expected = np.zeros((3, 48, 48))
        for x, y, vx, vy in listed[::-1]:
            for row in range(48):
                for column in range(48):
                    gap = np.hypot(3 - (row + 0.5) * 0.125 - x, 3 - (column + 0.5) * 0.125 - y)
                    if gap <= 0.3 and abs(x) <= 3 and abs(y) <= 3:
                        expected[:, row, column] = 1.0, vx, vy
        np.testing.assert_allclose(sensing.pedestrian_map(jnp.array(listed), jnp.ones(4, bool)), expected, atol=1e-6)


def test_pedestrian_map_in_the_world_is_in_the_robot_frame(crowd, situation):
    """Robot at (1, 1) facing +y; a walker 2 m north of it going west: ahead of it, going left."""
    state = situation(
        robot=(1.0, 1.0, np.pi / 2), twist=(0.6, 0.0),
        pedestrians=[(1.0, 3.0, -4.0, 3.0), *[(-4.5, y, -4.5, y) for y in (-4.0, -3.0, -2.0, -1.0, 0.0)]],
    )  # fmt: skip
    occupied, vx, vy = np.asarray(crowd.observe(state, PARAMS).pedestrian_map)
    rows, columns = np.nonzero(occupied)
    assert 3 - (rows.mean() + 0.5) * 0.125 == pytest.approx(2.0, abs=1e-4)
    assert 3 - (columns.mean() + 0.5) * 0.125 == pytest.approx(0.0, abs=1e-4)
    assert occupied.sum() * 0.125**2 == pytest.approx(np.pi * 0.3**2, rel=0.15)
    # The robot's own velocity is not subtracted.
    np.testing.assert_allclose(vx, 0.0 * occupied, atol=1e-6)
    np.testing.assert_allclose(vy, 0.5 * occupied, atol=1e-6)


def test_the_nearest_pedestrians_are_listed_in_order_in_the_robot_frame(crowd, situation):
    rng = np.random.default_rng(1)
    places, robot = rng.uniform(-4, 4, (6, 4)), (0.7, -0.4, 2.1)
    state = situation(robot=robot, pedestrians=places, message=np.arange(6) % 4, request_age=np.arange(6))
    seen = crowd.observe(state, PARAMS)
    order = np.argsort(np.hypot(places[:, 0] - 0.7, places[:, 1] + 0.4))[:4]
    forward, left = np.array([np.cos(2.1), np.sin(2.1)]), np.array([-np.sin(2.1), np.cos(2.1)])
    relative = places[order, :2] - np.array(robot[:2])
    velocity = np.stack([state.pedestrians.vx, state.pedestrians.vy], axis=1)[order]
    expected = np.stack([relative @ forward, relative @ left, velocity @ forward, velocity @ left], axis=1)
    np.testing.assert_allclose(seen.pedestrians, expected, atol=1e-5)
    np.testing.assert_array_equal(seen.dialogue.message, order % 4)
    np.testing.assert_array_equal(seen.dialogue.request_age, order)


def test_pose_history_starts_with_zeros_then_holds_the_goal_in_the_robot_frame(default, situation, action):
    state = situation(robot=(0.0, 0.0, 0.5), goal=(3.0, 1.0))
    poses = []
    for _ in range(5):
        poses.append(np.asarray(default.observe(state, PARAMS).pose))
        np.testing.assert_allclose(poses[-1][-1], pose_of(state), atol=1e-5)
        state, _ = default.act(state, action(v=0.4, w=0.6))
    assert np.all(poses[0][:2] == 0)
    assert np.all(poses[1][0] == 0)
    for before, after in itertools.pairwise(poses):
        np.testing.assert_array_equal(after[:2], before[1:])  # oldest first
    assert poses[4][2, 2] == pytest.approx(-4 * 0.6 * 0.4, abs=1e-5)


def pose_of(state):
    """(goal x, goal y, turned) by complex numbers."""
    robot = jax.tree.map(float, state.robot.replace(past=0.0))
    goal = (robot.goal_x - robot.x + 1j * (robot.goal_y - robot.y)) * np.exp(-1j * robot.heading)
    return goal.real, goal.imag, robot.start_heading - robot.heading


def test_twist_is_that_of_the_last_step(default, situation, action):
    state, _ = default.act(situation(), action(v=0.45, w=-0.3))
    np.testing.assert_allclose(default.observe(state, PARAMS).twist, [0.45, -0.3], atol=1e-6)


def test_the_scan_sees_bodies_of_their_radius(default, situation):
    state = situation(pedestrians=[(2.0, 0.0, 2.0, 0.0)])
    for radius in (0.1, 0.3):
        scan = np.asarray(default.observe(state, PARAMS.replace(body_radius=radius)).scan)
        assert scan.min() == pytest.approx(2.0 - radius, abs=2e-3)  # no beam is quite ahead
        assert (scan < 2.0).sum() == pytest.approx(2 * np.arcsin(radius / 2) / (np.pi / 179), abs=1)


def test_rendering_a_snapshot_is_observing_bit_by_bit(crowd, situation, action):
    """One jitted function renders what it is given, at the time of acting and from what replay has stored."""
    render = jax.jit(crowd.world.observe_snapshot)
    state = situation(pedestrians=np.random.default_rng(0).uniform(-3, 3, (6, 4)), first_draw=0.0)
    for _ in range(4):
        state, _ = crowd.act(state, action(0.5, 0.3, request=1))
        snapshot = crowd.world.snapshot(state)
        stored = jax.tree.map(lambda leaf: np.array(leaf, copy=True), snapshot)
        now, later = render(snapshot, PARAMS), render(stored, PARAMS)
        jax.tree.map(np.testing.assert_array_equal, now, later)
        # Observing is rendering a snapshot; in another compilation the last bits may differ.
        jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, atol=1e-5), now, crowd.observe(state, PARAMS))


@pytest.mark.parametrize(("name", "pedestrians"), [("default", 1), ("crowd", 6)])
def test_snapshots_are_small(name, pedestrians, request):
    world = request.getfixturevalue(name).world
    state = jax.eval_shape(world.reset, jax.random.key(0), PARAMS)
    snapshot = jax.eval_shape(world.snapshot, state)
    size = sum(leaf.size * leaf.dtype.itemsize for leaf in jax.tree.leaves(snapshot))
    assert size <= 100 + 64 * (pedestrians - 1)


def test_parts_left_out_are_none(variant, situation):
    seen = variant.observe(situation(), PARAMS)
    assert (seen.pedestrians, seen.sensor_map, seen.pedestrian_map) == (None, None, None)
    assert seen.scan.shape == (180,)


def crosses(p, q, a, b):
    """Whether open segments p-q and a-b have a point in common: parameters of the meeting point, float64."""
    d, e = q - p, b - a
    determinant = d[0] * e[1] - d[1] * e[0]
    if determinant == 0:
        return False
    s = ((a[0] - p[0]) * e[1] - (a[1] - p[1]) * e[0]) / determinant
    t = ((a[0] - p[0]) * d[1] - (a[1] - p[1]) * d[0]) / determinant
    return 0 < s < 1 and 0 < t < 1


@pytest.mark.parametrize("name", ["crosswalk", "doorway", "corner"])
def test_in_sight_are_those_whom_no_wall_hides(name):
    """Against every wall crossed by hand, from random poses in and out of the rooms."""
    world = World(WorldConfig(scenes=(name,)))
    edges = [(a, b) for chain in SCENES[name].chains for a, b in itertools.pairwise(np.array([*chain, chain[0]]))]
    rng = np.random.default_rng(0)
    robots, people = rng.uniform(-6, 6, (200, 2)), rng.uniform(-6, 6, (200, 5, 2))
    seen = {
        sight: np.asarray(_in_sight(robots.astype(np.float32), people.astype(np.float32), world.walls(0), sight))
        for sight in range(3)
    }
    expected = np.array(
        [[not any(crosses(p, q, *edge) for edge in edges) for q in row] for p, row in zip(robots, people, strict=True)]
    )
    assert 0.1 < expected.mean() < 0.9
    np.testing.assert_array_equal(seen[SIGHTS.index("line")], expected)
    assert seen[SIGHTS.index("all")].all()
    assert not seen[SIGHTS.index("none")].any()


@jax.jit
def _in_sight(robots, people, walls, sight):
    def one(robot, others):
        return sensing.in_sight_of(Point(*robot), Point(*others.T), walls, sight)

    return jax.vmap(one)(robots, people)


class Point(NamedTuple):
    x: jax.Array
    y: jax.Array


def test_a_row_is_seen_or_zero(situation):
    """In the corner: one in the robot's own arm, a nearer one behind the corner; both are heard."""
    world = World(WorldConfig(scenes=("corner",), pedestrians=2, observation=OBSERVATION_PARTS))
    state = situation(
        robot=(-1.5, 0.5, 0.0), pedestrians=[(-4.0, 0.0, 4.0, 0.0), (-0.5, 1.5, -0.5, -4.0)], is_open=True,
        pedestrian_first=True, message=np.array([1, 2]),
    )  # fmt: skip
    seen = jax.jit(world.observe)(state, PARAMS)
    assert seen.seen.tolist() == [False, True]  # nearest first
    assert not np.any(seen.pedestrians[0])
    np.testing.assert_allclose(seen.pedestrians[1], [-2.5, -0.5, 0.5, 0.0], atol=1e-5)
    np.testing.assert_array_equal(seen.dialogue.message, [2, 1])
    # The map shows those who are seen.
    rows, columns = np.nonzero(seen.pedestrian_map[0])
    assert 3 - (rows.mean() + 0.5) * 0.125 == pytest.approx(-2.5, abs=0.05)
    assert 3 - (columns.mean() + 0.5) * 0.125 == pytest.approx(-0.5, abs=0.05)
