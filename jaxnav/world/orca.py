"""ORCA: half-planes of velocities that keep clear of other agents and of walls.

Source: van den Berg, Guy, Lin, Manocha, "Reciprocal n-body collision avoidance", 2011, and RVO2's published algorithm.
A program over them (`jaxnav.world.linear_program`) chooses the new velocity.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from .geometry import Vec2, safe_sqrt, where

_ROUNDING = 1e-5  # RVO2's epsilon
_TINY = 1e-12


class HalfPlane(NamedTuple):
    """Velocities to the left of the line through ``point`` along the unit vector ``direction``; all where not
    ``active``."""

    point: Vec2
    direction: Vec2
    active: jax.Array

    def violation(self, velocity: Vec2) -> jax.Array:
        """How far a velocity lies on the forbidden side, metres a second; -inf where not active."""
        return jnp.where(self.active, self.direction.cross(self.point - velocity), -jnp.inf)


def agent_half_plane(
    position: Vec2, velocity: Vec2, other_velocity: Vec2, radius: jax.Array | float, time_horizon: jax.Array | float,
    dt: jax.Array | float, active: jax.Array,
) -> HalfPlane:  # fmt: skip
    """Permitted velocities of an agent next to another one, at ``position`` relative to it: half the effort.

    radius: sum of both; time_horizon: how long the new velocity is to be safe, ``dt`` if they already overlap.
    """
    relative = velocity - other_velocity
    distance_squared, radius_squared = position.squared(), radius * radius
    overlap = distance_squared <= radius_squared
    horizon = jnp.where(overlap, dt, time_horizon)
    # Projection on the cut-off circle of the velocity obstacle.
    w = relative - position / horizon
    w_squared, w_dot_p = w.squared(), w.dot(position)
    w_length = safe_sqrt(w_squared)
    # Coincident agents with equal velocities, for whom RVO2 divides by zero, are both pushed the same way and stay
    # together. Placement never starts two in one place.
    u = where(w_squared > _TINY, w / w_length, Vec2(jnp.float32(1.0), jnp.float32(0.0)))
    circle = overlap | ((w_dot_p < 0) & (w_dot_p * w_dot_p > radius_squared * w_squared))
    push = radius / horizon - w_length
    # Projection on one of its legs.
    length = safe_sqrt(distance_squared - radius_squared)
    sign = jnp.where(position.cross(w) > 0, 1.0, -1.0)
    leg = sign * (position * length + sign * position.left() * radius) / jnp.maximum(distance_squared, _TINY)
    along = relative.dot(leg)
    direction = where(circle, u.right(), leg)
    change = where(circle, push * u, along * leg - relative)
    return HalfPlane(velocity + 0.5 * change, direction, active)


class NearWall(NamedTuple):
    """A wall as an agent beside it sees it: vertices relative to the agent, who stands on the free side, the left.

    before, a, b, after: consecutive vertices of its chain, the wall being a to b; active: whether it is there at all.
    """

    before: Vec2
    a: Vec2
    b: Vec2
    after: Vec2
    active: jax.Array


def wall_half_planes(
    walls: list[NearWall], velocity: Vec2, radius: jax.Array | float, time_horizon: jax.Array | float
) -> list[HalfPlane]:
    """Permitted velocities next to each of ``walls``, nearest first.

    Walls don't move, so the whole effort is the agent's: its disc stays clear of them for ``time_horizon`` seconds. A
    wall whose velocity obstacle lies within what the ones before it forbid adds nothing.
    """
    # A loop compiles once for all of them: it is the longest piece of a step.
    stacked = jax.tree.map(lambda *leaves: jnp.stack(leaves), *walls)
    stacked = jax.lax.map(lambda wall: _wall_half_plane(wall, velocity, radius, time_horizon), stacked)
    planes = []
    for i, wall in enumerate(walls):
        covered = jnp.bool_(False)
        for plane in planes:
            beyond_a, beyond_b = ((end / time_horizon - plane.point).cross(plane.direction) for end in (wall.a, wall.b))
            beyond = jnp.minimum(beyond_a, beyond_b) - radius / time_horizon
            covered |= plane.active & (beyond >= -_ROUNDING)
        plane = jax.tree.map(lambda leaf, i=i: leaf[i], stacked)
        planes.append(plane._replace(active=plane.active & ~covered))
    return planes


class _End(NamedTuple):
    """An end of a wall that an agent faces.

    at: relative to the agent; onward: unit vector along the neighbouring wall, from left to right as the wall itself;
    convex: whether it is a convex vertex of the obstacle, a reflex one of the free space: only there does the obstacle
    have a leg of its own.
    """

    at: Vec2
    onward: Vec2
    convex: jax.Array


class _Leg(NamedTuple):
    """Where the velocity obstacle of a wall ends on one side.

    direction: unit vector away from the agent; foreign: whether the neighbouring wall's cut-off line takes over there.
    """

    direction: Vec2
    foreign: jax.Array


class _Foot(NamedTuple):
    """Where the agent's foot on the wall's line is: before the left end or beyond the right one, and its distance^2."""

    before: jax.Array
    beyond: jax.Array
    squared: jax.Array


def _wall_half_plane(wall, velocity, radius, time_horizon):
    """`HalfPlane` of one wall: RVO2's cases one after the other. Facing the wall, b is its left end, a its right."""
    along, left, right = _ends(wall)
    foot = _foot(left.at, right.at)
    touches, touching, left_to_neighbor = _contact(along, left, right, foot, radius)
    active = wall.active & ~left_to_neighbor
    only, hidden, left, right = _oblique(along, left, right, foot, radius)
    active &= touches | ~hidden
    legs = _left_leg(along, left, radius), _right_leg(along, right, radius)
    point, direction, foreign = _project(along, left, right, legs, only, velocity, radius, time_horizon)
    zero = Vec2(jnp.float32(0.0), jnp.float32(0.0))
    return HalfPlane(where(touches, zero, point), where(touches, touching, direction), active & (touches | ~foreign))


