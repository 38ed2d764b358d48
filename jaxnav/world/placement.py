"""Placement: where an episode's robot and pedestrians start and go, from the candidates that its scene draws.

The first candidate that keeps its distances is taken, so that a reset has a fixed cost.
"""

import functools

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from .geometry import norm, unit
from .params import CLEARANCE, Params
from .scenes import straight
from .types import Pedestrian
from .walls import is_inside, wall_clearance, walls_from_chains

ROBOT_GAP = 1.5  # from the robot to any pedestrian at the start
PEDESTRIAN_GAP = 0.6  # between pedestrians at the start
_CANDIDATES = 32
_DRAWS = 12
_TRIES = 16  # episodes that `check_starts` tries


@struct.dataclass
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

    # A last row turns the robot: 31 numbers too many cost less than one draw more.
    *numbers, turns = jax.random.uniform(key_meet, (_DRAWS + 1, _CANDIDATES))
    # Only the candidates differ from scene to scene: what follows is compiled once, not once a scene.
    branches = [functools.partial(_candidates, scene=kind, params=params) for kind in scenes]
    robots, firsts = jax.lax.switch(scene, branches, numbers)
    chosen = _choose(robots, firsts, walls, floors)
    x, y, goal_x, goal_y = robots[:, chosen]
    heading = jnp.arctan2(goal_y - y, goal_x - x) + (2.0 * turns[0] - 1.0) * 0.3
    first = firsts[:, chosen]
    routes, present = first[:, None], jnp.ones(1, bool)
    if pedestrians > 1:
        others = _strollers(key_stroll, scenes, scene, floors, pedestrians - 1, x, y, first)
        routes = jnp.concatenate([routes, others], axis=1)
        # The turn is drawn anew for each candidate: those of the others serve as further random numbers.
        present = jnp.arange(pedestrians) < _crowd_size(turns[1], scenes, scene, pedestrians, params)
    return (x, y, heading, goal_x, goal_y), _at_start(*routes, present, params)


def _candidates(numbers, scene, params):
    """Candidates `[., C]`: the robot's start and goal `[4, C]`, the first pedestrian's route `[6, C]`."""
    robot, first = scene.meet(numbers, params.max_v, params.preferred_speed)
    return jnp.stack(robot), jnp.stack(first)


def _choose(robots, firsts, walls, floors):
    """Index of the first candidate that keeps its distances, or else of the one that falls least short of them."""
    x, y = (jnp.concatenate([robots[i], robots[i + 2], firsts[i], firsts[i + 4]]) for i in (0, 1))
    clear = jnp.minimum(wall_clearance(x, y, walls), _floor_depth(x, y, floors)).reshape(4, _CANDIDATES)
    apart = norm(robots[0] - firsts[0], robots[1] - firsts[1])
    # Metres by which a candidate falls short.
    short = jnp.maximum(CLEARANCE - jnp.min(clear, axis=0), ROBOT_GAP - apart)
    return jnp.argmin(jnp.maximum(short, 0.0))


def check_starts(scene, pedestrians):
    """Try a few episodes of a scene with its own people; ValueError: somebody outside of the walls, or in another body.

    pedestrians: how many the world holds.
    """
    params, walls = Params(**scene.params), walls_from_chains(scene.chains)
    numbers = np.random.default_rng(0).random((_TRIES, _DRAWS, _CANDIDATES), np.float32)
    strolls = min(pedestrians, scene.crowd[1] if scene.crowd else pedestrians) > 1

    @jax.jit
    @jax.vmap
    def starts(numbers):
        floors = jax.tree.map(lambda leaf: jnp.asarray(leaf[0]), floor_table([scene]))
        robots, firsts = _candidates(list(numbers), scene, params)
        chosen = _choose(robots, firsts, walls, floors)
        return robots[:, chosen], firsts[:, chosen], _stroll(numbers[:5], scene, floors) if strolls else firsts[:, :0]

    # Also where a world is made while something is traced.
    with jax.ensure_compile_time_eval():
        robot, first, further = (np.asarray(part) for part in starts(numbers))
    ends = [robot[:, :2], robot[:, 2:], first[:, :2], first[:, 4:]]
    ends += [np.moveaxis(further[:, i : i + 2], 1, -1).reshape(-1, 2) for i in (0, 4)]
    x, y = np.concatenate(ends).T
    outside = np.flatnonzero(~is_inside(x, y, scene.chains))
    if outside.size:
        at = f"({x[outside[0]]:.2f}, {y[outside[0]]:.2f})"
        raise ValueError(f"scene {scene.name}: meet, stroll or floors place somebody at {at}, outside of the walls")
    apart = np.hypot(*(robot[:, :2] - first[:, :2]).T).min()
    if apart <= params.robot_radius + params.body_radius:
        raise ValueError(
            f"scene {scene.name}: meet starts robot and pedestrian {apart:.2f} m apart: "
            f"let it draw starts that are {ROBOT_GAP} m apart"
        )


def _crowd_size(u, scenes, scene, pedestrians, params):
    """How many pedestrians are there, by a uniform number where the scene leaves it to chance."""
    sizes = [one.crowd or (0, 0) for one in scenes]
    least, most = (jnp.array([min(size[i], pedestrians) for size in sizes])[scene] for i in (0, 1))
    usual = jnp.where(jnp.asarray(params.crowd_size) > 0, params.crowd_size, pedestrians).astype(jnp.int32)
    return jnp.where(most == 0, usual, least + (u * (most - least + 1)).astype(jnp.int32))


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
        kinds = {one.stroll: one for one in scenes}
        branches = [functools.partial(_stroll, scene=one, floors=floors) for one in kinds.values()]
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


def _stroll(u, scene, floors):
    """Routes `[6, ...]` of a scene's further pedestrians."""
    return jnp.stack(_stroll_on_floor(u, floors) if scene.stroll is None else scene.stroll(u))


def _stroll_on_floor(u, floors):
    """`Route` from anywhere to anywhere on one of the floors."""
    low_x, low_y, high_x, high_y = floors.sides[:, (u[4] * floors.count).astype(jnp.int32)]
    pad = CLEARANCE
    x, goal_x = (low_x + pad + u[i] * (high_x - low_x - 2 * pad) for i in (0, 2))
    y, goal_y = (low_y + pad + u[i] * (high_y - low_y - 2 * pad) for i in (1, 3))
    return straight(x, y, goal_x, goal_y)
