"""Placement: where an episode's robot and pedestrians start and go, from the candidates that its scene draws.

The first candidate that keeps its distances is taken, so that a reset has a fixed cost.
"""

import functools

import chex
import jax
import jax.numpy as jnp
import numpy as np

from .geometry import norm, unit
from .scenes import straight
from .types import Pedestrian
from .walls import wall_clearance

CLEARANCE = 0.3  # from starts and goals to walls
ROBOT_GAP = 1.5  # from the robot to any pedestrian at the start
PEDESTRIAN_GAP = 0.6  # between pedestrians at the start
_CANDIDATES = 32
_DRAWS = 12


@chex.dataclass(frozen=True)
class Floors:
    """Rectangles of free space: sides x0, y0, x1, y1 `[4, F]`, of which the first ``count`` are not padding."""

    sides: jax.Array
    count: jax.Array


def floor_table(scenes):
    """`Floors` of several scenes, numpy, padded to one size with the last floor: leaves `[scenes, ...]`."""
    size = max(len(scene.floors) for scene in scenes)
    sides = [np.pad(np.array(scene.floors).T, ((0, 0), (0, size - len(scene.floors))), mode="edge") for scene in scenes]
    return Floors(sides=np.stack(sides).astype(np.float32), count=np.array([len(scene.floors) for scene in scenes]))


def place(key, scenes, scene, walls, floors, pedestrians, params):
    """Start of an episode: ((robot x, y, heading, goal x, goal y), `Pedestrian` `[P]`).

    scene: index into ``scenes``; walls, floors: of that scene. The first pedestrian meets the robot; further ones
    stroll.
    """
    key_meet, key_stroll = (key, None) if pedestrians == 1 else jax.random.split(key)

    def candidates(numbers, kind):
        robot, first = kind.meet(numbers, params.max_v, params.preferred_speed)
        return jnp.stack(robot), jnp.stack(first)

    # A last row turns the robot: 31 numbers too many cost less than one draw more.
    *numbers, turns = jax.random.uniform(key_meet, (_DRAWS + 1, _CANDIDATES))
    # Only the candidates differ from scene to scene: what follows is compiled once, not once a scene.
    robots, firsts = jax.lax.switch(scene, [functools.partial(candidates, kind=kind) for kind in scenes], numbers)
    x, y = (jnp.concatenate([robots[i], robots[i + 2], firsts[i], firsts[i + 4]]) for i in (0, 1))
    clear = jnp.minimum(wall_clearance(x, y, walls), _floor_depth(x, y, floors)).reshape(4, _CANDIDATES)
    apart = norm(robots[0] - firsts[0], robots[1] - firsts[1])
    # Metres by which a candidate falls short; the first that doesn't is taken.
    short = jnp.maximum(CLEARANCE - jnp.min(clear, axis=0), ROBOT_GAP - apart)
    chosen = jnp.argmin(jnp.maximum(short, 0.0))
    x, y, goal_x, goal_y = robots[:, chosen]
    heading = jnp.arctan2(goal_y - y, goal_x - x) + (2.0 * turns[0] - 1.0) * 0.3
    first = firsts[:, chosen]
    routes, present = first[:, None], jnp.ones(1, bool)
    if pedestrians > 1:
        others = _strollers(key_stroll, scenes, scene, floors, pedestrians - 1, x, y, first)
        routes = jnp.concatenate([routes, others], axis=1)
        # The turn is drawn anew for each candidate: those of the others serve as further random numbers.
        present = jnp.arange(pedestrians) < _crowd_size(turns[1], scenes, scene, pedestrians)
    return (x, y, heading, goal_x, goal_y), _at_start(*routes, present, params)


def _crowd_size(u, scenes, scene, pedestrians):
    """How many pedestrians are there, by a uniform number."""
    sizes = [one.crowd or (pedestrians, pedestrians) for one in scenes]
    least, most = (jnp.array([min(size[i], pedestrians) for size in sizes])[scene] for i in (0, 1))
    return least + (u * (most - least + 1)).astype(jnp.int32)


def _at_start(x, y, via_x, via_y, goal_x, goal_y, present, params):
    """`Pedestrian` `[P]` that set out along their routes at walking speed."""
    ux, uy = unit(via_x - x, via_y - y)
    return Pedestrian(
        x=x, y=y, vx=params.preferred_speed * ux, vy=params.preferred_speed * uy, goal_x=goal_x, goal_y=goal_y,
        via_x=via_x, via_y=via_y, turned=(via_x == goal_x) & (via_y == goal_y), present=present,
    )  # fmt: skip


def _floor_depth(x, y, floors):
    """Minus the distance to the nearest floor, inf on one: how far in is for the walls to say."""

    def depth_in(x0, y0, x1, y1):
        return jnp.minimum(jnp.minimum(x - x0, x1 - x), jnp.minimum(y - y0, y1 - y))

    depth = jnp.max(jax.vmap(depth_in)(*floors.sides), axis=0)
    return jnp.where(depth < 0, depth, jnp.inf)


def _strollers(key, scenes, scene, floors, count, robot_x, robot_y, first):
    """Routes `[6, count]` of further pedestrians, each clear of the robot and of those placed before."""

    def one(placed, index_and_key):
        index, key = index_and_key
        u = jax.random.uniform(key, (5, 4 * _CANDIDATES))
        kinds = dict.fromkeys(one.stroll for one in scenes)
        branches = [
            lambda u, kind=kind: jnp.stack(_stroll_on_floor(u, floors) if kind is None else kind(u)) for kind in kinds
        ]
        which = jnp.array([list(kinds).index(one.stroll) for one in scenes])[scene]
        routes = jax.lax.switch(which, branches, u)
        x, y = routes[:2]
        gap = norm(x[:, None] - placed[0][None], y[:, None] - placed[1][None]) - PEDESTRIAN_GAP
        gap = jnp.where((jnp.arange(count + 1) <= index)[None], gap, jnp.inf).min(axis=1)
        short = jnp.maximum(-gap, ROBOT_GAP - norm(x - robot_x, y - robot_y))
        chosen = jnp.argmin(jnp.maximum(short, 0.0))
        return placed.at[:, index + 1].set(routes[:, chosen]), None

    start = jnp.zeros((6, count + 1)).at[:, 0].set(first)
    return jax.lax.scan(one, start, (jnp.arange(count), jax.random.split(key, count)))[0][:, 1:]


def _stroll_on_floor(u, floors):
    """`Route` from anywhere to anywhere on one of the floors."""
    low_x, low_y, high_x, high_y = floors.sides[:, (u[4] * floors.count).astype(jnp.int32)]
    pad = CLEARANCE
    x, goal_x = (low_x + pad + u[i] * (high_x - low_x - 2 * pad) for i in (0, 2))
    y, goal_y = (low_y + pad + u[i] * (high_y - low_y - 2 * pad) for i in (1, 3))
    return straight(x, y, goal_x, goal_y)
