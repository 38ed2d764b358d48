"""Starts and goals of robots on a map and lines of pedestrians across their paths, sampled when a map is loaded."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import cv2
import jax.numpy as jnp
import numpy as np

from ..world.placement import FromTable
from ..world.scenes import straight
from .occupancy import OccupancyMap
from .paths import along, length, reach, sample_paths
from .polygons import distance, side

_MEETING = (0.35, 0.7)  # part of the robot's path after which the pedestrian is met
_OWN_HEADING = 0.84  # least angle between both headings there, as in scene square
_MISS = 0.25  # m between the robot's path and the pedestrian's line there: without giving way they touch
_ON_TIME = 0.9  # room behind the meeting point, in lengths of the robot's way there: enough to arrive together
_WALK_ON = (1.2, 3.0)  # m past the meeting point to the pedestrian's goal: at least and at most
_PLACES = 8  # along a path at which it may be crossed
_CROSSINGS = 4  # of one path, at most
_DRAWS = 64  # of ``count`` lines each, before fewer are enough
_STROLL = (2.0, 8.0)  # m


class Meetings(NamedTuple):
    """N ways of a robot, each crossed by a pedestrian's straight line. Every field is float32 `[N]`.

    x, y:           the robot's start.
    goal_x, goal_y: the robot's goal.
    meet_x, meet_y: the meeting point, on the pedestrian's line and within 0.25 m of the robot's path.
    distance:       length of the robot's path to the meeting point.
    ux, uy:         the pedestrian's direction there.
    behind, ahead:  how far the pedestrian's line is free before and after that point.
    """

    x: np.ndarray
    y: np.ndarray
    goal_x: np.ndarray
    goal_y: np.ndarray
    meet_x: np.ndarray
    meet_y: np.ndarray
    distance: np.ndarray
    ux: np.ndarray
    uy: np.ndarray
    behind: np.ndarray
    ahead: np.ndarray


def meet(meetings: Meetings) -> FromTable:
    """``Scene.meet`` of these meetings; maps share its program."""
    return FromTable(_meet, meetings)


def _meet(at: Any, u: Any, robot_speed: Any, pedestrian_speed: Any) -> tuple[tuple[Any, Any, Any, Any], Any]:
    """((robot x, y, goal x, goal y), the pedestrian's route) of the meetings ``at``, some of `Meetings`.

    The pedestrian starts so that it reaches the meeting point together with the robot, give or take 0.4 m, or as far
    back as its line allows. u: uniform numbers in [0, 1), a sequence of at least two arrays.
    """
    behind = pedestrian_speed * at.distance / robot_speed + 0.8 * (u[1] - 0.5)
    behind = jnp.clip(behind, 0.0, at.behind)
    ahead = jnp.minimum(at.ahead, _WALK_ON[1])
    x, y = at.meet_x - behind * at.ux, at.meet_y - behind * at.uy
    goal_x, goal_y = at.meet_x + ahead * at.ux, at.meet_y + ahead * at.uy
    return (at.x, at.y, at.goal_x, at.goal_y), straight(x, y, goal_x, goal_y)


def stroll(lines: np.ndarray) -> FromTable:
    """``Scene.stroll`` along ``lines`` `[S, 4]`, from `sample_strolls`; maps share its program."""
    return FromTable(_stroll, lines)


def _stroll(line: Any, u: Any) -> Any:
    del u
    return straight(*jnp.moveaxis(line, -1, 0))


def standing_room(free: np.ndarray, clearance: float) -> np.ndarray:
    """The cells of ``free`` whose centre is at least ``clearance`` cells from the border of free space, as a mask."""
    # OpenCV measures between centres; the border is half a cell before the centre of what isn't free.
    to_border = cv2.distanceTransform(np.pad(free, 1).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    return to_border[1:-1, 1:-1] >= clearance + 0.5


def clear_of(walls: np.ndarray, lines: np.ndarray, clearance: float) -> np.ndarray:
    """`[N]` whether a line of ``lines`` `[N, 4]` keeps ``clearance`` from all ``walls`` `[E, 4]` and crosses none."""
    clear = np.ones(len(lines), bool)
    for rows in np.array_split(np.arange(len(lines)), len(lines) * len(walls) // 1_000_000 + 1):
        a, b = lines[rows, None, :2], lines[rows, None, 2:]
        c, d = walls[None, :, :2], walls[None, :, 2:]
        gap = np.minimum.reduce([distance(a, c, d), distance(b, c, d), distance(c, a, b), distance(d, a, b)])
        crosses = (side(a, b, c) * side(a, b, d) < 0) & (side(c, d, a) * side(c, d, b) < 0)
        clear[rows] = np.all((gap >= clearance) & ~crosses, axis=1)
    return clear


def sample_lines(
    rng: np.random.Generator, building: OccupancyMap, room: np.ndarray, walls: np.ndarray, count: int, clearance: float
) -> np.ndarray:
    """`[<= count, 4]` x, y, end x, end y: straight lines that keep ``clearance``, m, as long as room allows.

    building: `OccupancyMap`; room: where a body's centre may be, from `standing_room`; walls: `[E, 4]`. The lines reach
    up to 8 m to both sides of a random place and are at least 2 m long.
    """
    scale = building.resolution
    rows, columns = np.nonzero(room)
    found = []
    for _ in range(_DRAWS):
        drawn = rng.integers(len(rows), size=count)
        points = np.stack([columns, rows], axis=1)[drawn] + rng.random((count, 2))
        heading = rng.uniform(-np.pi, np.pi, count)
        unit = np.stack([np.cos(heading), np.sin(heading)], axis=1)
        # A cell less than one gets: the ends are to be as clear as the line.
        behind, ahead = (reach(room, points, way, np.full(count, _STROLL[1] / scale)) - 1.0 for way in (-unit, unit))
        long = behind + ahead >= _STROLL[0] / scale
        start, end = (building.to_world(points + part[:, None] * unit)[long] for part in (-behind, ahead))
        lines = np.concatenate([start, end], axis=1)
        found.append(lines[clear_of(walls, lines, clearance)])
        if sum(map(len, found)) >= count:
            break
    return np.concatenate(found)[:count]


def sample_strolls(rng: np.random.Generator, lines: np.ndarray) -> np.ndarray:
    """`[S, 4]` float32 x, y, goal x, goal y: a part of 2 to 8 m of each of ``lines`` `[S, 4]`."""
    starts, steps = lines[:, :2], lines[:, 2:] - lines[:, :2]
    lengths = np.hypot(*steps.T)
    part = rng.uniform(_STROLL[0], np.clip(lengths, *_STROLL)) / lengths
    first = rng.random(len(lines)) * (1.0 - part)
    return np.concatenate([starts + f[:, None] * steps for f in (first, first + part)], axis=1).astype(np.float32)


def sample_meetings(
    rng: np.random.Generator, building: OccupancyMap, room: np.ndarray, walls: np.ndarray, lines: np.ndarray,
    count: int, distances: Sequence[float], detour: float, clearance: float,
) -> Meetings:  # fmt: skip
    """At most ``count`` `Meetings` on drawn paths with ``lines``, from `sample_lines`.

    distances: least and greatest distance from start to goal, m; detour: longest path, in straight distances;
    clearance: of starts and goals, m. ValueError: no goal can be reached, or no line crosses a path.
    """
    scale = building.resolution
    least, greatest = distances
    paths = sample_paths(rng, room, count // _CROSSINGS + 1, (least / scale, greatest / scale), detour)
    paths = [building.to_world(path) for path in paths]
    ends = np.array([np.tile(path[[0, -1]], 2) for path in paths]).reshape(-1, 4)
    clear = np.all(clear_of(walls, ends, clearance).reshape(-1, 2), axis=1)
    found = [_crossings(rng, paths[i], lines) for i in np.flatnonzero(clear)]
    if not found:
        raise ValueError(
            f"no goal {least} to {greatest} m from a start can be reached on a path of at most {detour} times that "
            f"distance with {clearance} m of clearance: check the resolution, or give other distances or more detour"
        )
    rows = rng.permutation(np.concatenate(found))[:count]
    if not len(rows):
        raise ValueError(
            f"no pedestrian finds a straight line with {clearance} m of clearance across a robot's path of {least} to "
            f"{greatest} m: check the resolution, or give smaller distances"
        )
    return Meetings(*rows.astype(np.float32).T.copy())


def _crossings(rng: np.random.Generator, path: np.ndarray, lines: np.ndarray) -> np.ndarray:
    """Rows `[<= 4, 11]` in the order of `Meetings`: some ``lines``, in either direction, that meet a path `[C, 2]`."""
    before = rng.uniform(*_MEETING, _PLACES) * length(path)
    place, way = np.array([along(path, d) for d in before]).transpose(1, 2, 0)[..., None]
    sx, sy, ex, ey = np.where(rng.random(len(lines)) < 0.5, lines.T, lines.T[[2, 3, 0, 1]])
    lengths = np.hypot(ex - sx, ey - sy)
    ux, uy = (ex - sx) / lengths, (ey - sy) / lengths
    px, py = place[0] - sx, place[1] - sy
    behind = px * ux + py * uy
    ahead = lengths - behind
    fits = (np.abs(ux * py - uy * px) <= _MISS) & (way[0] * ux + way[1] * uy <= np.cos(_OWN_HEADING))
    fits &= (behind >= _ON_TIME * before[:, None]) & (ahead >= _WALK_ON[0])
    at, line = np.nonzero(fits)
    some = rng.permutation(len(at))[:_CROSSINGS]
    at, line = at[some], line[some]
    behind, ahead, ux, uy = behind[at, line], ahead[at, line], ux[line], uy[line]
    ends = np.tile(path[[0, -1]].ravel(), (len(at), 1))
    return np.column_stack([ends, sx[line] + behind * ux, sy[line] + behind * uy, before[at], ux, uy, behind, ahead])
