"""Your own building as a scene: from a ROS map_server map to walls, starts, goals and who meets whom."""

import math
import pathlib
from typing import Any

import cv2
import numpy as np

from ..world.config import MAX_PEDESTRIANS
from ..world.params import CLEARANCE
from ..world.scenes import Scene
from . import occupancy, placements, polygons, visibility

__all__ = ["load"]

MARGIN = 0.3  # m: more than `body_reach` of the usual parameters, 0.29
_FLOOR = 1.0  # m^2 of standing room for one pedestrian
_CELLS = 40_000  # listing their visible walls takes a minute


def load(
    path: str | pathlib.Path, *, tolerance: float | None = None, clearance: float = CLEARANCE,
    distances: tuple[float, float] = (4.0, 8.0), detour: float = 1.3, meetings: int = 4096, strolls: int = 1024,
    cell: float = 1.0, scan_range: float = 12.0, margin: float = MARGIN, seed: int = 0,
) -> Scene:  # fmt: skip
    """The scene that a ROS map_server map describes: ``path`` names its yaml file.

    tolerance:  how far walls may leave the borders of the image's cells, m; by default sqrt(2) cells: a slanted wall
                is a staircase in the image, and its corners lie in a strip of at most that width.
    clearance:  from starts, goals and pedestrians' lines to walls, m.
    distances:  least and greatest straight distance from the robot's start to its goal, m.
    detour:     longest path from start to goal, in straight distances: the robot sees its goal, not the way.
    meetings:   number of meetings of robot and pedestrian to draw.
    strolls:    number of strolls of the other pedestrians to draw.
    cell:       side of the cells for which visible walls are listed, m.
    scan_range: range of the laser, m.
    margin:     how far the robot's body may get from the start of half a step, m: 0.5 max_v dt + robot_radius.
    seed:       seed of the drawing.

    ValueError: names file, field and remedy, also where there is no free space or no goal can be reached.
    """
    _check(tolerance=tolerance, clearance=clearance, distances=distances, detour=detour, meetings=meetings,
           strolls=strolls, cell=cell, scan_range=scan_range, margin=margin, seed=seed)  # fmt: skip
    building = occupancy.read(path)
    scale = building.resolution
    try:
        free = _rooms(polygons.simple_border(building.cells == occupancy.FREE), scale, clearance, distances[0])
        _check_size(free, scale, cell)
        drawn = polygons.wall_chains(free, np.sqrt(2) if tolerance is None else tolerance / scale)
        # Single precision, as the world has them: what is seen has to be right for the very same walls.
        chains = [building.to_world(chain).astype(np.float32).astype(np.float64) for chain in drawn]
        walls = polygons.edges(chains)
        rng = np.random.default_rng(seed)
        room = placements.standing_room(free, clearance / scale)
        lines = placements.sample_lines(rng, building, room, walls, max(meetings, strolls), clearance)
        found = placements.sample_meetings(rng, building, room, walls, lines, meetings, distances, detour, clearance)
    except ValueError as error:
        raise ValueError(f"map {path}: {error}") from None
    corners = np.concatenate(chains)
    (low_x, low_y), (high_x, high_y) = corners.min(axis=0).tolist(), corners.max(axis=0).tolist()
    return Scene(
        name=str(path),
        chains=tuple(tuple((float(x), float(y)) for x, y in chain) for chain in chains),
        # Starts and goals are drawn clear of walls: the floor only has to contain them.
        floors=((low_x, low_y, high_x, high_y),),
        capacity=int(np.clip(np.count_nonzero(room) * scale**2 / _FLOOR, 1, MAX_PEDESTRIANS)),
        meet=placements.meet(found),
        stroll=placements.stroll(placements.sample_strolls(rng, lines[:strolls])),
        cells=visibility.visible_walls(chains, cell, margin, scan_range),
    )


def _check(
    distances: Any, detour: Any, tolerance: Any, meetings: Any, strolls: Any, seed: Any, **positive: Any
) -> None:
    for name, value in positive.items():
        if not (_is_finite(value) and value > 0):
            raise ValueError(f"{name} is {value}: give a finite number above 0")
    for name, value, least in (("meetings", meetings, 1), ("strolls", strolls, 1), ("seed", seed, 0)):
        if not (isinstance(value, (int, np.integer)) and value >= least):
            raise ValueError(f"{name} is {value}: give a whole number of at least {least}")
    pair = isinstance(distances, (tuple, list, np.ndarray)) and len(distances) == 2 and all(map(_is_finite, distances))
    if not (pair and 0 < distances[0] < distances[1]):
        raise ValueError(f"distances is {distances}: give the least, above 0, and the greatest")
    if not (_is_finite(detour) and detour >= 1):
        raise ValueError(f"detour is {detour}: give at least 1, for no path is shorter than a straight line")
    if tolerance is not None and not (_is_finite(tolerance) and tolerance >= 0):
        raise ValueError(f"tolerance is {tolerance}: give at least 0 metres")


def _is_finite(value: Any) -> bool:
    try:
        return math.isfinite(value)
    except (TypeError, OverflowError):
        return False


def _check_size(free: np.ndarray, resolution: float, cell: float) -> None:
    rows, columns = free.shape
    height, width = (resolution * (int(np.ptp(np.flatnonzero(free.any(axis=axis)))) + 1) for axis in (1, 0))
    if not (width / cell) * (height / cell) <= _CELLS:
        raise ValueError(
            f"its floor extends over {width:.6g} x {height:.6g} m, which is more than {_CELLS:,} cells of {cell} m: "
            f"check the resolution, {resolution} m a pixel for an image of {columns} x {rows}, or give a larger cell"
        )


def _rooms(free: np.ndarray, resolution: float, clearance: float, least: float) -> np.ndarray:
    """The connected parts of ``free`` that are large enough for a start and a goal, as a mask."""
    if not free.any():
        raise ValueError("no free space: check negate, free_thresh and mode against the image")
    _, labels = cv2.connectedComponents(free.astype(np.uint8), connectivity=4)
    room = placements.standing_room(free, clearance / resolution)
    if not room.any():
        raise ValueError(f"no free space with {clearance} m of clearance: check the resolution, {resolution} m a pixel")
    large, extents = [], []
    for label in np.unique(labels[room]):
        rows, columns = np.nonzero(room & (labels == label))
        extents.append(resolution * np.hypot(np.ptp(rows) + 1, np.ptp(columns) + 1))
        if extents[-1] >= least:
            large.append(label)
    if not large:
        raise ValueError(
            f"start and goal are to be {least} m apart, but free space with {clearance} m of clearance extends over "
            f"{max(extents):.2f} m: check the resolution, {resolution} m a pixel, or give smaller distances"
        )
    return np.isin(labels, large)
