"""Scenes: walls, and where an episode's robot and pedestrians start and go (docs/world.md section 2).

A scene draws candidates from uniform numbers; `jaxnav.world.placement` takes one. `register_scene` adds a scene.
"""

import dataclasses
from collections.abc import Callable, Iterable, Mapping, Sequence

import jax
import jax.numpy as jnp
import numpy as np

from .config import MAX_PEDESTRIANS
from .params import Params
from .types import WallCells
from .walls import enclosed_area, walls_from_chains


@dataclasses.dataclass(frozen=True, eq=False)
class Scene:
    """One scene. ValueError names scene, field, value and remedy.

    chains:    closed polygons of (x, y) vertices, free space to the left of each edge.
    floors:    rectangles (x0, y0, x1, y1) of free space, in which further pedestrians stroll.
    capacity:  the most pedestrians that still find a place.
    meet:      (12 arrays of uniform numbers in [0, 1), robot speed, pedestrian speed) -> `Meeting` of such arrays.
    stroll:    (5 arrays of uniform numbers) -> where further pedestrians start and go: `Route`; None: along a floor.
    crowd:     (fewest, most) pedestrians, drawn for each episode; None: as many as the world holds.
    sight:     which pedestrians are given to the robot: one of `SIGHTS`.
    passage:   (x, y) through which every way from start to goal leads, a door or a corner; None: the way is straight.
    cells:     which walls count where, for a floor plan of very many; None: all count everywhere.
    params:    fields of `Params` in which the people of this scene differ, by name.
    """

    name: str
    chains: tuple[tuple[tuple[float, float], ...], ...]
    floors: tuple[tuple[float, float, float, float], ...]
    capacity: int
    meet: Callable
    stroll: Callable | None = None
    crowd: tuple[int, int] | None = None
    sight: str = "all"
    passage: tuple[float, float] | None = None
    cells: WallCells | None = None
    params: Mapping[str, float] = dataclasses.field(default_factory=dict)

    def __post_init__(self):
        try:
            _check(self)
        except ValueError as error:
            raise ValueError(f"scene {self.name}: {error}") from None


# Given: every pedestrian; those whom no wall hides; nobody, so that the robot has to read them from its scan.
SIGHTS = ("all", "line", "none")


def _check(scene):
    for name in ("chains", "floors"):
        if len(getattr(scene, name)) == 0:
            raise ValueError(f"{name} is empty: give at least one")
    walls_from_chains(scene.chains)
    area = sum(map(enclosed_area, scene.chains))
    if not area > 0:
        raise ValueError(
            f"chains enclose {area:.4g} m^2: draw rooms counter-clockwise, free space to the left, obstacles clockwise"
        )
    for number, floor in enumerate(scene.floors):
        if len(floor) != 4 or not np.all(np.isfinite(floor)) or not (floor[0] < floor[2] and floor[1] < floor[3]):
            raise ValueError(
                f"floors has {floor} as number {number}: give finite (x0, y0, x1, y1), x0 < x1 and y0 < y1"
            )
    if scene.sight not in SIGHTS:
        raise ValueError(f"sight is {scene.sight!r}: choose from {', '.join(SIGHTS)}")
    if scene.crowd is not None:
        counts = len(scene.crowd) == 2 and all(isinstance(count, int) for count in scene.crowd)
        if not (counts and 1 <= scene.crowd[0] <= scene.crowd[1] <= MAX_PEDESTRIANS):
            raise ValueError(f"crowd is {scene.crowd}: give (fewest, most), whole numbers from 1 to {MAX_PEDESTRIANS}")
    for name in scene.params:
        if name not in Params.__dataclass_fields__:
            raise ValueError(f"params names {name!r}: give fields of Params")


Route = tuple  # x, y, way point x, y, goal x, y; a way point on the goal is none
Meeting = tuple[tuple, Route]  # (robot x, y, goal x, y), the pedestrian's route


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
    # A faster pedestrian starts later, so that its way there fits in the square.
    away = jnp.minimum(speed * time, 2.1 * fraction * length)
    heading = along + jnp.pi + _centred(u[5], 2.3)
    hx, hy = jnp.cos(heading), jnp.sin(heading)
    ox, oy = _centred(u[6], 0.4), _centred(u[7], 0.4)
    px, py = mx - away * hx + ox, my - away * hy + oy
    return (x, y, x + length * ux, y + length * uy), straight(px, py, mx + 3.0 * hx + ox, my + 3.0 * hy + oy)


