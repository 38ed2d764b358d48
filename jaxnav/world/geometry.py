"""Points, segments, discs and moving points in the plane, on scalars; gradients are finite everywhere."""

import jax.numpy as jnp

_TINY = 1e-12


def safe_sqrt(x):
    """sqrt(max(x, 1e-12)): the gradient at 0 and below is 0 instead of infinite."""
    return jnp.sqrt(jnp.maximum(x, _TINY))


def norm(x, y):
    """Length of (x, y)."""
    return safe_sqrt(x * x + y * y)


def unit(x, y):
    """(x, y) scaled to length 1; a vector of length 0 stays 0."""
    length = norm(x, y)
    return x / length, y / length


def cross2d(ax, ay, bx, by):
    """z of the cross product: positive where b points to the left of a."""
    return ax * by - ay * bx


def to_frame(x, y, cos, sin):
    """A world vector (x, y) in the axes of a frame whose heading is (cos, sin)."""
    return cos * x + sin * y, cos * y - sin * x


def closest_on_segment(px, py, ax, ay, bx, by):
    """Point of segment a-b nearest to p; a segment of length 0 is its point."""
    ex, ey = bx - ax, by - ay
    t = jnp.clip(((px - ax) * ex + (py - ay) * ey) / jnp.maximum(ex * ex + ey * ey, _TINY), 0.0, 1.0)
    return ax + t * ex, ay + t * ey


def closest_approach(px, py, ex, ey, horizon=1.0):
    """Time in [0, horizon] at which a point at p that moves by e a unit of time is nearest to the origin."""
    speed_squared = ex * ex + ey * ey
    return jnp.clip(-(px * ex + py * ey) / jnp.maximum(speed_squared, _TINY), 0.0, horizon)


def time_to_disc(px, py, ex, ey, radius):
    """First t in [0, 1] at which p + t e lies within ``radius`` of the origin, else inf. 0 if it does at the start."""
    a, b, c = ex * ex + ey * ey, px * ex + py * ey, px * px + py * py - radius * radius
    discriminant = b * b - a * c
    t = c / jnp.maximum(safe_sqrt(discriminant) - b, _TINY)
    hit = (b < 0) & (discriminant >= 0) & (t <= 1)
    return jnp.where(c <= 0, 0.0, jnp.where(hit, t, jnp.inf))


def time_to_slab(px, py, ex, ey, ax, ay, bx, by, radius):
    """First t in [0, 1] at which p + t e comes within ``radius`` of segment a-b from the side, else inf.

    Together with `time_to_disc` at both ends this is the exact first contact of a moving disc with a wall.
    """
    dx, dy = bx - ax, by - ay
    length = norm(dx, dy)
    dx, dy = dx / length, dy / length
    side = cross2d(dx, dy, px - ax, py - ay)
    rate = cross2d(dx, dy, ex, ey) * jnp.where(side < 0, -1.0, 1.0)
    gap = jnp.abs(side) - radius
    t = jnp.where(gap <= 0, 0.0, gap / jnp.maximum(-rate, _TINY))
    along = dx * (px + t * ex - ax) + dy * (py + t * ey - ay)
    # A wall without length has no side: its point is for `time_to_disc`.
    return jnp.where((t <= 1) & (along >= 0) & (along <= length) & (length > 1e-5), t, jnp.inf)


def insert_nearest(held, squared, index):
    """``held``, a sorted list of (squared distance, index), with one more candidate and without the farthest of all."""
    carried = squared, index
    kept = []
    for old in held:
        swap = carried[0] < old[0]
        kept.append(tuple(jnp.where(swap, new, before) for new, before in zip(carried, old, strict=True)))
        carried = tuple(jnp.where(swap, before, new) for new, before in zip(carried, old, strict=True))
    return kept
