"""The 2D linear programs of RVO2: which half-planes decide the new velocity, and that velocity in closed form.

Source: van den Berg, Guy, Lin, Manocha, "Reciprocal n-body collision avoidance", 2011, and RVO2's published algorithm.
The search for the deciding planes yields whole numbers only, so nothing is differentiated through it. It is free to
loop, and to pay for the fallback program only for those who need it. The velocity is then a smooth function of at most
three planes: gradients are those of the optimum itself.
"""

import functools

import jax
import jax.numpy as jnp

from .geometry import Vec2, safe_sqrt, where
from .orca import HalfPlane

_PARALLEL = 1e-5  # RVO2's epsilon: below this the sine between two lines counts as 0
_ROWS = 256  # agents whose program is solved at once

# What bounds the velocity along the deciding line, beside the index of another plane (offset by their number).
_FREE, _LOW, _HIGH, _BOUNDS = 0, 1, 2, 3


def solve(
    wall_planes: list[HalfPlane], agent_planes: list[HalfPlane], preferred: Vec2, max_speed: jax.Array | float
) -> Vec2:
    """Permitted velocity nearest to the ``preferred`` one, no faster than ``max_speed``.

    Where they leave nothing, the velocity that violates the agents'
    planes least while the walls' stay hard.
    """
    planes = wall_planes + agent_planes
    arguments = jax.lax.stop_gradient((planes, preferred, max_speed))
    arguments = jax.tree.map(lambda leaf: jnp.asarray(leaf)[None], arguments)
    decision = _search(len(wall_planes))(*arguments)[0]
    return _decided_velocity(decision, len(wall_planes), planes, preferred, max_speed)


def _shrink(velocity, max_speed):
    speed = velocity.norm()
    return jnp.where(speed > max_speed, max_speed / speed, 1.0) * velocity


def _decided_velocity(decision, walls, planes, preferred, max_speed):
    """The velocity that a decision of `_search` stands for."""
    count = len(planes)
    relaxed, line, bound = _unpack(decision, count)
    velocity = _shrink(preferred, max_speed)
    first, second = _pick(planes, line - 1), _pick(planes, bound - _BOUNDS)
    if count > walls:
        # In the fallback program the velocity lies between `least`, the worst plane, and others.
        least = _pick(planes, walls + relaxed - 1)
        fallback = relaxed > 0
        velocity = where(fallback, least.direction.left() * max_speed, velocity)
        first = where(fallback & (line > walls), _bisector(least, first), first)
        second = where(fallback & (bound - _BOUNDS >= walls), _bisector(least, second), second)
    low, high = _chord(first, max_speed)[:2]
    t = first.direction.dot(preferred - first.point)
    t = jnp.where(bound == _LOW, low, jnp.where(bound == _HIGH, high, t))
    t = jnp.where(bound >= _BOUNDS, _crossing(first, second)[0], t)
    velocity = where(line > 0, first.point + t * first.direction, velocity)
    # Where lines cross at a small angle rounding can exceed the speed, by 2e-5 of it in random crowds.
    return _shrink(velocity, max_speed)


def _pick(planes, index):
    """The plane with that index; the first one where there is none."""
    picked = planes[0]
    for i, plane in enumerate(planes[1:], start=1):
        picked = where(index == i, plane, picked)
    return picked


def _stack(planes):
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *planes)


def _chord(line, max_speed):
    """(low, high, exists): the part of a line on which speed is at most ``max_speed``."""
    projection = line.point.dot(line.direction)
    # By the line's distance: the difference of squares in RVO2 loses the digits of a line given by a far point.
    distance = line.point.cross(line.direction)
    discriminant = max_speed * max_speed - distance * distance
    half = safe_sqrt(discriminant)
    return -projection - half, -projection + half, discriminant >= 0


def _crossing(line, other):
    """(t, sine, offset): where along ``line`` the other one crosses it, and what RVO2 asks of parallel ones."""
    sine = line.direction.cross(other.direction)
    offset = other.direction.cross(line.point - other.point)
    return offset / jnp.where(jnp.abs(sine) <= _PARALLEL, 1.0, sine), sine, offset