def _meet_hallway(u, robot_speed, speed):
    """From opposite ends toward each other, lateral offsets within 0.4 m, start-goal 7 m."""
    del robot_speed, speed
    side = _sign(u[0])
    y = [_centred(u[i], 0.4) for i in range(1, 5)]
    return (-4.0 * side, y[0], 3.0 * side, y[1]), straight((3.0 + 1.2 * u[5]) * side, y[2], -4.6 * side, y[3])


def _meet_crosswalk(u, robot_speed, speed):
    """Along the two corridors, timed to meet near the centre, start-goal 8 m."""
    side, other = _sign(u[0]), _sign(u[1])
    a = [_centred(u[i], 0.4) for i in range(2, 6)]
    start = jnp.minimum(4.2 * speed / robot_speed + _centred(u[6], 0.5), 4.6)
    return (-4.2 * side, a[0], 3.8 * side, a[1]), straight(a[2], start * other, a[3], -4.6 * other)


def straight(x: jax.Array, y: jax.Array, goal_x: jax.Array, goal_y: jax.Array) -> Route:
    """`Route` without a way point."""
    return x, y, goal_x, goal_y, goal_x, goal_y


def _meet_narrow(u, robot_speed, speed):
    """From opposite ends of a corridor in which two just pass each other."""
    del robot_speed, speed
    side = _sign(u[0])
    y = [_centred(u[i], 0.25) for i in range(1, 5)]
    return ((-4.6 + u[5]) * side, y[0], 3.6 * side, y[1]), straight((4.4 + 1.2 * u[6]) * side, y[2], -5.4 * side, y[3])


def _meet_doorway(u, robot_speed, speed):
    """From both sides of a door, timed to be there together."""
    side = _sign(u[0])
    y = [_centred(u[i], 0.4) for i in range(1, 5)]
    away = 2.4 + 0.8 * u[5]
    start = jnp.minimum(away * speed / robot_speed + _centred(u[6], 0.8), 5.4)
    return (-away * side, y[0], 3.0 * side, y[1]), (start * side, y[2], -0.3 * side, 0.0 * y[0], -5.2 * side, y[3])


def _meet_corner(u, robot_speed, speed):
    """Around a corner, behind which neither sees the other; either one may come along either arm."""
    a = [_centred(u[i], 0.25) for i in range(1, 5)]
    away = 2.4 + 0.8 * u[5]
    start = jnp.minimum(away * speed / robot_speed + _centred(u[6], 0.8), 5.4)
    zero = 0.0 * a[0]
    robot, walker = (-away, a[0], a[1], 3.4), (a[2], start, zero, zero, -5.4, a[3])
    # Mirrored at y = -x the arms change places.
    mirrored = (-robot[1], -robot[0], -robot[3], -robot[2]), (
        -walker[1], -walker[0], zero, zero, -walker[5], -walker[4],
    )  # fmt: skip
    flip = u[0] < 0.5
    return jax.tree.map(lambda one, other: jnp.where(flip, one, other), mirrored, (robot, walker))


def _meet_crossflow(u, robot_speed, speed):
    """Across a hall in which people walk to and fro at right angles; the first of them is timed to meet the robot."""
    side, walks = _sign(u[0]), _sign(u[1])
    y = [_centred(u[i], 0.8) for i in (2, 3)]
    fraction = 0.3 + 0.5 * u[4]
    x = (-4.4 + 8.4 * fraction) * side
    # On its way there, or on its way back: it walks faster than the robot.
    length = 3.4 + speed * (8.4 * fraction / robot_speed) + _centred(u[5], 0.4)
    start = (length % 6.8) - 3.4
    return (-4.4 * side, y[0], 4.0 * side, y[1]), (x, walks * start, x, -3.4 * walks, x, 3.4 * walks)


def _stroll_crossflow(u):
    walks = _sign(u[1])
    x = -3.2 + 6.2 * u[0]
    return x, _centred(u[2], 3.4), x, -3.4 * walks, x, 3.4 * walks


def _rectangle(half_x, half_y):
    return ((-half_x, -half_y), (half_x, -half_y), (half_x, half_y), (-half_x, half_y))


def _door(half_length, half_width, half_door, half_wall):
    """Two rooms and the door between them, one chain around both."""
    a, b, c, d = half_length, half_width, half_door, half_wall
    return (
        (-a, -b), (-d, -b), (-d, -c), (d, -c), (d, -b), (a, -b), (a, b), (d, b), (d, c), (-d, c), (-d, b), (-a, b),
    )  # fmt: skip


