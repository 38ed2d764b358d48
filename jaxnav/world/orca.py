"""ORCA: half-planes of permitted velocities and the 2D linear programs of RVO2 over them.

Source: van den Berg, Guy, Lin, Manocha, "Reciprocal n-body collision avoidance", 2011, and RVO2's published algorithm.
Loops over half-planes are unrolled over scalars, so that ``vmap`` turns them into plain elementwise code; the fallback
scans over the agents' half-planes. Nothing here is a ``while_loop``: reverse mode passes through.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from .geometry import cross2d, safe_sqrt

_PARALLEL = 1e-5  # RVO2's epsilon: below this the sine between two lines counts as 0


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
    # Coincident agents with equal velocities: any direction serves, so long as both don't choose the same one.
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


def wall_half_plane(px, py, radius, time_horizon, dt, active):
    """Velocities that keep a disc clear, for ``time_horizon`` seconds, of the wall point at relative position p.

    The point is the wall's nearest one; a disc that already overlaps the wall leaves it within one step.
    """
    distance = safe_sqrt(px * px + py * py)
    nx, ny = px / distance, py / distance
    gap = distance - radius
    limit = gap / jnp.where(gap < 0, dt, jnp.maximum(time_horizon, dt))
    return HalfPlane(nx * limit, ny * limit, -ny, nx, active)


def solve(wall_planes, agent_planes, preferred_vx, preferred_vy, max_speed):
    """Permitted velocity nearest to the preferred one, no faster than ``max_speed``.

    wall_planes, agent_planes: lists of `HalfPlane`. Where they leave nothing, the velocity that violates the agents'
    planes least while the walls' stay hard.
    """
    planes = wall_planes + agent_planes
    speed = safe_sqrt(preferred_vx * preferred_vx + preferred_vy * preferred_vy)
    shrink = jnp.where(speed > max_speed, max_speed / speed, 1.0)
    start = shrink * preferred_vx, shrink * preferred_vy
    vx, vy, failed_at = _nearest_program(planes, start, preferred_vx, preferred_vy, max_speed, direction_only=False)
    return _fallback_program(wall_planes, agent_planes, failed_at - len(wall_planes), vx, vy, max_speed)


def _on_line(planes, i, target_x, target_y, max_speed, direction_only):
    """RVO2's linearProgram1: the best velocity on the border of plane i that satisfies planes 0 to i - 1.

    Returns (vx, vy, feasible).
    """
    line = planes[i]
    projection = line.x * line.dx + line.y * line.dy
    discriminant = projection * projection + max_speed * max_speed - line.x * line.x - line.y * line.y
    half = safe_sqrt(discriminant)
    low, high = -projection - half, -projection + half
    feasible = discriminant >= 0
    for other in planes[:i]:
        sine = cross2d(line.dx, line.dy, other.dx, other.dy)
        offset = cross2d(other.dx, other.dy, line.x - other.x, line.y - other.y)
        parallel = jnp.abs(sine) <= _PARALLEL
        t = offset / jnp.where(parallel, 1.0, sine)
        feasible &= ~(other.active & parallel & (offset < 0))
        cuts = other.active & ~parallel
        high = jnp.where(cuts & (sine >= 0), jnp.minimum(high, t), high)
        low = jnp.where(cuts & (sine < 0), jnp.maximum(low, t), low)
    feasible &= low <= high
    if direction_only:
        t = jnp.where(target_x * line.dx + target_y * line.dy > 0, high, low)
    else:
        t = jnp.clip(line.dx * (target_x - line.x) + line.dy * (target_y - line.y), low, high)
    return line.x + t * line.dx, line.y + t * line.dy, feasible


def _nearest_program(planes, start, target_x, target_y, max_speed, direction_only):
    """RVO2's linearProgram2: planes one after the other. Returns (vx, vy, index of the one that failed or len)."""
    vx, vy = start
    failed_at = jnp.full(jnp.shape(vx), len(planes))
    for i, plane in enumerate(planes):
        new_x, new_y, feasible = _on_line(planes, i, target_x, target_y, max_speed, direction_only)
        violated = (plane.violation(vx, vy) > 0) & (failed_at == len(planes))
        failed_at = jnp.where(violated & ~feasible, i, failed_at)
        vx, vy = jnp.where(violated & feasible, new_x, vx), jnp.where(violated & feasible, new_y, vy)
    return vx, vy, failed_at


def _fallback_program(wall_planes, agent_planes, begin, vx, vy, max_speed):
    """RVO2's linearProgram3: from agents' plane ``begin`` on, minimise the largest violation, walls staying hard."""
    stacked = HalfPlane(*(jnp.stack(jnp.broadcast_arrays(*field)) for field in zip(*agent_planes, strict=True)))

    def relax(carry, index_and_line):
        vx, vy, worst = carry
        index, line = index_and_line
        projected = [_bisector(line, other, other.active & (j < index)) for j, other in enumerate(agent_planes)]
        direction = -line.dy, line.dx
        start = direction[0] * max_speed, direction[1] * max_speed
        planes = wall_planes + projected
        new_x, new_y, failed_at = _nearest_program(planes, start, *direction, max_speed, direction_only=True)
        relevant = (index >= begin) & (line.violation(vx, vy) > worst)
        # Failing here is rounding: the velocity at hand is on the border already, so it is kept, as in RVO2.
        replace = relevant & (failed_at == len(planes))
        vx, vy = jnp.where(replace, new_x, vx), jnp.where(replace, new_y, vy)
        return (vx, vy, jnp.where(relevant, line.violation(vx, vy), worst)), None

    start = (vx, vy, jnp.zeros_like(vx))
    indices = jnp.arange(len(agent_planes))
    return jax.lax.scan(relax, start, (indices, stacked))[0][:2]


def _bisector(line, other, active):
    """Where ``line`` is violated as much as ``other``: velocities that violate ``other`` less lie to the left."""
    sine = cross2d(line.dx, line.dy, other.dx, other.dy)
    parallel = jnp.abs(sine) <= _PARALLEL
    same_way = line.dx * other.dx + line.dy * other.dy > 0
    t = cross2d(other.dx, other.dy, line.x - other.x, line.y - other.y) / jnp.where(parallel, 1.0, sine)
    x = jnp.where(parallel, 0.5 * (line.x + other.x), line.x + t * line.dx)
    y = jnp.where(parallel, 0.5 * (line.y + other.y), line.y + t * line.dy)
    dx, dy = other.dx - line.dx, other.dy - line.dy
    length = safe_sqrt(dx * dx + dy * dy)
    return HalfPlane(x, y, dx / length, dy / length, active & ~(parallel & same_way))
