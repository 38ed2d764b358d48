"""Lists of the walls that are visible from each square of a map, so that a beam tests few of them.

A wall is left out of a square's list only if no beam from free space in the square can hit it first, so ranges to the
listed walls are those to all of them.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from ..world.types import WallCells
from .polygons import distance, edges, side

_LONGEST = 32  # walls of one chain that together may hide something
_DEPTHS = (0.0, 0.05, 0.1, 0.2, 0.4)  # m: how far such a piece of chain may leave its chord
_HIDING = 128  # pieces tried for one square: those that look largest from it
_STRICT = 1e-4  # m^2 and m: what is hidden by less counts as seen


def visible_walls(chains: Sequence[np.ndarray], size: float, margin: float, scan_range: float) -> WallCells:
    """`WallCells` of closed ``chains`` that don't meet each other, free space to their left.

    size: side of a cell, m; margin: width around a cell in which its list is valid as well, m; scan_range: range of the
    laser, m.
    """
    walls = edges(chains)
    pieces = _pieces(chains)
    low = walls.reshape(-1, 2).min(axis=0)
    columns, rows = np.ceil((walls.reshape(-1, 2).max(axis=0) - low) / size - 1e-4).astype(int)
    half = 0.5 * size
    lists = []
    for row in range(rows):
        for column in range(columns):
            centre = low + size * (np.array([column, row]) + 0.5)
            gaps = distance(centre, walls[:, :2], walls[:, 2:])
            # No free space, no beam.
            if gaps.min() > np.sqrt(2) * half and not _inside(centre, walls):
                lists.append(np.zeros(0, int))
                continue
            reach = half + margin
            corners = centre + reach * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
            near = np.flatnonzero(gaps <= scan_range + np.sqrt(2) * reach)
            near = near[np.any(_left(walls[near], corners) > -_STRICT, axis=1)]
            lists.append(near[~_hidden(corners, walls[near], *pieces)])
    table: Any = np.full((rows * columns, max(map(len, lists))), -1, np.int32)
    for cell, seen in zip(table, lists, strict=True):
        cell[: len(seen)] = seen
    return WallCells(
        walls=table.reshape(rows, columns, -1), x=float(low[0]), y=float(low[1]), size=float(size),
        scan_range=float(scan_range), margin=float(margin),
    )  # fmt: skip


def _pieces(chains: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pieces of chain: their chords `[P, 4]` and how far they go to the left of them, least (<= 0) and most (>= 0), m.

    Every wall is a piece by itself. A beam that crosses a chord, from beyond one of these depths to beyond the other,
    has crossed the piece: chord and piece are a closed curve, both ends of the beam are outside it, and the beam can't
    come back through the chord.
    """
    chords, depths = [], []
    for chain in map(np.asarray, chains):
        n = len(chain)
        found = []
        for count in range(1, min(_LONGEST, n - 1) + 1):
            ends = np.concatenate([chain, np.roll(chain, -count, axis=0)], axis=1)
            length = np.hypot(*(ends[:, 2:] - ends[:, :2]).T)
            between = np.stack([np.roll(chain, -i, axis=0) for i in range(count + 1)], axis=1)
            left = _left(ends, between) / np.maximum(length, 1e-9)[:, None]
            found.append(np.column_stack([ends, left.min(axis=1), left.max(axis=1), length]))
        found = np.stack(found)  # [counts, n, 7]
        for depth in _DEPTHS:
            # From each vertex on the longest chord whose piece is flat enough; walls by themselves always are.
            length = np.where(found[..., 5] - found[..., 4] <= depth + 1e-9, found[..., 6], -1.0)
            best = found[np.argmax(length, axis=0), np.arange(n)]
            chords.append(best[:, :4])
            depths.append(best[:, 4:6])
    chords, unique = np.unique(np.concatenate(chords), axis=0, return_index=True)
    return chords, *np.concatenate(depths)[unique].T


def _hidden(
    corners: np.ndarray, walls: np.ndarray, chords: np.ndarray, least: np.ndarray, most: np.ndarray
) -> np.ndarray:
    """`[W]` whether a wall of ``walls`` `[W, 4]` is behind a piece of chain for every point between ``corners``.

    If all eight lines from the corners to a wall's ends cross a chord, so do all lines between: where such a line
    passes an end of the chord is linear in both of its own ends.
    """
    lengths = np.hypot(*(chords[:, 2:] - chords[:, :2]).T)
    left = _left(chords, corners) / lengths[:, None]
    in_front, behind = left.min(axis=1) > most + _STRICT, left.max(axis=1) < least - _STRICT
    # Turned round where needed, so that the corners are to the left of the chord.
    turned = np.where(behind[:, None], chords[:, [2, 3, 0, 1]], chords)
    depth = np.where(behind, -most, least)
    looks = _looks(corners, turned)
    chosen = np.flatnonzero(in_front | behind)
    chosen = chosen[np.argsort(-looks[chosen], kind="stable")[:_HIDING]]
    turned, depth, lengths = turned[chosen], depth[chosen], lengths[chosen]

    ends = walls.reshape(-1, 2)
    beyond = _left(turned, ends).T / lengths < depth - _STRICT  # [2 W, P]
    to_end = ends[None] - corners[:, None]  # [4, 2 W, 2]

    def passes(points: np.ndarray) -> np.ndarray:
        to_point = points[None] - corners[:, None]  # [4, P, 2]
        return to_end[..., None, 0] * to_point[:, None, :, 1] - to_end[..., None, 1] * to_point[:, None, :, 0]

    crossed = np.all((passes(turned[:, :2]) < -_STRICT) & (passes(turned[:, 2:]) > _STRICT), axis=0)
    return np.any((crossed & beyond).reshape(len(walls), 2, len(chosen)).all(axis=1), axis=1)


def _looks(corners: np.ndarray, chords: np.ndarray) -> np.ndarray:
    """The smallest angle `[P]` under which a chord is seen from the corners `[4, 2]`."""
    a, b = (chords[:, None, i : i + 2] - corners for i in (0, 2))
    cross = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
    return np.abs(np.arctan2(cross, np.sum(a * b, axis=-1))).min(axis=1)


def _left(lines: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Cross products `[N, M]` of ``lines`` `[N, 4]` and ``points``, `[M, 2]` or `[N, M, 2]`, positive to the left."""
    return side(lines[:, None, :2], lines[:, None, 2:], points)


def _inside(point: np.ndarray, walls: np.ndarray) -> bool:
    """Whether a point is in free space: an odd number of walls is to its right."""
    ax, ay, bx, by = walls.T
    spans = (ay > point[1]) != (by > point[1])
    at = ax[spans] + (point[1] - ay[spans]) / (by - ay)[spans] * (bx - ax)[spans]
    return np.count_nonzero(at > point[0]) % 2 == 1