def _corner(length, half_width):
    """Two arms at right angles: one to the left, one upward, their centre lines through the origin."""
    a, b = length, half_width
    return ((-a, -b), (b, -b), (b, a), (-b, a), (-b, b), (-a, b))


def _cross(half_length, half_width):
    a, b = half_width, half_length
    return ((-b, -a), (-a, -a), (-a, -b), (a, -b), (a, -a), (b, -a), (b, a), (a, a), (a, b), (-a, b), (-a, a), (-b, a))


# People who are faster than the robot, wider, patient when they wait, and who pick a side late if nothing was agreed.
_HURRIED = {
    "preferred_speed": 1.2, "max_speed": 1.2, "body_radius": 0.2, "p_decides_late": 1.0, "obey_steps": 40.0,
    "neighbor_distance": 1.5, "passing_clearance": 0.3, "message_exceptions": 0.5,
}  # fmt: skip


def _hard(name, chain, floors, meet, crowd=(1, 1), **others):
    """A scene of the hard suite, and its twin in which nobody is given."""
    scene = Scene(name, (chain,), floors, 16, meet, crowd=crowd, params=_HURRIED, **others)
    return scene, dataclasses.replace(scene, name=f"{name}-laser", sight="none")


_HARD = (
    *_hard("narrow", _rectangle(6.0, 0.9), ((-6.0, -0.9, 6.0, 0.9),), _meet_narrow),
    *_hard("doorway", _door(6.0, 1.2, 0.45, 0.1), ((-6.0, -1.2, 6.0, 1.2),), _meet_doorway, passage=(0.0, 0.0)),
    *_hard(
        "corner", _corner(6.0, 0.9), ((-6.0, -0.9, 0.9, 0.9), (-0.9, -0.9, 0.9, 6.0)), _meet_corner, sight="line",
        passage=(0.0, 0.0),
    ),
    *_hard(
        "crossflow", _rectangle(5.0, 4.0), ((-5.0, -4.0, 5.0, 4.0),), _meet_crossflow, crowd=(4, 8),
        stroll=_stroll_crossflow,
    ),
)  # fmt: skip

SCENES = {
    scene.name: scene
    for scene in (
        Scene("square", (_rectangle(5.0, 5.0),), ((-5.0, -5.0, 5.0, 5.0),), 64, _meet_square),
        Scene("hallway", (_rectangle(5.0, 1.6),), ((-5.0, -1.6, 5.0, 1.6),), 16, _meet_hallway),
        Scene("crosswalk", (_cross(5.0, 1.3),), ((-5.0, -1.3, 5.0, 1.3), (-1.3, -5.0, 1.3, 5.0)), 24, _meet_crosswalk),
        *_HARD,
    )
}
BUILT_IN = frozenset(SCENES)
SUITES = {
    "parity": ("square", "hallway", "crosswalk"),
    "hard": tuple(scene.name for scene in _HARD if scene.sight != "none"),
    "hard-laser": tuple(scene.name for scene in _HARD if scene.sight == "none"),
}


def register_scene(scene: Scene) -> Scene:
    """Make a scene known by its name, for ``WorldConfig.scenes``. ValueError: another one has that name."""
    if SCENES.get(scene.name, scene) is not scene:
        raise ValueError(f"scene {scene.name!r} is registered twice: give the second one a name of its own")
    SCENES[scene.name] = scene
    return scene


def default_params(names: Sequence[str]) -> Params:
    """`Params` of the people in the scenes of these names; ValueError where they are not the same people."""
    return params_of(choose(names))


def params_of(scenes: Sequence[Scene]) -> Params:
    """`Params` of the people in these scenes; ValueError where they are not the same people."""
    first, *others = scenes
    for other in others:
        if dict(other.params) != dict(first.params):
            raise ValueError(
                f"world.scenes mixes {first.name} and {other.name}, whose people differ (speed, size, habits): "
                f"choose scenes of one suite ({'; '.join(' '.join(suite) for suite in SUITES.values())})"
            )
    return Params(**first.params)


def choose(names: Sequence[str], own_scenes: Iterable[Scene] = ()) -> tuple[Scene, ...]:
    """The scenes of these names, of `SCENES` or of ``own_scenes``; ValueError: unknown, or two scenes of one name."""
    known = dict(SCENES)
    for scene in own_scenes:
        if known.get(scene.name, scene) is not scene:
            raise ValueError(f"own scene {scene.name!r} has the name of another scene: give it a name of its own")
        known[scene.name] = scene
    for name in names:
        if name not in known:
            raise ValueError(f"scene {name!r} is unknown: choose from {', '.join(known)}")
    return tuple(known[name] for name in names)
