"""Paths through the cells in which a body may stand: straight lines, and shortest paths around obstacles.

A mask `[rows, columns]` marks these cells; points are (column, row) in cells from the outer corner of cell (0, 0).
"""

import itertools
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from scipy.sparse import csr_array

_STEP = 0.5  # of a walk along a line, in cells
# Steps to eight neighbours make a path at most so much longer than the line it follows (at 22.5 degrees).
_OCTILE = 1.0824
_GOALS = 4  # drawn for one start


def reach(mask: np.ndarray, points: np.ndarray, directions: np.ndarray, limit: np.ndarray) -> np.ndarray:
    """Free distances `[N]`, at most ``limit`` `[N]`, from ``points`` `[N, 2]` straight along unit vectors `[N, 2]`."""
    padded = np.pad(mask, 1)  # a step from a cell of the mask ends in the grid or in this frame of one cell
    distance = np.zeros(len(points))
    walking = np.arange(len(points))
    for step in range(1, int(np.max(limit, initial=0.0) / _STEP) + 1):
        walking = walking[step * _STEP <= limit[walking]]
        column, row = np.floor(points[walking] + step * _STEP * directions[walking]).astype(int).T + 1
        walking = walking[padded[row, column]]
        if not walking.size:
            break
        distance[walking] = step * _STEP
    return distance


def sample_paths(
    rng: np.random.Generator, mask: np.ndarray, count: int, distances: Sequence[float], detour: float
) -> list[np.ndarray]:
    """At most ``count`` paths, arrays of points `[C, 2]`, between random places that a path connects.

    distances: least and greatest straight distance from start to goal; detour: longest path, in straight distances.
    """
    from scipy.sparse.csgraph import dijkstra  # a third of a second, which commands without maps needn't wait for

    graph, centres = _graph(mask)
    near, far = distances
    drawn = []
    # Some starts have no goal: the middle of a small room. Some paths turn out too long: a quarter more are drawn.
    for _ in range(2 * count // _GOALS + 32):
        source = rng.integers(len(centres))
        lengths, before = dijkstra(graph, indices=source, limit=_OCTILE * detour * far, return_predecessors=True)
        straight = np.hypot(*(centres - centres[source]).T)
        goals = np.flatnonzero((straight >= near) & (straight <= far) & (lengths <= _OCTILE * detour * straight))
        for end in rng.choice(goals, _GOALS) if goals.size else ():
            cells = centres[_cells(before, end)[:: rng.choice((-1, 1))]]
            drawn.append(np.concatenate([cells[:1], cells, cells[-1:]]))
            drawn[-1][[0, -1]] += rng.uniform(-0.5, 0.5, (2, 2))
        if len(drawn) >= 1.25 * count:
            break
    paths = _pulled_straight(mask, drawn) if drawn else []
    gaps = [np.hypot(*(path[-1] - path[0])) for path in paths]
    fits = [near <= gap <= far and length(path) <= detour * gap for path, gap in zip(paths, gaps, strict=True)]
    return list(itertools.compress(paths, fits))[:count]


def length(path: np.ndarray) -> float:
    """Length of a path of points `[C, 2]`."""
    return float(np.hypot(*np.diff(path, axis=0).T).sum())


def along(path: np.ndarray, distance: float) -> tuple[np.ndarray, np.ndarray]:
    """The point of a path at ``distance`` from its start, and the path's direction there, a unit vector."""
    pieces = np.diff(path, axis=0)
    lengths = np.hypot(*pieces.T)
    ends = np.cumsum(lengths)
    i = min(int(np.searchsorted(ends, distance)), len(pieces) - 1)
    direction = pieces[i] / max(lengths[i], 1e-9)
    return path[i] + (distance - ends[i] + lengths[i]) * direction, direction


def _graph(mask: np.ndarray) -> "tuple[csr_array, np.ndarray]":
    """Steps between the cells of a mask and their eight neighbours, as a sparse matrix, and the cells' centres."""
    from scipy.sparse import csr_array

    rows, columns = np.nonzero(mask)
    index = np.full(np.add(mask.shape, 2), -1)
    index[1:-1, 1:-1][mask] = np.arange(len(rows))
    starts, ends, lengths = [], [], []
    for dx, dy in ((1, 0), (-1, 1), (0, 1), (1, 1)):
        beside = index[rows + 1 + dy, columns + 1 + dx]
        start = np.flatnonzero(beside >= 0)
        starts += [start, beside[start]]
        ends += [beside[start], start]
        lengths.append(np.full(2 * start.size, np.hypot(dx, dy)))
    pairs = np.concatenate(starts), np.concatenate(ends)
    graph = csr_array((np.concatenate(lengths), pairs), shape=(len(rows), len(rows)))
    return graph, np.stack([columns, rows], axis=1) + 0.5


def _cells(before: np.ndarray, end: int) -> list[int]:
    """The cells of a shortest path, from its source to ``end``."""
    cells = []
    while end >= 0:
        cells.append(end)
        end = before[end]
    return cells[::-1]


def _pulled_straight(mask: np.ndarray, paths: list[np.ndarray]) -> list[np.ndarray]:
    """``paths`` without the points between which the straight line is free: they turn only at what blocks them."""
    points = np.concatenate(paths)
    last = np.cumsum([len(path) for path in paths]) - 1
    at = np.concatenate([[0], last[:-1] + 1])
    kept, step = [at.copy()], last - at
    while True:
        going = np.flatnonzero(at < last)
        if not going.size:
            kept = np.sort(np.concatenate(kept))
            return np.split(points[kept], np.searchsorted(kept, last)[:-1] + 1)
        a, b = points[at[going]], points[at[going] + step[going]]
        gap = np.hypot(*(b - a).T)
        seen = reach(mask, a, (b - a) / np.maximum(gap, 1e-9)[:, None], gap) > gap - _STEP
        seen |= step[going] == 1
        arrived = going[seen]
        at[arrived] += step[arrived]
        kept.append(at[arrived])
        step[arrived] = (last - at)[arrived]
        step[going[~seen]] //= 2
