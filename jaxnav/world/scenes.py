"""Scenes: walls, and where an episode's robot and pedestrians start and go (docs/world.md section 2).

A scene draws candidates of a placement from uniform numbers; `place` takes the first that keeps its distances, so a
reset has a fixed cost. A new scene is one more `Scene` in `SCENES`.
"""

import dataclasses
import functools
from collections.abc import Callable

import chex
import jax
import jax.numpy as jnp
import numpy as np

from .geometry import norm
from .walls import wall_clearance

CLEARANCE = 0.3  # from starts and goals to walls
ROBOT_GAP = 1.5  # from the robot to any pedestrian at the start
PEDESTRIAN_GAP = 0.6  # between pedestrians at the start
_CANDIDATES = 32
_DRAWS = 12


@dataclasses.dataclass(frozen=True)
class Scene:
    """One scene.

    chains:    closed polygons of (x, y) vertices, free space to the left of each edge.
    floors:    rectangles (x0, y0, x1, y1) of free space, in which further pedestrians stroll.
    capacity:  the most pedestrians that still find a place.
    meet:      (12 arrays of uniform numbers in [0, 1), robot speed, pedestrian speed) -> `Meeting` of such arrays.
    """

    name: str
    chains: tuple[tuple[tuple[float, float], ...], ...]
    floors: tuple[tuple[float, float, float, float], ...]
    capacity: int
    meet: Callable


# (robot x, y, goal x, y), (pedestrian x, y, goal x, y)
Meeting = tuple[tuple, tuple]


def _centred(u, half_width):
    return (2.0 * u - 1.0) * half_width


def _sign(u):
    return jnp.where(u < 0.5, -1.0, 1.0)


def _meet_square(u, robot_speed, speed):
    """Start-goal 4-6 m anywhere; the pedestrian meets the robot's straight line, from any heading not near its own."""
    length, along = 4.0 + 2.0 * u[0], _centred(u[1], jnp.pi)
    cx, cy = _centred(u[2], 1.5), _centred(u[3], 1.5)
    ux, uy = jnp.cos(along), jnp.sin(along)
    x, y = cx - 0.5 * length * ux, cy - 0.5 * length * uy
    fraction = 0.35 + 0.35 * u[4]
    mx, my = x + fraction * length * ux, y + fraction * length * uy
    # The robot needs about half a second to get going; the offset makes the meeting less than perfect.
    time = fraction * length / robot_speed
    heading = along + jnp.pi + _centred(u[5], 2.3)
    hx, hy = jnp.cos(heading), jnp.sin(heading)
    ox, oy = _centred(u[6], 0.4), _centred(u[7], 0.4)
    px, py = mx - speed * time * hx + ox, my - speed * time * hy + oy
    return (x, y, x + length * ux, y + length * uy), (px, py, mx + 3.0 * hx + ox, my + 3.0 * hy + oy)


def _meet_hallway(u, robot_speed, speed):
    """From opposite ends toward each other, lateral offsets within 0.4 m, start-goal 7 m."""
    del robot_speed, speed
    side = _sign(u[0])
    y = [_centred(u[i], 0.4) for i in range(1, 5)]
    return (-4.0 * side, y[0], 3.0 * side, y[1]), ((3.0 + 1.2 * u[5]) * side, y[2], -4.6 * side, y[3])


def _meet_crosswalk(u, robot_speed, speed):
    """Along the two corridors, timed to meet near the centre, start-goal 8 m."""
    side, other = _sign(u[0]), _sign(u[1])
    a = [_centred(u[i], 0.4) for i in range(2, 6)]
    start = jnp.minimum(4.2 * speed / robot_speed + _centred(u[6], 0.5), 4.6)
    return (-4.2 * side, a[0], 3.8 * side, a[1]), (a[2], start * other, a[3], -4.6 * other)


def _rectangle(half_x, half_y):
    return ((-half_x, -half_y), (half_x, -half_y), (half_x, half_y), (-half_x, half_y))


def _cross(half_length, half_width):
    a, b = half_width, half_length
    return ((-b, -a), (-a, -a), (-a, -b), (a, -b), (a, -a), (b, -a), (b, a), (a, a), (a, b), (-a, b), (-a, a), (-b, a))


SCENES = {
    scene.name: scene
    for scene in (
        Scene("square", (_rectangle(5.0, 5.0),), ((-5.0, -5.0, 5.0, 5.0),), 64, _meet_square),
        Scene("hallway", (_rectangle(5.0, 1.6),), ((-5.0, -1.6, 5.0, 1.6),), 16, _meet_hallway),
        Scene("crosswalk", (_cross(5.0, 1.3),), ((-5.0, -1.3, 5.0, 1.3), (-1.3, -5.0, 1.3, 5.0)), 24, _meet_crosswalk),
    )
}


