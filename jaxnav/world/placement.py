"""Placement: where an episode's robot and pedestrians start and go, from the candidates that its scene draws.

The first candidate that keeps its distances is taken, so that a reset has a fixed cost.
"""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from .geometry import norm, unit
from .params import CLEARANCE, Params
from .scenes import Scene, straight
from .types import Pedestrian, Walls
from .walls import is_inside, pad_walls, wall_clearance, walls_from_chains

ROBOT_GAP = 1.5  # from the robot to any pedestrian at the start
PEDESTRIAN_GAP = 0.6  # between pedestrians at the start
_CANDIDATES = 32
_DRAWS = 12
_TRIES = 16  # episodes that `check_starts` tries


@struct.dataclass
class Floors:
    """Rectangles of free space: sides x0, y0, x1, y1 `[4, F]`, of which the first ``count`` are not padding."""

    sides: jax.Array | np.ndarray
    count: jax.Array | np.ndarray


def floor_table(scenes: Sequence[Scene]) -> Floors:
    """`Floors` of several scenes, numpy, padded to one size with the last floor: leaves `[scenes, ...]`."""
    size = max(len(scene.floors) for scene in scenes)
    sides = [np.pad(np.array(scene.floors).T, ((0, 0), (0, size - len(scene.floors))), mode="edge") for scene in scenes]
    return Floors(sides=np.stack(sides).astype(np.float32), count=np.array([len(scene.floors) for scene in scenes]))


@dataclasses.dataclass(frozen=True, eq=False)
class FromTable:
    """A ``meet`` or ``stroll`` that draws a row of a table: scenes that differ in numbers alone share its program.

    A world of many such scenes lays their tables one after the other and compiles ``function`` once. Called by itself
    it draws from its own table.

    function: (row, uniform numbers, *speeds) -> what ``meet`` or ``stroll`` returns; the same object in all the scenes.
    table:    numbers to choose from, a pytree of arrays `[N, ...]`. The first of the uniform numbers chooses the row;
              ``row`` has leaves `[C, ...]` for numbers `[C]`. One row is a scene's parameters.
    """

    function: Callable
    table: Any

    def __call__(self, numbers: Any, *speeds: Any) -> Any:
        return self.draw(self.table, 0, self.size, numbers, *speeds)

    @property
    def size(self) -> int:
        """N, the number of rows."""
        return len(jax.tree.leaves(self.table)[0])

    def shape(self) -> tuple[Any, tuple]:
        """(structure, shapes and types of a row). Tables can be joined where these and the function agree."""
        leaves, tree = jax.tree.flatten(self.table)
        return tree, tuple((leaf.shape[1:], leaf.dtype) for leaf in leaves)

    def draw(self, table: Any, first: jax.Array | int, count: jax.Array | int, numbers: Any, *speeds: Any) -> Any:
        """The result of `function` for one of the rows ``first`` to ``first + count - 1`` of a table like its own."""
        row = first + jnp.minimum((numbers[0] * count).astype(jnp.int32), count - 1)
        return self.function(jax.tree.map(lambda leaf: jnp.asarray(leaf)[row], table), numbers, *speeds)


def draw_of_scene(draws: Sequence[Callable], scene: jax.Array | int, numbers: Any, *speeds: Any) -> Any:
    """The result of the function of the scene with index ``scene`` for uniform ``numbers`` and ``speeds``.

    draws: a function for each scene. Each different one is compiled once, however many scenes have it; so is that of
    all `FromTable` with one function.
    """
    programs = {}
    for index, draw in enumerate(draws):
        kind = (draw.function, *draw.shape()) if isinstance(draw, FromTable) else draw
        programs.setdefault(kind, []).append(index)
    which = np.zeros(len(draws), np.int32)
    branches = []
    for members in programs.values():
        which[members] = len(branches)
        branches.append(_branch([draws[index] for index in members], members, len(draws), scene, speeds))
    return jax.lax.switch(jnp.asarray(which)[scene], branches, numbers)


