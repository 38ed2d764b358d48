"""The border of free space as closed chains of walls, simplified to a given tolerance."""

from collections.abc import Sequence

import cv2
import numpy as np

_BLOCK = 256


def simple_border(free: np.ndarray) -> np.ndarray:
    """``free`` `[rows, columns]` bool without the cells at which it touches itself only at a corner.

    The border of the remaining cells are closed curves that neither touch nor cross each other.
    """
    free = free.copy()
    while True:
        a, b, c, d = free[:-1, :-1], free[:-1, 1:], free[1:, :-1], free[1:, 1:]
        falling, rising = a & d & ~b & ~c, b & c & ~a & ~d
        if not (falling.any() or rising.any()):
            return free
        a[falling] = False
        b[rising] = False


def wall_chains(free: np.ndarray, tolerance: float) -> list[np.ndarray]:
    """Closed chains `[V, 2]` of (column, row) along the border of ``free``, a mask from `simple_border`.

    Free space lies to the left of every edge; nothing beyond the mask is free. ``tolerance``, in cells, bounds how
    far the chains leave the cells' own border; it is halved for chains that would otherwise vanish (a pillar of one
    cell) or meet a chain.
    """
    borders = _borders(free)
    tolerances = np.full(len(borders), float(tolerance))
    while True:
        chains = [_simplify(border, allowed) for border, allowed in zip(borders, tolerances, strict=True)]
        spoilt = _meeting(chains) | {i for i, chain in enumerate(chains) if len(chain) < 3}
        if not spoilt:
            return chains
        for i in spoilt:
            # At 0 only what lies in a straight line is left out: the borders themselves never meet.
            tolerances[i] = 0.5 * tolerances[i] if tolerances[i] > 0.5 else 0.0


def edges(chains: Sequence[np.ndarray]) -> np.ndarray:
    """`[E, 4]` ax, ay, bx, by of the walls of closed chains, in their order."""
    return np.concatenate([np.concatenate([chain, np.roll(chain, -1, axis=0)], axis=1) for chain in chains])


def side(a: np.ndarray, b: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Cross product of b - a and ``points`` - a, `[..., 2]` each: positive to the left of the way from a to b."""
    return (b[..., 0] - a[..., 0]) * (points[..., 1] - a[..., 1]) - (b[..., 1] - a[..., 1]) * (
        points[..., 0] - a[..., 0]
    )


def distance(points: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Distances from ``points`` to the segments a-b, `[..., 2]` each."""
    e = b - a
    t = np.clip(np.sum((points - a) * e, axis=-1) / np.maximum(np.sum(e * e, axis=-1), 1e-12), 0.0, 1.0)
    return np.hypot(*np.moveaxis(points - a - t[..., None] * e, -1, 0))


def _borders(free: np.ndarray) -> list[np.ndarray]:
    """Chains `[V, 2]` of cell corners along the border of ``free``, free space to the left."""
    doubled = np.kron(np.pad(free, 1), np.ones((2, 2), bool)).astype(np.uint8)
    contours, hierarchy = cv2.findContours(doubled, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    borders = []
    for contour, (_, _, _, parent) in zip(contours, hierarchy[0], strict=True):
        # OpenCV joins the centres of pixels. Those of a cell's four quarters round to its own corners, and a quarter
        # on the border to a corner on the border.
        points = np.round((contour[:, 0] + 0.5) / 2.0).astype(np.int32) - 1
        points = points[np.any(points != np.roll(points, 1, axis=0), axis=1)]
        is_hole = parent >= 0
        borders.append(points[::-1] if (_area(points) < 0) != is_hole else points)
    return borders


def _area(points: np.ndarray) -> float:
    x, y = points.astype(np.float64).T
    return 0.5 * np.sum(x * np.roll(y, -1) - y * np.roll(x, -1))


def _simplify(border: np.ndarray, tolerance: float) -> np.ndarray:
    return cv2.approxPolyDP(border[:, None], tolerance, True)[:, 0].astype(np.float64)


def _meeting(chains: Sequence[np.ndarray]) -> set[int]:
    """Indices of the chains with an edge that touches or crosses another edge than its neighbours."""
    lines = edges(chains)
    sizes = [len(chain) for chain in chains]
    owner = np.repeat(np.arange(len(chains)), sizes)
    starts = np.cumsum([0, *sizes[:-1]])
    following = np.concatenate([np.roll(np.arange(size), -1) + at for size, at in zip(sizes, starts, strict=True)])
    low, high = np.minimum(lines[:, :2], lines[:, 2:]), np.maximum(lines[:, :2], lines[:, 2:])
    found = set()
    for start in range(0, len(lines), _BLOCK):
        rows = np.arange(start, min(start + _BLOCK, len(lines)))
        near = np.all((low[rows, None] <= high) & (high[rows, None] >= low), axis=2)
        near &= rows[:, None] < np.arange(len(lines))
        i, j = np.nonzero(near)
        i = rows[i]
        apart = (following[i] != j) & (following[j] != i)
        i, j = i[apart], j[apart]
        crossing = _opposite(lines[i], lines[j]) & _opposite(lines[j], lines[i])
        found |= set(owner[i[crossing]]) | set(owner[j[crossing]])
    return found


def _opposite(lines: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Whether the ends of ``others`` are not both strictly on the same side of ``lines``, `[M, 4]` each."""
    a, b = lines[:, :2], lines[:, 2:]
    return side(a, b, others[:, :2]) * side(a, b, others[:, 2:]) <= 0