def get(name):
    """The scene of that name; ValueError names those there are."""
    if name not in SCENES:
        raise ValueError(f"scene {name!r} is unknown: choose from {', '.join(SCENES)}")
    return SCENES[name]


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
    """Start of an episode: ((robot x, y, heading, goal x, goal y), (x, y, goal x, goal y) of pedestrians `[P]`).

    scene: index into ``scenes``; walls, floors: of that scene. The first pedestrian meets the robot; further ones
    stroll along a floor.
    """
    key_meet, key_stroll = (key, None) if pedestrians == 1 else jax.random.split(key)

    def candidates(numbers, kind):
        robot, first = kind.meet(numbers, params.max_v, params.preferred_speed)
        return jnp.stack(robot), jnp.stack(first)

    # A last row turns the robot: 31 numbers too many cost less than one draw more.
    *numbers, turns = jax.random.uniform(key_meet, (_DRAWS + 1, _CANDIDATES))
    # Only the candidates differ from scene to scene: what follows is compiled once, not once a scene.
    robots, firsts = jax.lax.switch(scene, [functools.partial(candidates, kind=kind) for kind in scenes], numbers)
    x, y = (jnp.concatenate([robots[i], robots[i + 2], firsts[i], firsts[i + 2]]) for i in (0, 1))
    clear = jnp.minimum(wall_clearance(x, y, walls), _floor_depth(x, y, floors)).reshape(4, _CANDIDATES)
    apart = norm(robots[0] - firsts[0], robots[1] - firsts[1])
    # Metres by which a candidate falls short; the first that doesn't is taken.
    short = jnp.maximum(CLEARANCE - jnp.min(clear, axis=0), ROBOT_GAP - apart)
    chosen = jnp.argmin(jnp.maximum(short, 0.0))
    x, y, goal_x, goal_y = robots[:, chosen]
    heading = jnp.arctan2(goal_y - y, goal_x - x) + _centred(turns[0], 0.3)
    first = firsts[:, chosen]
    if pedestrians == 1:
        return (x, y, heading, goal_x, goal_y), tuple(first[:, None])
    others = _strollers(key_stroll, floors, pedestrians - 1, x, y, first)
    return (x, y, heading, goal_x, goal_y), tuple(jnp.concatenate([first[:, None], others], axis=1))


def _floor_depth(x, y, floors):
    """Minus the distance to the nearest floor, inf on one: how far in is for the walls to say."""

    def depth_in(x0, y0, x1, y1):
        return jnp.minimum(jnp.minimum(x - x0, x1 - x), jnp.minimum(y - y0, y1 - y))

    depth = jnp.max(jax.vmap(depth_in)(*floors.sides), axis=0)
    return jnp.where(depth < 0, depth, jnp.inf)


def _strollers(key, floors, count, robot_x, robot_y, first):
    """`[4, count]` starts and goals on random floors, each clear of the robot and of those placed before."""

    def one(placed, index_and_key):
        index, key = index_and_key
        key_floor, key_point = jax.random.split(key)
        floor = jax.random.randint(key_floor, (4 * _CANDIDATES,), 0, floors.count)
        u = jax.random.uniform(key_point, (4, 4 * _CANDIDATES))
        low_x, low_y, high_x, high_y = floors.sides[:, floor]
        pad = CLEARANCE
        x, goal_x = (low_x + pad + u[i] * (high_x - low_x - 2 * pad) for i in (0, 2))
        y, goal_y = (low_y + pad + u[i] * (high_y - low_y - 2 * pad) for i in (1, 3))
        gap = norm(x[:, None] - placed[0][None], y[:, None] - placed[1][None]) - PEDESTRIAN_GAP
        gap = jnp.where((jnp.arange(count + 1) <= index)[None], gap, jnp.inf).min(axis=1)
        short = jnp.maximum(-gap, ROBOT_GAP - norm(x - robot_x, y - robot_y))
        chosen = jnp.argmin(jnp.maximum(short, 0.0))
        new = jnp.stack([x, y, goal_x, goal_y])[:, chosen]
        return placed.at[:, index + 1].set(new), None

    start = jnp.zeros((4, count + 1)).at[:, 0].set(first)
    return jax.lax.scan(one, start, (jnp.arange(count), jax.random.split(key, count)))[0][:, 1:]