def _bisector(line, other):
    """Where ``line`` is violated as much as ``other``: velocities that violate ``other`` less lie to the left."""
    t, sine, _ = _crossing(line, other)
    parallel = jnp.abs(sine) <= _PARALLEL
    same_way = line.direction.dot(other.direction) > 0
    point = where(parallel, 0.5 * (line.point + other.point), line.point + t * line.direction)
    direction = (other.direction - line.direction).unit()
    return HalfPlane(point, direction, other.active & ~(parallel & same_way))


# A decision is one whole number: relaxed (0, or 1 + index of the agents' plane that is violated least), line (0, or
# 1 + index of the plane on whose border the velocity lies), bound (what ends it along that border).


def _unpack(decision, count):
    rest, bound = decision // (count + _BOUNDS), decision % (count + _BOUNDS)
    return rest // (count + 1), rest % (count + 1), bound


@functools.cache
def _search(walls):
    """A function of (planes, preferred velocity, max_speed), leaves `[B]`, that returns decisions `[B]`.

    ``vmap`` merges its axis with B instead of adding one: each program then runs over those rows of all episodes that
    need it, and over no others.
    """

    @jax.custom_batching.custom_vmap
    def search(planes, preferred, max_speed):
        count = len(planes)
        wanted = _shrink(preferred, max_speed)
        violated = functools.reduce(jnp.logical_or, [plane.violation(wanted) > 0 for plane in planes])
        none = jnp.zeros(violated.shape, jnp.int32)
        first = functools.partial(_nearest_program, direction_only=False)
        arguments = planes, wanted, preferred, max_speed
        failed_at, velocity, decision = _decide_rows(violated, (none + count, wanted, none), first, *arguments)
        if count == walls:
            return decision
        fallback = functools.partial(_fallback_program, walls)
        arguments = planes, max_speed, failed_at, velocity, decision
        return _decide_rows(failed_at < count, decision, fallback, *arguments)

    @search.def_vmap
    def _(axis_size, in_batched, *arguments):
        def merge(leaf, batched):
            leaf = leaf if batched else jnp.broadcast_to(leaf, (axis_size, *leaf.shape))
            return leaf.reshape(axis_size * leaf.shape[1])

        merged = jax.tree.map(merge, arguments, tuple(in_batched))
        return search(*merged).reshape(axis_size, -1), True

    return search


def _decide_rows(needed, decision, program, *arguments):
    """``decision`` `[B]`, replaced by ``program(*arguments)`` in the rows that are ``needed``, `_ROWS` at a time."""
    size = needed.shape[0]
    rows = min(_ROWS, size)
    total = jnp.sum(needed)
    order = jnp.nonzero(needed, size=size, fill_value=size)[0].astype(jnp.int32)
    order = jnp.pad(order, (0, rows), constant_values=size)

    def decide(carry):
        done, decision = carry
        at = jax.lax.dynamic_slice_in_dim(order, done, rows)
        some = jax.tree.map(lambda leaf: leaf.at[at].get(mode="clip"), arguments)
        decided = jax.tree.map(lambda old, new: old.at[at].set(new, mode="drop"), decision, program(*some))
        return done + rows, decided

    return jax.lax.while_loop(lambda carry: carry[0] < total, decide, (jnp.int32(0), decision))[1]


def _decisions(count):
    """How many different decisions without `relaxed` there are."""
    return (count + 1) * (count + _BOUNDS)


