"""Free spots for a few words on a drawing."""

import itertools
from collections.abc import Sequence
from typing import Any

import numpy as np

_STEP = 5.0  # points between the spots that are tried
_LEADER = np.linspace(0.1, 1.0, 12)[:, None]


def free_spot(
    anchor: np.ndarray,
    half: np.ndarray,
    frame: Sequence[float],
    taken: Sequence[Sequence[float]],
    words: Sequence[Sequence[float]],
    ink: np.ndarray,
    unit: float,
) -> np.ndarray:
    """Centre `[2]` of the free spot nearest to ``anchor`` for a label, or of the least crowded one. All in pixels.

    half:  `[2]` half of the label's size.
    frame: (x0, y0, x1, y1) that the label stays within.
    taken: boxes `[n, 4]` that it must not touch.
    words: the boxes that hold words, which the leader from anchor to label should not cross.
    ink:   points `[m, 2]` of lines that it should not cover.
    unit:  pixels a point.
    """
    low, high = np.array(frame[:2]) + half + unit, np.array(frame[2:]) - half - unit
    steps = [np.arange(low[i], max(high[i], low[i] + 1.0), _STEP * unit) for i in (0, 1)]
    centres = np.stack(np.meshgrid(*steps), axis=-1).reshape(-1, 2)
    overlaps = _inside(centres[:, None], np.array(taken).reshape(-1, 4), half).sum(axis=1)
    covered = (np.abs(centres[:, None] - ink) < half + unit).all(axis=-1).sum(axis=1)
    leaders = anchor + _LEADER * (centres[:, None] - anchor)
    crossed = _inside(leaders[:, :, None], np.array(words).reshape(-1, 4), unit).any(axis=1).sum(axis=1)
    away = np.hypot(*np.maximum(np.abs(centres - anchor) - half, 0.0).T) / unit
    return centres[np.argmin(away + 20.0 * covered + 500.0 * crossed + 1e6 * overlaps)]


def along(points: np.ndarray, count: int = 12) -> np.ndarray:
    """Points `[m, 2]` on the line through ``points`` `[n, 2]`, ``count`` to a piece."""
    points = np.asarray(points, float)
    share = np.linspace(0.0, 1.0, count, endpoint=False)[:, None]
    return np.concatenate([*(a + share * (b - a) for a, b in itertools.pairwise(points)), points[-1:]])


def _inside(points: np.ndarray, boxes: np.ndarray, margin: np.ndarray | float) -> Any:
    """Whether ``points`` lie in ``boxes`` widened by ``margin``."""
    middle, half = (boxes[:, :2] + boxes[:, 2:]) / 2, (boxes[:, 2:] - boxes[:, :2]) / 2
    return np.all(np.abs(points - middle) < half + margin, axis=-1)