def _ends(wall):
    """(unit vector along the wall, its left `_End`, its right one)."""
    along = (wall.a - wall.b).unit()
    left, right = (wall.b - wall.after).unit(), (wall.before - wall.a).unit()
    # The end of a wall without thickness turns back exactly: 0 but for rounding.
    return (
        along,
        _End(wall.b, left, left.cross(along) >= -_ROUNDING),
        _End(wall.a, right, along.cross(right) >= -_ROUNDING),
    )


def _foot(left, right):
    span = right - left
    s = -left.dot(span) / jnp.maximum(span.squared(), _TINY)
    return _Foot(s < 0, s > 1, (left + s * span).squared())


def _contact(along, left, right, foot, radius):
    """In contact: no velocity toward the wall, or toward its end.

    (whether it is, the direction of its half-plane, whether a neighbouring wall takes care of that contact).
    """
    squared = radius * radius
    at_left = foot.before & (left.at.squared() <= squared)
    at_right = foot.beyond & (right.at.squared() <= squared)
    at_end = at_left | at_right
    touches = at_end | (~foot.before & ~foot.beyond & (foot.squared <= squared))
    direction = where(at_end, where(at_left, left.at, right.at).left().unit(), -along)
    of_neighbor = ~right.convex | (right.at.cross(right.onward) < 0)
    return touches, direction, (at_left & ~left.convex) | (at_right & of_neighbor)


def _oblique(along, left, right, foot, radius):
    """Seen so obliquely that one end hides the rest: the velocity obstacle is that of the end.

    (whether it is, whether a neighbouring wall takes care of that end, both `_End`, the same where it is).
    """
    near = foot.squared <= radius * radius
    only_left, only_right = foot.before & near, foot.beyond & near
    hidden = (only_left & ~left.convex) | (only_right & ~right.convex)
    only = only_left | only_right
    new_left = _End(where(only_right, right.at, left.at), where(only_right, along, left.onward), left.convex | only)
    new_right = _End(where(only_left, left.at, right.at), where(only_left, along, right.onward), right.convex | only)
    return only, hidden, new_left, new_right


def _tangent(end, radius, turn):
    """Unit vector along the tangent to the disc around ``end``; ``turn``: its `left` or `right`, on that side."""
    squared = end.squared()
    return (end * safe_sqrt(squared - radius * radius) + turn * radius) / jnp.maximum(squared, _TINY)


def _left_leg(along, end, radius):
    # Beside an end that is not convex the cut-off line goes on.
    leg = where(end.convex, _tangent(end.at, radius, end.at.left()), -along)
    # A leg can't point into the neighbouring wall.
    foreign = end.convex & (leg.cross(-end.onward) >= 0)
    return _Leg(where(foreign, -end.onward, leg), foreign)


def _right_leg(along, end, radius):
    leg = where(end.convex, _tangent(end.at, radius, end.at.right()), along)
    foreign = end.convex & (leg.cross(end.onward) <= 0)
    return _Leg(where(foreign, end.onward, leg), foreign)


def _project(along, left, right, legs, only, velocity, radius, time_horizon):
    """The velocity, projected on the border of the velocity obstacle: its cut-off segment, circles and legs.

    (point, direction of the border there, whether that part of it is another wall's).
    """
    left_leg, right_leg = legs
    # The velocity, seen from both ends of the cut-off segment.
    from_left, from_right = (velocity - end.at / time_horizon for end in (left, right))
    segment = (right.at - left.at) / time_horizon
    t = from_left.dot(segment) / jnp.maximum(segment.squared(), _TINY)
    t = jnp.where(only, 0.5, t)
    along_left, along_right = from_left.dot(left_leg.direction), from_right.dot(right_leg.direction)
    behind_left, behind_right = along_left < 0, along_right < 0
    # Its squared distances from that segment and from the legs.
    to_cut = jnp.where((t < 0) | (t > 1) | only, jnp.inf, (from_left - t * segment).squared())
    to_left = jnp.where(behind_left, jnp.inf, (from_left - along_left * left_leg.direction).squared())
    to_right = jnp.where(behind_right, jnp.inf, (from_right - along_right * right_leg.direction).squared())

    left_circle = ((t < 0) & behind_left) | (only & behind_left & behind_right)
    right_circle = ~left_circle & (t > 1) & behind_right
    circle = left_circle | right_circle
    on_cut = (to_cut <= to_left) & (to_cut <= to_right)
    on_left = ~on_cut & (to_left <= to_right)
    foreign = ~circle & ~on_cut & jnp.where(on_left, left_leg.foreign, right_leg.foreign)

    around = where(left_circle, from_left, from_right).unit().right()
    on_leg = where(on_left, left_leg.direction, -right_leg.direction)
    direction = where(circle, around, where(on_cut, -along, on_leg))
    at_left = left_circle | (~right_circle & (on_cut | on_left))
    point = where(at_left, left.at, right.at) / time_horizon + (radius / time_horizon) * direction.left()
    return point, direction, foreign