def _branch(draws, members, scenes, scene, speeds):
    """A function of uniform numbers: that of ``draws``, which share a program, those of the scenes ``members``."""
    draw = draws[0]
    # Speeds are no operands of the switch: where they are Python's numbers, they stay so.
    if not isinstance(draw, FromTable) or len(draws) == 1:
        return lambda numbers: draw(numbers, *speeds)
    table = jax.tree.map(lambda *leaves: np.concatenate(leaves), *(one.table for one in draws))
    sizes = [one.size for one in draws]
    first, count = np.zeros(scenes, np.int32), np.ones(scenes, np.int32)
    first[members], count[members] = np.cumsum([0, *sizes[:-1]]), sizes
    first, count = jnp.asarray(first)[scene], jnp.asarray(count)[scene]
    return lambda numbers: draw.draw(table, first, count, numbers, *speeds)


def place(
    key: jax.Array, scenes: Sequence[Scene], scene: jax.Array | int, walls: Walls, floors: Floors, pedestrians: int,
    params: Params,
) -> tuple[tuple[jax.Array, ...], Pedestrian]:  # fmt: skip
    """Start of an episode: ((robot x, y, heading, goal x, goal y), `Pedestrian` `[P]`).

    scene: index into ``scenes``; walls, floors: of that scene. The first pedestrian meets the robot; further ones
    stroll.
    """
    key_meet, key_stroll = (key, None) if pedestrians == 1 else jax.random.split(key)

    # A last row turns the robot: 31 numbers too many cost less than one draw more.
    *numbers, turns = jax.random.uniform(key_meet, (_DRAWS + 1, _CANDIDATES))
    # Only the candidates differ from scene to scene: what follows is compiled once, not once a scene.
    robots, firsts = _meetings(numbers, scenes, scene, params)
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
    return (x, y, heading, goal_x, goal_y), _at_start(*routes, present, params)  # pyright: ignore[reportCallIssue]


def _meetings(numbers, scenes, scene, params):
    """Candidates of one of the scenes: the robot's start and goal `[4, C]`, the first pedestrian's route `[6, C]`."""
    robot, first = draw_of_scene([one.meet for one in scenes], scene, numbers, params.max_v, params.preferred_speed)
    return jnp.stack(robot), jnp.stack(first)


def _choose(robots, firsts, walls, floors):
    """Index of the first candidate that keeps its distances, or else of the one that falls least short of them."""
    x, y = (jnp.concatenate([robots[i], robots[i + 2], firsts[i], firsts[i + 4]]) for i in (0, 1))
    clear = jnp.minimum(wall_clearance(x, y, walls), _floor_depth(x, y, floors)).reshape(4, _CANDIDATES)
    apart = norm(robots[0] - firsts[0], robots[1] - firsts[1])
    # Metres by which a candidate falls short.
    short = jnp.maximum(CLEARANCE - jnp.min(clear, axis=0), ROBOT_GAP - apart)
    return jnp.argmin(jnp.maximum(short, 0.0))


def check_starts(scenes: Sequence[Scene], pedestrians: int) -> None:
    """Try a few episodes of each scene with its own people.

    pedestrians: how many the world holds. ValueError: somebody starts or ends outside of the walls or in another body.
    """
    for scene in scenes:
        _check_draws(scene)
    walls, floors = pad_walls([walls_from_chains(scene.chains) for scene in scenes]), floor_table(scenes)
    numbers = np.random.default_rng(0).random((_TRIES, _DRAWS, _CANDIDATES), np.float32)
    several = [min(pedestrians, scene.crowd[1] if scene.crowd else pedestrians) > 1 for scene in scenes]

    @jax.jit  # once for all scenes
    def starts(scene, params):
        own_walls, own_floors = jax.tree.map(lambda leaf: jnp.asarray(leaf)[scene], (walls, floors))

        def start(numbers):
            robots, firsts = _meetings(list(numbers), scenes, scene, params)
            chosen = _choose(robots, firsts, own_walls, own_floors)
            further = _stroll(numbers[:5], scenes, scene, own_floors) if any(several) else firsts[:, :0]
            return robots[:, chosen], firsts[:, chosen], further

        return jax.vmap(start)(numbers)

    for number, scene in enumerate(scenes):
        params = Params(**scene.params)
        # Also where a world is made while something is traced.
        with jax.ensure_compile_time_eval():
            robot, first, further = (np.asarray(part) for part in starts(jnp.int32(number), params))
        _check_starts(scene, params, robot, first, further if several[number] else further[..., :0])


