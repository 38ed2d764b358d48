"""The linear programs against enumeration in float64, and their gradients against finite differences."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from jaxnav.world import linear_program
from jaxnav.world.geometry import Vec2
from jaxnav.world.orca import HalfPlane

TOLERANCE = 3e-4
WALLS, AGENTS = 2, 4
MAX_SPEED = 1.0


@jax.jit
def solve(planes, preferred):
    """The velocity for planes `[WALLS + AGENTS]`: normal, offset along it (permitted beyond), active."""
    nx, ny, offset, active = planes
    normals = [Vec2(nx[i], ny[i]) for i in range(len(nx))]
    planes = [HalfPlane(normal * offset[i], normal.right(), active[i]) for i, normal in enumerate(normals)]
    return jnp.stack(linear_program.solve(planes[:WALLS], planes[WALLS:], Vec2(*preferred), MAX_SPEED))


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


@pytest.mark.parametrize("far", [1.0, 300.0])
def test_a_line_given_by_a_far_point_is_cut_at_the_speed_limit_all_the_same(far):
    """Half-plane y >= 0.6 by a point on its border, preferred velocity beyond where border and disc meet."""
    plane = HalfPlane(Vec2(*np.float32([far, 0.6])), Vec2(*np.float32([1.0, 0.0])), active=np.bool_(True))
    v = linear_program.solve([plane], [], Vec2(np.float32(3.0), np.float32(0.0)), MAX_SPEED)
    np.testing.assert_allclose(v, [0.8, 0.6], atol=1e-4)


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
