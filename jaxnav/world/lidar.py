"""Raycast: ranges from the robot to walls and discs, closed form, without marching."""

import jax
import jax.numpy as jnp
import numpy as np

from .geometry import Vec2, safe_sqrt
from .params import Params
from .types import Walls

_UNROLLED = 24  # walls up to which their loop is unrolled


def beam_directions(beams: int) -> Vec2:
    """Unit vectors `[B]` of the beams in the robot frame: right (-pi/2) to left (pi/2), both included."""
    angles = np.linspace(-np.pi / 2, np.pi / 2, beams)
    # cos(pi/2) is 6e-17 in floating point; an exact 0 keeps the outermost beams exactly sideways.
    cos = np.where(np.abs(angles) == np.pi / 2, 0.0, np.cos(angles))
    return Vec2(jnp.float32(cos), jnp.float32(np.sin(angles)))


def raycast(origin: Vec2, heading: Vec2, walls: Walls, directions: Vec2, max_range: jax.Array) -> jax.Array:
    """Ranges to the nearest wall along ``directions`` from ``origin``; at most ``max_range``.

    heading: unit vector of the frame's x axis; directions: unit vectors in that frame, `[B]` or one. A beam exactly
    along a wall misses it.
    """
    if walls.listed is not None or walls.solid.shape[0] > _UNROLLED:
        return _raycast_many(origin, heading, walls, directions, max_range)
    beam_x, beam_y = directions
    x, y = jnp.asarray(walls.x), jnp.asarray(walls.y)
    vertex = (Vec2(x, y) - origin).in_frame(heading)
    # A wall's own vector, not the difference of two vertices seen from here: a short wall far away keeps its digits.
    edge = Vec2(x[1:] - x[:-1], y[1:] - y[:-1]).in_frame(heading)
    area = Vec2(vertex.x[:-1], vertex.y[:-1]).cross(edge)
    solid = walls.solid & (jnp.abs(area) > 1e-9)
    scale = jnp.where(solid, 1.0 / jnp.where(solid, area, 1.0), 0.0)
    # 1 / range is linear in the beam's direction, so walls cost no division a beam; vertices are shared by two walls.
    slope_x, slope_y = scale * edge.y, -scale * edge.x
    inverse = jnp.full(jnp.shape(beam_x), 1.0) / max_range
    side_a = beam_x * vertex.y[0] - beam_y * vertex.x[0]
    for i in range(walls.solid.shape[0]):
        side_b = beam_x * vertex.y[i + 1] - beam_y * vertex.x[i + 1]
        candidate = beam_x * slope_x[i] + beam_y * slope_y[i]
        inverse = jnp.where(side_a * side_b <= 0, jnp.maximum(inverse, candidate), inverse)
        side_a = side_b
    return 1.0 / inverse


def _raycast_many(origin, heading, walls, directions, max_range):
    """`raycast` among many walls, one after the other: what unrolling them would compile is too much."""

    def nearer(inverse, wall):
        a, edge, b, scale = wall
        side_a, side_b = directions.cross(a), directions.cross(b)
        candidate = scale * directions.cross(edge)
        return jnp.where(side_a * side_b <= 0, jnp.maximum(inverse, candidate), inverse), None

    ax, ay, bx, by, solid = walls.segments()
    a, b = Vec2(ax, ay), Vec2(bx, by)
    edge, a, b = (vector.in_frame(heading) for vector in (b - a, a - origin, b - origin))
    area = a.cross(edge)
    solid &= jnp.abs(area) > 1e-9
    scale = jnp.where(solid, 1.0 / jnp.where(solid, area, 1.0), 0.0)
    start = jnp.full(jnp.shape(directions.x), 1.0) / max_range
    return 1.0 / jax.lax.scan(nearer, start, (a, edge, b, scale), unroll=8)[0]


def raycast_discs(
    ranges: jax.Array, origin: Vec2, heading: Vec2, discs: Vec2, radius: jax.Array, directions: Vec2
) -> jax.Array:
    """``ranges`` `[B]`, shortened where one of ``discs`` `[D]` stands in front; the rest as in `raycast`.

    From inside a disc its far rim is not seen.
    """

    def nearer(ranges, disc):
        centre = (disc - origin).in_frame(heading)
        along = directions.dot(centre)
        # The distance at which the beam passes the centre: along^2 - |p|^2 would lose the digits of a far disc.
        aside = directions.cross(centre)
        discriminant = radius * radius - aside * aside
        hit = along - safe_sqrt(discriminant)
        return jnp.where((discriminant >= 0) & (hit > 0), jnp.minimum(ranges, hit), ranges), None

    return jax.lax.scan(nearer, ranges, discs, unroll=min(8, discs.x.shape[0]))[0]


def add_noise(key: jax.Array, ranges: jax.Array, params: Params) -> jax.Array:
    """Gaussian range noise and dropouts (a lost beam reads ``scan_range``), from one random word a beam."""
    bits = jax.random.bits(key, ranges.shape, jnp.uint32)
    # 16 bits: the normal reaches +-4.3 standard deviations.
    uniform = ((bits >> 16).astype(jnp.float32) + 0.5) / 65536.0
    dropped = (bits & 0xFFFF).astype(jnp.float32) < params.scan_dropout * 65536.0
    noisy = ranges + params.scan_noise_std * jax.scipy.special.ndtri(uniform)
    # A miss is the absence of an echo: there is no range to be noisy about.
    noisy = jnp.where(ranges >= params.scan_range, params.scan_range, jnp.clip(noisy, 0.0, params.scan_range))
    return jnp.where(dropped, params.scan_range, noisy)
