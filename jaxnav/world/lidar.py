"""Raycast: ranges from the robot to walls and discs, closed form, without marching."""

import jax
import jax.numpy as jnp
import numpy as np

from .geometry import cross2d, safe_sqrt, to_frame

_UNROLLED = 24  # walls up to which their loop is unrolled


def beam_directions(beams):
    """Unit vectors `[B]`, `[B]` of the beams in the robot frame: right (-pi/2) to left (pi/2), both included."""
    angles = np.linspace(-np.pi / 2, np.pi / 2, beams)
    # cos(pi/2) is 6e-17 in floating point; an exact 0 keeps the outermost beams exactly sideways.
    return np.where(np.abs(angles) == np.pi / 2, 0.0, np.cos(angles)).astype(np.float32), np.sin(angles).astype(
        np.float32
    )


def raycast(x, y, cos, sin, walls, directions, max_range):
    """Ranges to the nearest wall along ``directions`` from (x, y), frame heading (cos, sin); at most ``max_range``.

    directions: unit vectors in that frame, `[B]` and `[B]` or two scalars. A beam exactly along a wall misses it.
    """
    if walls.listed is not None or walls.solid.shape[0] > _UNROLLED:
        return _raycast_many(x, y, cos, sin, walls, directions, max_range)
    beam_x, beam_y = directions
    ax, ay = to_frame(walls.x - x, walls.y - y, cos, sin)
    # A wall's own vector, not the difference of two vertices seen from here: a short wall far away keeps its digits.
    ex, ey = to_frame(walls.x[1:] - walls.x[:-1], walls.y[1:] - walls.y[:-1], cos, sin)
    area = cross2d(ax[:-1], ay[:-1], ex, ey)
    solid = walls.solid & (jnp.abs(area) > 1e-9)
    scale = jnp.where(solid, 1.0 / jnp.where(solid, area, 1.0), 0.0)
    # 1 / range is linear in the beam's direction, so walls cost no division a beam; vertices are shared by two walls.
    slope_x, slope_y = scale * ey, -scale * ex
    inverse = jnp.full(jnp.shape(beam_x), 1.0) / max_range
    side_a = beam_x * ay[0] - beam_y * ax[0]
    for i in range(walls.solid.shape[0]):
        side_b = beam_x * ay[i + 1] - beam_y * ax[i + 1]
        candidate = beam_x * slope_x[i] + beam_y * slope_y[i]
        inverse = jnp.where(side_a * side_b <= 0, jnp.maximum(inverse, candidate), inverse)
        side_a = side_b
    return 1.0 / inverse


def _raycast_many(x, y, cos, sin, walls, directions, max_range):
    """`raycast` among many walls, one after the other: what unrolling them would compile is too much."""
    beam_x, beam_y = directions

    def nearer(inverse, wall):
        ax, ay, ex, ey, bx, by, scale = wall
        side_a, side_b = beam_x * ay - beam_y * ax, beam_x * by - beam_y * bx
        candidate = scale * (beam_x * ey - beam_y * ex)
        return jnp.where(side_a * side_b <= 0, jnp.maximum(inverse, candidate), inverse), None

    ax, ay, bx, by, solid = walls.segments()
    ex, ey = to_frame(bx - ax, by - ay, cos, sin)
    ax, ay = to_frame(ax - x, ay - y, cos, sin)
    bx, by = to_frame(bx - x, by - y, cos, sin)
    area = cross2d(ax, ay, ex, ey)
    solid &= jnp.abs(area) > 1e-9
    scale = jnp.where(solid, 1.0 / jnp.where(solid, area, 1.0), 0.0)
    start = jnp.full(jnp.shape(beam_x), 1.0) / max_range
    return 1.0 / jax.lax.scan(nearer, start, (ax, ay, ex, ey, bx, by, scale), unroll=8)[0]


def raycast_discs(ranges, x, y, cos, sin, discs_x, discs_y, radius, directions):
    """``ranges`` `[B]`, shortened where a disc `[D]` stands in front. From inside a disc its far rim is not seen."""
    beam_x, beam_y = directions

    def nearer(ranges, disc):
        px, py = to_frame(disc[0] - x, disc[1] - y, cos, sin)
        along = beam_x * px + beam_y * py
        # The distance at which the beam passes the centre: along^2 - |p|^2 would lose the digits of a far disc.
        aside = beam_x * py - beam_y * px
        discriminant = radius * radius - aside * aside
        hit = along - safe_sqrt(discriminant)
        return jnp.where((discriminant >= 0) & (hit > 0), jnp.minimum(ranges, hit), ranges), None

    return jax.lax.scan(nearer, ranges, (discs_x, discs_y), unroll=min(8, discs_x.shape[0]))[0]


def add_noise(key, ranges, params):
    """Gaussian range noise and dropouts (a lost beam reads ``scan_range``), from one random word a beam."""
    bits = jax.random.bits(key, ranges.shape, jnp.uint32)
    uniform = (
        (bits >> 16).astype(jnp.float32) + 0.5
    ) / 65536.0  # 16 bits: the normal reaches +-4.3 standard deviations
    dropped = (bits & 0xFFFF).astype(jnp.float32) < params.scan_dropout * 65536.0
    noisy = ranges + params.scan_noise_std * jax.scipy.special.ndtri(uniform)
    # A miss is the absence of an echo: there is no range to be noisy about.
    noisy = jnp.where(ranges >= params.scan_range, params.scan_range, jnp.clip(noisy, 0.0, params.scan_range))
    return jnp.where(dropped, params.scan_range, noisy)
