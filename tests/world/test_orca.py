"""ORCA: closed forms, the linear programs against enumeration in float64, and RVO2 itself."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from jaxnav.world import Params, Walls, WorldConfig, orca
from jaxnav.world.pedestrian import walk

TOLERANCE = 3e-4
WALLS, AGENTS = 2, 4
MAX_SPEED = 1.0

half_plane = jax.jit(orca.agent_half_plane)


def permitted_border(plane):
    """(point of the border nearest to the origin, normal toward the permitted side)."""
    normal = np.array([-plane.dy, plane.dx])
    return normal * (normal @ np.array([plane.x, plane.y])), normal


def test_head_on_each_takes_half_of_the_avoidance():
    """Two agents heading for each other: the half-planes mirror each other, and both on the border just touch."""
    p, speed, radius, horizon = np.array([4.0, 0.1]), 0.5, 0.4, 5.0
    mine = half_plane(*p, speed, 0.0, -speed, 0.0, radius, horizon, 0.4, True)
    other = half_plane(*-p, -speed, 0.0, speed, 0.0, radius, horizon, 0.4, True)
    (_, normal), (_, normal_of_other) = permitted_border(mine), permitted_border(other)
    np.testing.assert_allclose(normal, -normal_of_other, atol=1e-6)
    v = np.array([speed, 0.0]) + normal * float(mine.violation(speed, 0.0))
    v_other = np.array([-speed, 0.0]) + normal_of_other * float(other.violation(-speed, 0.0))
    assert float(mine.violation(speed, 0.0)) == pytest.approx(float(other.violation(-speed, 0.0)), abs=1e-6)
    times = np.linspace(0, horizon, 20001)[:, None]
    assert np.linalg.norm(p + times * (v_other - v), axis=1).min() == pytest.approx(radius, abs=1e-4)


def test_agent_on_the_cut_off_circle_stays_on_it():
    """Relative velocity at the front of the obstacle p / tau - r / tau: no change is demanded."""
    v = (2.0 - 0.5) / 5.0
    plane = half_plane(2.0, 0.0, v, 0.0, 0.0, 0.0, 0.5, 5.0, 0.4, True)
    point, normal = permitted_border(plane)
    np.testing.assert_allclose(point, [v, 0.0], atol=1e-6)
    np.testing.assert_allclose(normal, [-1.0, 0.0], atol=1e-6)


@pytest.mark.parametrize("side", [1, -1])
def test_agent_on_a_leg_stays_on_it(side):
    """A velocity along the tangent from the origin to the disc, beyond the cut-off: the border is the leg itself."""
    angle = side * np.arcsin(0.5 / 2.0)
    v = 0.8 * np.array([np.cos(angle), np.sin(angle)])
    plane = half_plane(2.0, 0.0, *v, 0.0, 0.0, 0.5, 5.0, 0.4, True)
    point, normal = permitted_border(plane)
    np.testing.assert_allclose(point, [0, 0], atol=1e-6)
    np.testing.assert_allclose(normal, [-side * np.sin(angle), side * np.cos(angle)], atol=1e-6)
    assert plane.violation(0.8, 0.0) == pytest.approx(0.8 * 0.25, abs=1e-6)


def test_overlapping_agents_part_within_a_step_half_each():
    """At rest, 0.3 m of overlap, dt 0.4 s: each has to leave with 0.3 / 0.4 / 2."""
    plane = half_plane(0.2, 0.0, 0.0, 0.0, 0.0, 0.0, 0.5, 5.0, 0.4, True)
    assert plane.violation(0.0, 0.0) == pytest.approx(0.375, abs=1e-5)
    assert plane.violation(-0.375, 0.0) == pytest.approx(0.0, abs=1e-5)


def test_inactive_planes_forbid_nothing():
    plane = half_plane(0.2, 0.0, 0.0, 0.0, 0.0, 0.0, 0.5, 5.0, 0.4, False)
    assert orca.solve([], [plane], 0.5, 0.0, 1.0) == pytest.approx((0.5, 0.0))


@pytest.mark.parametrize(("distance", "limit"), [(0.6, 0.1), (0.1, 0.0), (0.06, -0.1)])
def test_wall_limits_the_speed_toward_it_and_pushes_out(distance, limit):
    """gap / horizon while clear; an overlap of 0.04 m is left within a step of 0.4 s."""
    plane = orca.wall_half_plane(0.0, distance, 0.1, 5.0, 0.4, True)
    assert plane.violation(3.0, limit) == pytest.approx(0.0, abs=1e-6)
    assert plane.violation(-3.0, limit + 0.2) == pytest.approx(0.2, abs=1e-6)


@jax.jit
def solve(planes, preferred):
    """`orca.solve` of planes `[WALLS + AGENTS, 5]`: angle of the normal, offset along it (permitted beyond), active."""
    nx, ny, offset, active = planes
    planes = [orca.HalfPlane(nx[i] * offset[i], ny[i] * offset[i], ny[i], -nx[i], active[i]) for i in range(len(nx))]
    return jnp.stack(orca.solve(planes[:WALLS], planes[WALLS:], *preferred, MAX_SPEED))


def vertices(normals, offsets, target):
    """Every point at which a convex program over half-planes ``n v >= offset`` and the disc can have its optimum."""
    points = [target if np.linalg.norm(target) <= MAX_SPEED else MAX_SPEED * target / np.linalg.norm(target)]
    for n, c in zip(normals, offsets, strict=True):
        tangent = np.array([-n[1], n[0]])
        points.append(n * c + tangent * (tangent @ target))
        if abs(c) <= MAX_SPEED:
            points += [n * c + side * tangent * np.sqrt(MAX_SPEED**2 - c * c) for side in (1, -1)]
    for (n, c), (m, d) in itertools.combinations(zip(normals, offsets, strict=True), 2):
        if abs(np.linalg.det([n, m])) > 1e-9:
            points.append(np.linalg.solve([n, m], [c, d]))
    return np.array(points)


def nearest_permitted(normals, offsets, target):
    """Distance to ``target`` of the nearest permitted velocity; inf if there is none."""
    points = vertices(normals, offsets, target)
    if len(normals):
        points = points[(points @ normals.T >= offsets - 1e-9).all(axis=1)]
    points = points[np.linalg.norm(points, axis=1) <= MAX_SPEED + 1e-9]
    return np.linalg.norm(points - target, axis=1).min(initial=np.inf)


def least_violation(normals, offsets, hard):
    """Smallest s so that planes that are not ``hard``, moved back by s, leave something; negative if s could shrink."""
    low, high = -3.0, 3.0
    while high - low > 1e-7:
        s = (low + high) / 2
        found = nearest_permitted(normals, np.where(hard, offsets, offsets - s), np.zeros(2)) < np.inf
        low, high = (low, s) if found else (s, high)
    return high


@st.composite
def programs(draw, crowded):
    """Half-planes in directions of whole degrees (some exactly parallel, none almost) and a preferred velocity."""
    count = WALLS + AGENTS
    angles = np.deg2rad(draw(st.lists(st.integers(0, 359), min_size=count, max_size=count)))
    lowest = 0 if crowded else -120
    offsets = [draw(st.integers(-60, 20)) / 100 for _ in range(WALLS)]
    offsets += [draw(st.integers(lowest, 90)) / 100 for _ in range(AGENTS)]
    active = np.array(draw(st.lists(st.booleans() if not crowded else st.just(True), min_size=count, max_size=count)))
    preferred = np.array([draw(st.integers(-150, 150)) / 100 for _ in range(2)])
    return np.stack([np.cos(angles), np.sin(angles)], axis=1), np.array(offsets), active, preferred


@pytest.mark.parametrize("crowded", [False, True])
@settings(max_examples=100)
@given(data=st.data())
def test_solve_finds_the_optimum(crowded, data):
    """Where permitted velocities exist: the nearest of them. Else: least violation of the agents with hard walls."""
    normals, offsets, active, preferred = data.draw(programs(crowded))
    hard = np.arange(WALLS + AGENTS) < WALLS
    assume(least_violation(normals[hard & active], offsets[hard & active], np.zeros(sum(hard & active), bool)) < -0.01)

    v = np.asarray(solve((*normals.T, offsets, active), preferred), np.float64)
    assert np.linalg.norm(v) <= MAX_SPEED + TOLERANCE
    slack = (normals @ v - offsets)[active]
    assert slack[hard[active]].min(initial=np.inf) >= -TOLERANCE
    least = least_violation(normals[active], offsets[active], hard[active])
    assert -slack[~hard[active]].min(initial=np.inf) <= max(least, 0.0) + TOLERANCE
    # A permitted region thinner than 1 mm/s may count as empty in float32: then only the violation is asked for.
    if least < -1e-3:
        best = nearest_permitted(normals[active], offsets[active], preferred)
        assert np.linalg.norm(v - preferred) <= best + TOLERANCE


def test_enumeration_agrees_with_a_grid():
    """The oracle of the test above, against a dense grid over the disc."""
    rng = np.random.default_rng(0)
    grid = np.stack(np.meshgrid(*[np.linspace(-1, 1, 401)] * 2), axis=-1).reshape(-1, 2)
    grid = grid[np.linalg.norm(grid, axis=1) <= MAX_SPEED]
    for _ in range(20):
        angles, offsets, target = rng.uniform(0, 2 * np.pi, 4), rng.uniform(-0.5, 0.5, 4), rng.uniform(-1, 1, 2)
        normals = np.stack([np.cos(angles), np.sin(angles)], axis=1)
        slack = (grid @ normals.T - offsets).min(axis=1)
        assert -slack.max() == pytest.approx(least_violation(normals, offsets, np.zeros(4, bool)), abs=0.01)
        if slack.max() > 0.05:
            permitted = grid[slack >= 0]
            best = np.linalg.norm(permitted - target, axis=1).min()
            assert best == pytest.approx(nearest_permitted(normals, offsets, target), abs=0.01)


def crowd_of(rng, count, size):
    """Positions, velocities and goals `[count, 2]` of a random crowd in a square of that size, nobody overlapping."""
    while True:
        at = rng.uniform(-size / 2, size / 2, (count, 2))
        gaps = np.linalg.norm(at[:, None] - at[None], axis=-1) + np.eye(count)
        if gaps.min() > 0.28:
            return at, rng.uniform(-0.4, 0.4, (count, 2)), rng.uniform(-4, 4, (count, 2))


NO_WALLS = Walls(x=np.zeros(2, np.float32), y=np.zeros(2, np.float32), solid=np.zeros(1, bool))


@pytest.fixture(scope="module")
def walk_freely():
    """A step of six pedestrians and the robot without walls, whose `walk` sees all within 3 m; `[N]` crowds at once."""
    config = WorldConfig(pedestrians=6)

    def step(state, params):
        return walk(state.pedestrians, state.encounters, state.fates, state.robot, NO_WALLS, config, params)

    return jax.jit(jax.vmap(step, in_axes=(0, None)))


@pytest.mark.parametrize("size", [1.2, 2.0, 4.0])
def test_crowds_walk_as_in_rvo2(size, walk_freely, situation):
    """New velocities of six pedestrians beside the robot, against the C++ library, dense (infeasible) to sparse."""
    rvo = pytest.importorskip("pyrvo")
    params = Params(awareness=3.0, neighbor_distance=3.0)
    rng = np.random.default_rng(0)
    states, expected = [], []
    for _ in range(60):
        at, velocity, goals = crowd_of(rng, 7, size)
        simulator = rvo.RVOSimulator(params.dt, 3.0, 10, params.time_horizon, 1.0, params.body_radius, params.max_speed)
        for i in range(7):
            simulator.add_agent(tuple(at[i]))
            simulator.set_agent_velocity(i, tuple(velocity[i]))
            away = np.linalg.norm(goals[i] - at[i])
            speed = min(params.preferred_speed, away / params.dt)
            simulator.set_agent_pref_velocity(i, tuple(speed * (goals[i] - at[i]) / away))
        simulator.set_agent_radius(6, params.robot_radius)
        simulator.do_step()
        expected.append([[*simulator.get_agent_velocity(i).to_tuple()] for i in range(6)])
        heading = np.arctan2(velocity[6, 1], velocity[6, 0])
        state = situation(
            robot=(*at[6], heading), twist=(np.linalg.norm(velocity[6]), 0.0), pedestrians=np.hstack([at, goals])[:6]
        )
        vx, vy = velocity[:6].T.astype(np.float32)
        states.append(state.replace(pedestrians=state.pedestrians.replace(vx=vx, vy=vy)))
    walked = walk_freely(jax.tree.map(lambda *leaves: np.stack(leaves), *states), params)
    np.testing.assert_allclose(np.stack([walked.vx, walked.vy], axis=-1), expected, atol=1e-4)


def test_solve_has_finite_gradients_where_it_is_infeasible_parallel_or_idle():
    def total(normals_x, normals_y, offsets, preferred):
        return jnp.sum(solve((normals_x, normals_y, offsets, np.ones(4, bool)), preferred))

    gradient = jax.jit(jax.grad(total, argnums=(0, 1, 2, 3)))
    for degrees, offset in (
        ([0, 90, 0, 180], 0.5),
        ([0, 0, 0, 0], -0.5),
        ([0, 120, 240, 30], 0.3),
        ([0, 90, 9, 9], 0.0),
    ):
        normals = np.cos(np.deg2rad(degrees)).astype(np.float32), np.sin(np.deg2rad(degrees)).astype(np.float32)
        for preferred in (np.zeros(2, np.float32), np.array([0.5, 0.0], np.float32)):
            leaves = gradient(*normals, np.full(4, offset, np.float32), preferred)
            assert all(np.all(np.isfinite(leaf)) for leaf in leaves)
