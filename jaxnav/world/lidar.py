"""Raycast: ranges from the robot to walls and discs, closed form, without marching."""

import jax
import jax.numpy as jnp
import numpy as np

from .geometry import cross2d, safe_sqrt, to_frame


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
    beam_x, beam_y = directions
    # 1 / range is linear in the beam's direction, so walls cost no division a beam; vertices are shared by two walls.
    inverse = jnp.full(jnp.shape(beam_x), 1.0) / max_range
    ax, ay = to_frame(walls.x[0] - x, walls.y[0] - y, cos, sin)
    side_a = beam_x * ay - beam_y * ax
    for i in range(walls.solid.shape[0]):
        bx, by = to_frame(walls.x[i + 1] - x, walls.y[i + 1] - y, cos, sin)
        side_b = beam_x * by - beam_y * bx
        area = cross2d(ax, ay, bx, by)
        solid = walls.solid[i] & (jnp.abs(area) > 1e-9)
        candidate = (side_b - side_a) * jnp.where(solid, 1.0 / jnp.where(solid, area, 1.0), 0.0)
        inverse = jnp.where(side_a * side_b <= 0, jnp.maximum(inverse, candidate), inverse)
        ax, ay, side_a = bx, by, side_b
    return 1.0 / inverse


def raycast_discs(ranges, x, y, cos, sin, discs_x, discs_y, radius, directions):
    """``ranges`` `[B]`, shortened where a disc `[D]` stands in front. From inside a disc its far rim is not seen."""
    beam_x, beam_y = directions

    def nearer(ranges, disc):
        px, py = to_frame(disc[0] - x, disc[1] - y, cos, sin)
        along = beam_x * px + beam_y * py
        discriminant = along * along - (px * px + py * py - radius * radius)
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
