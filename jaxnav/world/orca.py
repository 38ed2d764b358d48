"""ORCA: half-planes of velocities that keep clear of other agents and of walls.

Source: van den Berg, Guy, Lin, Manocha, "Reciprocal n-body collision avoidance", 2011, and RVO2's published algorithm.
A program over them (`jaxnav.world.linear_program`) chooses the new velocity.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from .geometry import cross2d, safe_sqrt, unit

_ROUNDING = 1e-5  # RVO2's epsilon


class HalfPlane(NamedTuple):
    """Velocities to the left of the line through (x, y) along the unit vector (dx, dy); all where not ``active``."""

    x: jax.Array
    y: jax.Array
    dx: jax.Array
    dy: jax.Array
    active: jax.Array

    def violation(self, vx, vy):
        """How far (vx, vy) lies on the forbidden side, metres a second; -inf where not active."""
        return jnp.where(self.active, cross2d(self.dx, self.dy, self.x - vx, self.y - vy), -jnp.inf)


def agent_half_plane(px, py, vx, vy, other_vx, other_vy, radius, time_horizon, dt, active):
    """Permitted velocities of an agent with velocity v, next to another one at relative position p: half the effort.

    radius: sum of both; time_horizon: how long the new velocity is to be safe, ``dt`` if they already overlap.
    """
    rvx, rvy = vx - other_vx, vy - other_vy
    distance_squared, radius_squared = px * px + py * py, radius * radius
    overlap = distance_squared <= radius_squared
    horizon = jnp.where(overlap, dt, time_horizon)
    # Projection on the cut-off circle of the velocity obstacle.
    wx, wy = rvx - px / horizon, rvy - py / horizon
    w_squared, w_dot_p = wx * wx + wy * wy, wx * px + wy * py
    w_length = safe_sqrt(w_squared)
    # Coincident agents with equal velocities, for whom RVO2 divides by zero, are both pushed the same way and stay
    # together. Placement never starts two in one place.
    ux = jnp.where(w_squared > 1e-12, wx / w_length, 1.0)
    uy = jnp.where(w_squared > 1e-12, wy / w_length, 0.0)
    circle = overlap | ((w_dot_p < 0) & (w_dot_p * w_dot_p > radius_squared * w_squared))
    push = radius / horizon - w_length
    # Projection on one of its legs.
    leg = safe_sqrt(distance_squared - radius_squared)
    sign = jnp.where(cross2d(px, py, wx, wy) > 0, 1.0, -1.0)
    distance_squared = jnp.maximum(distance_squared, 1e-12)
    leg_x = sign * (px * leg - sign * py * radius) / distance_squared
    leg_y = sign * (py * leg + sign * px * radius) / distance_squared
    along = rvx * leg_x + rvy * leg_y
    dx, dy = jnp.where(circle, uy, leg_x), jnp.where(circle, -ux, leg_y)
    change_x = jnp.where(circle, push * ux, along * leg_x - rvx)
    change_y = jnp.where(circle, push * uy, along * leg_y - rvy)
    return HalfPlane(vx + 0.5 * change_x, vy + 0.5 * change_y, dx, dy, active)


class NearWall(NamedTuple):
    """A wall as an agent beside it sees it: vertices relative to the agent, who stands on the free side, the left.

    before, a, b, after: consecutive vertices of its chain, the wall being a to b; active: whether it is there at all.
    """

    before_x: jax.Array
    before_y: jax.Array
    ax: jax.Array
    ay: jax.Array
    bx: jax.Array
    by: jax.Array
    after_x: jax.Array
    after_y: jax.Array
    active: jax.Array


def wall_half_planes(walls, vx, vy, radius, time_horizon):
    """Permitted velocities next to each of ``walls``, a list of `NearWall`, nearest first: a list of `HalfPlane`.

    Walls don't move, so the whole effort is the agent's: its disc stays clear of them for ``time_horizon`` seconds. A
    wall whose velocity obstacle lies within what the ones before it forbid adds nothing.
    """
    # A loop compiles once for all of them: it is the longest piece of a step.
    stacked = NearWall(*(jnp.stack(field) for field in zip(*walls, strict=True)))
    stacked = jax.lax.map(lambda wall: _wall_half_plane(wall, vx, vy, radius, time_horizon), stacked)
    planes = []
    for i, wall in enumerate(walls):
        covered = jnp.bool_(False)
        for plane in planes:
            beyond_a = cross2d(wall.ax / time_horizon - plane.x, wall.ay / time_horizon - plane.y, plane.dx, plane.dy)
            beyond_b = cross2d(wall.bx / time_horizon - plane.x, wall.by / time_horizon - plane.y, plane.dx, plane.dy)
            beyond = jnp.minimum(beyond_a, beyond_b) - radius / time_horizon
            covered |= plane.active & (beyond >= -_ROUNDING)
        plane = HalfPlane(*(field[i] for field in stacked))
        planes.append(plane._replace(active=plane.active & ~covered))
    return planes


def _wall_half_plane(wall, vx, vy, radius, time_horizon):
    """`HalfPlane` of one wall: RVO2's cases one after the other.

    Facing the wall, b is its left end and a its right one. A reflex vertex of the free space is a convex one of the
    obstacle: only there does the obstacle have a leg of its own.
    """
    radius_squared = radius * radius
    lx, ly, rx, ry = wall.bx, wall.by, wall.ax, wall.ay
    ex, ey = unit(rx - lx, ry - ly)
    left_neighbor_x, left_neighbor_y = unit(lx - wall.after_x, ly - wall.after_y)
    right_neighbor_x, right_neighbor_y = unit(wall.before_x - rx, wall.before_y - ry)
    # The end of a wall without thickness turns back exactly: 0 but for rounding.
    left_convex = cross2d(left_neighbor_x, left_neighbor_y, ex, ey) >= -_ROUNDING
    right_convex = cross2d(ex, ey, right_neighbor_x, right_neighbor_y) >= -_ROUNDING
    # Where the agent's foot on the wall's line is: s < 0 beyond the left end, s > 1 beyond the right one.
    span_x, span_y = rx - lx, ry - ly
    s = -(lx * span_x + ly * span_y) / jnp.maximum(span_x * span_x + span_y * span_y, 1e-12)
    line_squared = (lx + s * span_x) ** 2 + (ly + s * span_y) ** 2
    left_squared, right_squared = lx * lx + ly * ly, rx * rx + ry * ry

    # In contact: no velocity toward the wall, or toward its end.
    touches_left = (s < 0) & (left_squared <= radius_squared)
    touches_right = (s > 1) & (right_squared <= radius_squared)
    touches = touches_left | touches_right | ((s >= 0) & (s <= 1) & (line_squared <= radius_squared))
    end_x, end_y = jnp.where(touches_left, lx, rx), jnp.where(touches_left, ly, ry)
    away_x, away_y = unit(-end_y, end_x)
    touch_x = jnp.where(touches_left | touches_right, away_x, -ex)
    touch_y = jnp.where(touches_left | touches_right, away_y, -ey)
    # What a neighbouring wall takes care of is left to it.
    of_neighbor = ~right_convex | (cross2d(rx, ry, right_neighbor_x, right_neighbor_y) < 0)
    active = wall.active & ~((touches_left & ~left_convex) | (touches_right & of_neighbor))

    # Seen so obliquely that one end hides the rest: the velocity obstacle is that of the end.
    only_left = (s < 0) & (line_squared <= radius_squared)
    only_right = (s > 1) & (line_squared <= radius_squared)
    active &= touches | ~((only_left & ~left_convex) | (only_right & ~right_convex))
    only = only_left | only_right
    lx, ly = jnp.where(only_right, rx, lx), jnp.where(only_right, ry, ly)
    rx, ry = jnp.where(only_left, lx, rx), jnp.where(only_left, ly, ry)
    left_squared, right_squared = lx * lx + ly * ly, rx * rx + ry * ry
    left_neighbor_x = jnp.where(only_right, ex, left_neighbor_x)
    left_neighbor_y = jnp.where(only_right, ey, left_neighbor_y)
    right_neighbor_x = jnp.where(only_left, ex, right_neighbor_x)
    right_neighbor_y = jnp.where(only_left, ey, right_neighbor_y)
    left_convex, right_convex = left_convex | only, right_convex | only

    # Legs; beside an end that is not convex the cut-off line goes on.
    length = safe_sqrt(left_squared - radius_squared)
    left_x = jnp.where(left_convex, (lx * length - ly * radius) / jnp.maximum(left_squared, 1e-12), -ex)
    left_y = jnp.where(left_convex, (lx * radius + ly * length) / jnp.maximum(left_squared, 1e-12), -ey)
    length = safe_sqrt(right_squared - radius_squared)
    right_x = jnp.where(right_convex, (rx * length + ry * radius) / jnp.maximum(right_squared, 1e-12), ex)
    right_y = jnp.where(right_convex, (-rx * radius + ry * length) / jnp.maximum(right_squared, 1e-12), ey)
    # A leg can't point into the neighbouring wall: there that wall's cut-off line takes over.
    left_foreign = left_convex & (cross2d(left_x, left_y, -left_neighbor_x, -left_neighbor_y) >= 0)
    right_foreign = right_convex & (cross2d(right_x, right_y, right_neighbor_x, right_neighbor_y) <= 0)
    left_x = jnp.where(left_foreign, -left_neighbor_x, left_x)
    left_y = jnp.where(left_foreign, -left_neighbor_y, left_y)
    right_x = jnp.where(right_foreign, right_neighbor_x, right_x)
    right_y = jnp.where(right_foreign, right_neighbor_y, right_y)

    # The velocity, seen from both ends of the cut-off segment, and its distances from that segment and from the legs.
    cut = radius / time_horizon
    from_left_x, from_left_y = vx - lx / time_horizon, vy - ly / time_horizon
    from_right_x, from_right_y = vx - rx / time_horizon, vy - ry / time_horizon
    cut_x, cut_y = (rx - lx) / time_horizon, (ry - ly) / time_horizon
    t = (from_left_x * cut_x + from_left_y * cut_y) / jnp.maximum(cut_x * cut_x + cut_y * cut_y, 1e-12)
    t = jnp.where(only, 0.5, t)
    along_left = from_left_x * left_x + from_left_y * left_y
    along_right = from_right_x * right_x + from_right_y * right_y
    to_cut = jnp.where(
        (t < 0) | (t > 1) | only, jnp.inf, (from_left_x - t * cut_x) ** 2 + (from_left_y - t * cut_y) ** 2
    )
    to_left = (from_left_x - along_left * left_x) ** 2 + (from_left_y - along_left * left_y) ** 2
    to_left = jnp.where(along_left < 0, jnp.inf, to_left)
    to_right = (from_right_x - along_right * right_x) ** 2 + (from_right_y - along_right * right_y) ** 2
    to_right = jnp.where(along_right < 0, jnp.inf, to_right)

    left_circle = ((t < 0) & (along_left < 0)) | (only & (along_left < 0) & (along_right < 0))
    right_circle = ~left_circle & (t > 1) & (along_right < 0)
    circle = left_circle | right_circle
    on_cut = (to_cut <= to_left) & (to_cut <= to_right)
    on_left = ~on_cut & (to_left <= to_right)
    active &= touches | circle | on_cut | ~jnp.where(on_left, left_foreign, right_foreign)

    ux, uy = unit(jnp.where(left_circle, from_left_x, from_right_x), jnp.where(left_circle, from_left_y, from_right_y))
    dx = jnp.where(circle, uy, jnp.where(on_cut, -ex, jnp.where(on_left, left_x, -right_x)))
    dy = jnp.where(circle, -ux, jnp.where(on_cut, -ey, jnp.where(on_left, left_y, -right_y)))
    at_left = left_circle | (~right_circle & (on_cut | on_left))
    x = jnp.where(at_left, lx, rx) / time_horizon - cut * dy
    y = jnp.where(at_left, ly, ry) / time_horizon + cut * dx
    return HalfPlane(
        jnp.where(touches, 0.0, x), jnp.where(touches, 0.0, y),
        jnp.where(touches, touch_x, dx), jnp.where(touches, touch_y, dy), active,
    )  # fmt: skip