def _nearest_program(planes, start, target, max_speed, direction_only):
    """RVO2's linearProgram2: planes one after the other.

    Returns (index of the plane that failed or their number, velocity, decision).
    """
    count = len(planes)
    stacked = _stack(planes)

    def add(carry, index_and_line):
        velocity, failed_at, line_number, end = carry
        i, line = index_and_line
        low, high, feasible = _interval(stacked, i, line, max_speed)
        if direction_only:
            new_end = jnp.where(target.dot(line.direction) > 0, _HIGH, _LOW)
            t = jnp.where(new_end == _HIGH, high, low)
        else:
            t = line.direction.dot(target - line.point)
            new_end = jnp.where(t < low, _LOW, jnp.where(t > high, _HIGH, _FREE))
            t = jnp.clip(t, low, high)
        violated = (line.violation(velocity) > 0) & (failed_at == count)
        moves = violated & feasible
        return (
            where(moves, line.point + t * line.direction, velocity),
            jnp.where(violated & ~feasible, i, failed_at),
            jnp.where(moves, i + 1, line_number),
            jnp.where(moves, new_end, end),
        ), None

    none = jnp.zeros(start.x.shape, jnp.int32)
    indices = jnp.arange(count, dtype=jnp.int32)
    carry = jax.lax.scan(add, (start, none + count, none, none), (indices, stacked))[0]
    velocity, failed_at, line_number, end = carry
    # Which plane ends the interval is asked only once, of the line that decided.
    line = _pick(planes, line_number - 1)
    low, high, _ = _chord(line, max_speed)
    t, lowers, raises, _ = _cuts(stacked, line_number - 1, line)
    lowered, raised = jnp.where(lowers, t, jnp.inf), jnp.where(raises, t, -jnp.inf)
    by_high = jnp.where(jnp.min(lowered, axis=0) < high, _BOUNDS + jax.lax.argmin(lowered, 0, jnp.int32), _HIGH)
    by_low = jnp.where(jnp.max(raised, axis=0) > low, _BOUNDS + jax.lax.argmax(raised, 0, jnp.int32), _LOW)
    bound = jnp.where(end == _HIGH, by_high, jnp.where(end == _LOW, by_low, _FREE))
    return failed_at, velocity, line_number * (count + _BOUNDS) + bound


def _interval(planes, i, line, max_speed):
    """RVO2's linearProgram1: (low, high, not empty) of the part of ``line``, plane i, that planes 0 to i - 1 permit."""
    low, high, exists = _chord(line, max_speed)
    t, lowers, raises, empty = _cuts(planes, i, line)
    # Folding rows by hand keeps whole vectors of them; a reduction over the first axis doesn't on a CPU.
    high = functools.reduce(jnp.minimum, jnp.where(lowers, t, jnp.inf), high)
    low = functools.reduce(jnp.maximum, jnp.where(raises, t, -jnp.inf), low)
    return low, high, exists & ~functools.reduce(jnp.logical_or, empty) & (low <= high)


def _cuts(planes, i, line):
    """How planes 0 to i - 1 cut ``line``: `[N, B]` t, nothing is left above t, nothing below t, nothing at all."""
    t, sine, offset = _crossing(jax.tree.map(lambda leaf: leaf[None], line), planes)
    parallel = jnp.abs(sine) <= _PARALLEL
    counts = planes.active & (jnp.arange(planes.active.shape[0])[:, None] < jnp.reshape(i, (1, -1)))
    cuts = counts & ~parallel
    return t, cuts & (sine >= 0), cuts & (sine < 0), counts & parallel & (offset < 0)


def _fallback_program(walls, planes, max_speed, failed_at, velocity, decision):
    """RVO2's linearProgram3: decisions `[B]` that violate agents' planes least, walls staying hard."""
    count = len(planes)
    agents = _stack(planes[walls:])

    def relax(carry, index_and_line):
        worst, velocity, _ = carry
        index, line = index_and_line
        relevant = (walls + index >= failed_at) & (line.violation(velocity) > worst)

        def improve(carry):
            worst, velocity, decision = carry
            bisectors = [_bisector(line, other) for other in planes[walls:]]
            bisectors = [plane._replace(active=plane.active & (j < index)) for j, plane in enumerate(bisectors)]
            direction = line.direction.left()
            every = planes[:walls] + bisectors
            fails_at, new, end = _nearest_program(
                every, direction * max_speed, direction, max_speed, direction_only=True
            )
            # Failing here is rounding: the velocity at hand is on the border already, so it is kept, as in RVO2.
            replace = relevant & (fails_at == count)
            decision = jnp.where(replace, end + (index + 1) * _decisions(count), decision)
            velocity = where(replace, new, velocity)
            return jnp.where(relevant, line.violation(velocity), worst), velocity, decision

        return jax.lax.cond(jnp.any(relevant), improve, lambda carry: carry, carry), None

    start = jnp.zeros_like(velocity.x), velocity, decision
    indices = jnp.arange(count - walls, dtype=jnp.int32)
    return jax.lax.scan(relax, start, (indices, agents))[0][2]