def _check_draws(scene):
    """ValueError: ``meet`` or ``stroll`` takes other arguments, raises, or returns other than coordinates `[C]`."""
    _check_draw(f"scene {scene.name}: meet", scene.meet, _DRAWS, (0.6, 0.5), (4, 6))
    if scene.stroll is not None:
        _check_draw(f"scene {scene.name}: stroll", scene.stroll, 5, (), (6,))


def _check_draw(said, draw, count, speeds, sizes):
    """`_check_draws` of a function of ``count`` arrays of uniform numbers; sizes: of the tuples that it returns."""
    number = jax.ShapeDtypeStruct((_CANDIDATES,), jnp.float32)
    try:
        drawn = jax.eval_shape(lambda numbers: draw(numbers, *speeds), [number] * count)
    except Exception as error:
        text = str(error).partition("\n")[0]
        takes = f"({count} arrays of uniform numbers{', robot speed, pedestrian speed' if speeds else ''})"
        raise ValueError(f"{said} raises {type(error).__name__} ({text}): let it take {takes}, in jnp") from error
    groups = drawn if len(sizes) > 1 else (drawn,)
    found = tuple(len(group) if isinstance(group, tuple | list) else 0 for group in groups)
    if found != sizes or any(leaf.shape != number.shape for leaf in jax.tree.leaves(drawn)):
        wanted = "(robot x, y, goal x, y), " * (len(sizes) > 1) + "(x, y, way point x, y, goal x, y)"
        raise ValueError(f"{said} returns something else than {wanted}: let it return these, each shaped like u[0]")


def _check_starts(scene, params, robot, first, further):
    """`check_starts` of one scene: starts and goals of robots `[T, 4]`, routes `[T, 6]` and `[T, 6, C]` of others."""
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
        routes = _stroll(u, scenes, scene, floors)
        x, y = routes[:2]
        gap = norm(x[:, None] - placed[0][None], y[:, None] - placed[1][None]) - PEDESTRIAN_GAP
        gap = jnp.where((jnp.arange(count + 1) <= index)[None], gap, jnp.inf).min(axis=1)
        short = jnp.maximum(-gap, ROBOT_GAP - norm(x - robot_x, y - robot_y))
        chosen = jnp.argmin(jnp.maximum(short, 0.0))
        return placed.at[:, index + 1].set(routes[:, chosen]), None

    start = jnp.zeros((6, count + 1)).at[:, 0].set(first)
    return jax.lax.scan(one, start, (jnp.arange(count), jax.random.split(key, count)))[0][:, 1:]


def _stroll(u, scenes, scene, floors):
    """Routes `[6, ...]` of further pedestrians in the scene with index ``scene``; ``floors``: its own."""

    def on_floor(u):
        return _stroll_on_floor(u, floors)

    return jnp.stack(draw_of_scene([one.stroll or on_floor for one in scenes], scene, u))


def _stroll_on_floor(u, floors):
    """`Route` from anywhere to anywhere on one of the floors."""
    low_x, low_y, high_x, high_y = floors.sides[:, (u[4] * floors.count).astype(jnp.int32)]
    pad = CLEARANCE
    x, goal_x = (low_x + pad + u[i] * (high_x - low_x - 2 * pad) for i in (0, 2))
    y, goal_y = (low_y + pad + u[i] * (high_y - low_y - 2 * pad) for i in (1, 3))
    return straight(x, y, goal_x, goal_y)
