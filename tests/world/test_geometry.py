"""Geometry against closed forms, dense sampling, and its promise of finite gradients."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from jaxnav.world import geometry
from jaxnav.world.geometry import Vec2

coordinate = st.floats(-3.0, 3.0)
radius = st.floats(0.05, 1.0)
TIMES = np.linspace(0.0, 1.0, 4001)

time_to_disc = jax.jit(lambda px, py, ex, ey, radius: geometry.time_to_disc(Vec2(px, py), Vec2(ex, ey), radius))
closest_approach = jax.jit(
    lambda px, py, ex, ey, horizon: geometry.closest_approach(Vec2(px, py), Vec2(ex, ey), horizon)
)
closest_on_segment = jax.jit(
    lambda px, py, ax, ay, bx, by: geometry.closest_on_segment(Vec2(px, py), Vec2(ax, ay), Vec2(bx, by))
)


@jax.jit
def time_to_wall(px, py, ex, ey, ax, ay, bx, by, radius):
    """First contact of a moving disc with a segment: both ends and the side."""
    p, e, a, b = Vec2(px, py), Vec2(ex, ey), Vec2(ax, ay), Vec2(bx, by)
    ends = [geometry.time_to_disc(p - end, e, radius) for end in (a, b)]
    return jnp.minimum(jnp.minimum(*ends), geometry.time_to_slab(p, e, a, b, radius))


def distance_to_segment(points, a, b):
    """float64 distance of points `[N, 2]` to segment a-b."""
    edge = b - a
    t = np.clip((points - a) @ edge / max(edge @ edge, 1e-30), 0.0, 1.0)
    return np.linalg.norm(points - a - t[:, None] * edge, axis=1)


def assert_first_contact(t, distance, at, radius):
    """t is the first time with a distance <= radius, ``distance`` those of TIMES; grazes within 1 mm go either way."""
    before = distance[t > TIMES]
    assert before.size == 0 or before.min() > radius - 1e-3
    if t <= 1:
        assert at(t) == pytest.approx(radius, abs=1e-3) or (t == 0 and at(0.0) < radius)


@given(coordinate, coordinate, coordinate, coordinate, radius)
def test_time_to_disc_is_the_first_contact(px, py, ex, ey, radius):
    def at(t):
        return np.hypot(px + t * ex, py + t * ey)

    t = float(time_to_disc(px, py, ex, ey, radius))
    assert 0 <= t <= 1 or t == np.inf
    assert_first_contact(t, at(TIMES), at, radius)


@given(*[coordinate] * 8, radius)
def test_time_to_wall_is_the_first_contact(px, py, ex, ey, ax, ay, bx, by, radius):
    def at(t):
        points = np.array([px, py]) + np.atleast_1d(t)[:, None] * np.array([ex, ey])
        return distance_to_segment(points, np.array([ax, ay]), np.array([bx, by]))

    assume(np.hypot(bx - ax, by - ay) > 1e-3)
    t = float(time_to_wall(px, py, ex, ey, ax, ay, bx, by, radius))
    assert_first_contact(t, at(TIMES), lambda t: at(t)[0], radius)


@pytest.mark.parametrize(
    ("p", "e", "expected"),
    [
        ((-2.0, 0.0), (4.0, 0.0), 0.375),
        ((-1.0, 0.5), (4.0, 0.0), 0.25),  # grazes
        ((-1.0, 0.51), (4.0, 0.0), np.inf),
        ((-2.0, 0.0), (1.5, 0.0), 1.0),  # touches at the very end
        ((-2.0, 0.0), (1.49, 0.0), np.inf),
        ((-2.0, 0.0), (-4.0, 0.0), np.inf),
        ((0.3, 0.0), (4.0, 0.0), 0.0),  # within already
        ((1.0, 0.0), (0.0, 0.0), np.inf),
    ],
)
def test_time_to_disc_closed_form(p, e, expected):
    assert float(time_to_disc(*p, *e, 0.5)) == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize(
    ("p", "e", "expected"),
    [
        ((0.0, 2.0), (0.0, -3.0), 0.5),  # onto the side, from either side of it
        ((0.0, -2.0), (0.0, 3.0), 0.5),
        ((3.0, 0.0), (-3.0, 0.0), 0.5),  # along the wall's line onto its end
        ((2.0, 0.3), (-1.0, 0.0), 0.6),  # onto the end's corner: 1 + 0.4 from the centre
        ((0.0, 2.0), (3.0, 0.0), np.inf),
        ((0.0, 0.4), (0.0, 3.0), 0.0),  # overlapping, moving away
        ((1.7, 0.2), (0.0, -1.0), np.inf),  # level with the wall beyond its end
    ],
)
def test_time_to_wall_closed_form(p, e, expected):
    assert float(time_to_wall(*p, *e, -1.0, 0.0, 1.0, 0.0, 0.5)) == pytest.approx(expected, abs=1e-6)


def test_a_wall_of_length_0_has_no_side():
    assert geometry.time_to_slab(Vec2(0.0, 2.0), *[Vec2(0.0, 0.0)] * 3, 0.5) == np.inf


@given(*[coordinate] * 4, st.floats(0.1, 5.0))
def test_closest_approach_is_the_smallest_distance(px, py, ex, ey, horizon):
    t = float(closest_approach(px, py, ex, ey, horizon))
    sampled = np.hypot(px + horizon * TIMES * ex, py + horizon * TIMES * ey)
    assert 0 <= t <= np.float32(horizon)
    assert np.hypot(px + t * ex, py + t * ey) <= sampled.min() + 1e-3


@given(*[coordinate] * 6)
def test_closest_on_segment_is_nearest_and_on_it(px, py, ax, ay, bx, by):
    p, a, b = np.array([px, py]), np.array([ax, ay]), np.array([bx, by])
    q = np.array(closest_on_segment(px, py, ax, ay, bx, by), np.float64)
    assert distance_to_segment(q[None], a, b)[0] < 1e-5
    assert np.linalg.norm(p - q) == pytest.approx(distance_to_segment(p[None], a, b)[0], abs=1e-5)


@given(coordinate, coordinate, st.floats(-4.0, 4.0))
def test_frames_are_inverse_and_left_is_positive(x, y, angle):
    cos, sin = np.cos(angle), np.sin(angle)
    turned = cos * x - sin * y, sin * x + cos * y
    np.testing.assert_allclose(geometry.to_frame(*turned, cos, sin), (x, y), atol=1e-5)
    assert geometry.cross2d(cos, sin, -sin, cos) == pytest.approx(1.0, abs=1e-5)


DEGENERATE = {
    "norm of zero": (geometry.norm, (0.0, 0.0)),
    "unit of zero": (geometry.unit, (0.0, 0.0)),
    "root of a negative": (geometry.safe_sqrt, (-1.0,)),
    "point on a segment of length 0": (geometry.closest_on_segment, (Vec2(1.0, 1.0), Vec2(1.0, 1.0), Vec2(1.0, 1.0))),
    "resting at the origin": (geometry.closest_approach, (Vec2(0.0, 0.0), Vec2(0.0, 0.0))),
    "disc, coincident and at rest": (geometry.time_to_disc, (Vec2(0.0, 0.0), Vec2(0.0, 0.0), 0.5)),
    "disc, at rest outside": (geometry.time_to_disc, (Vec2(1.0, 0.0), Vec2(0.0, 0.0), 0.5)),
    "disc, grazing": (geometry.time_to_disc, (Vec2(-1.0, 0.5), Vec2(4.0, 0.0), 0.5)),
    "disc, missing": (geometry.time_to_disc, (Vec2(-1.0, 2.0), Vec2(4.0, 0.0), 0.5)),
    "disc, touching at the start": (geometry.time_to_disc, (Vec2(-0.5, 0.0), Vec2(1.0, 0.0), 0.5)),
    "wall, moving along it": (
        geometry.time_to_slab,
        (Vec2(0.0, 1.0), Vec2(1.0, 0.0), Vec2(-1.0, 0.0), Vec2(1.0, 0.0), 0.5),
    ),
    "wall, on it and at rest": (
        geometry.time_to_slab,
        (Vec2(0.0, 0.0), Vec2(0.0, 0.0), Vec2(-1.0, 0.0), Vec2(1.0, 0.0), 0.5),
    ),
    "wall of length 0": (geometry.time_to_slab, (Vec2(0.0, 1.0), Vec2(0.0, -1.0), Vec2(0.0, 0.0), Vec2(0.0, 0.0), 0.5)),
}


@pytest.mark.parametrize("case", DEGENERATE)
def test_gradients_are_finite_where_the_geometry_degenerates(case):
    function, point = DEGENERATE[case]
    jacobians = jax.jacrev(function, argnums=tuple(range(len(point))))(*point)
    assert all(np.all(np.isfinite(leaf)) for leaf in jax.tree.leaves(jacobians))


def test_a_vector_computes_what_its_two_numbers_do():
    a, b = Vec2(3.0, -4.0), Vec2(0.5, 2.0)
    assert (a + b, a - b, -a, 2.0 * a, a * 2.0, a / 2.0) == (
        (3.5, -2.0), (2.5, -6.0), (-3.0, 4.0), (6.0, -8.0), (6.0, -8.0), (1.5, -2.0),
    )  # fmt: skip
    assert np.float32(2.0) * a == jnp.float32(2.0) * a == (6.0, -8.0)
    assert (a.dot(b), a.cross(b), a.squared(), a.left(), a.right()) == (-6.5, 8.0, 25.0, (4.0, 3.0), (-4.0, -3.0))
    assert float(a.norm()) == 5.0
    np.testing.assert_allclose(a.unit(), (0.6, -0.8), rtol=1e-6)
    np.testing.assert_allclose(a.in_frame(Vec2(0.0, 1.0)), (-4.0, -3.0))
    many = geometry.where(np.array([True, False]), Vec2(np.ones(2), np.zeros(2)), Vec2(np.zeros(2), np.ones(2)))
    np.testing.assert_array_equal(many, [[1, 0], [0, 1]])


def test_the_gradient_of_a_vector_of_length_zero_is_finite():
    gradient = jax.grad(lambda x: Vec2(x, 0.0).norm() + sum(Vec2(0.0, x).unit()))(0.0)
    assert np.isfinite(gradient)
