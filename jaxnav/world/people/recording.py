"""Recordings of people in the ETH and UCY formats: read from a file, and made into a scene.

Formats: Pellegrini, Ess, Schindler, van Gool, "You'll never walk alone", 2009, whose rows are frame, id, x, z, y, vx,
vz, vy (z and vz are 0); and the four columns frame, id, x, y in which ETH and UCY are passed on. Metres, 2.5 annotated
frames a second. Velocities of the format are central differences, which look one frame ahead: they are not read.
"""

import pathlib
from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from ..config import MAX_PEDESTRIANS
from ..scenes import Scene, straight

ANNOTATION_PERIOD = 0.4  # seconds between two annotated frames
RECORDING = "recording"  # the name of the scene that is made of world.recording
_MARGIN = 1.0  # from the outermost people to the walls around a recording, m
_HALF_WAY = 3.0  # from start to goal the robot drives twice as far, m
_PERIODS_APART = 2  # two places of a person further apart than this in time are two visits


class Rows(NamedTuple):
    """Annotations as they stand in a file, `[R]` each: frame, id, x, y (m)."""

    frame: np.ndarray
    id: np.ndarray
    x: np.ndarray
    y: np.ndarray


def read_table(
    path: str | pathlib.Path, columns: Sequence[int], meaning: str, formats: str = "the ETH format"
) -> np.ndarray:
    """The numbers in a text file `[rows, columns]`; ValueError names file, line and remedy."""
    try:
        lines = pathlib.Path(path).read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "it is not text"
        raise ValueError(f"{path}: can't be read ({reason}): give the path of a file in {formats}") from None
    rows, wanted = [], " or ".join(map(str, columns))
    for number, line in enumerate(lines, 1):
        words = line.split()
        if not words:
            continue
        if len(words) not in columns or (rows and len(words) != len(rows[0])):
            raise ValueError(f"{path}: line {number} has {len(words)} columns: give {wanted}, {meaning}")
        try:
            rows.append([float(word) for word in words])
        except ValueError:
            raise ValueError(f"{path}: line {number} is not all numbers: give {wanted}, {meaning}") from None
        if not np.all(np.isfinite(rows[-1])):
            raise ValueError(f"{path}: line {number} holds a number that is not finite: remove or mend that line")
    if not rows:
        raise ValueError(f"{path}: is empty: give rows of {wanted} columns, {meaning}")
    return np.array(rows)


def read_recording(path: str | pathlib.Path) -> Rows:
    """The rows of a file in the ETH or UCY format; ValueError names file, row or field, and remedy."""
    table = read_table(path, (8, 4), "frame, id, x, z, y, vx, vz, vy or frame, id, x, y")
    rows = Rows(*table[:, [0, 1, 2, 4 if table.shape[1] == 8 else 3]].T)
    for name, values in (("frame", rows.frame), ("id", rows.id)):
        wrong = (values != np.round(values)) | (values < 0)
        if np.any(wrong):
            line = int(np.argmax(wrong))
            raise ValueError(f"{path}: {name} is {values[line]:g} in row {line + 1}: give whole numbers of at least 0")
    pairs, counts = np.unique(np.stack([rows.frame, rows.id], axis=1), axis=0, return_counts=True)
    if np.any(counts > 1):
        frame, person = pairs[np.argmax(counts)]
        raise ValueError(f"{path}: id {person:.0f} stands twice in frame {frame:.0f}: keep one row of each id a frame")
    return rows


def frames_per_period(frames: np.ndarray) -> float:
    """How many frames lie between two annotated ones, mostly."""
    gaps = np.diff(np.unique(frames))
    if len(gaps) == 0:
        return 1.0
    distinct, counts = np.unique(gaps, return_counts=True)
    return float(distinct[np.argmax(counts)])


class Visit(NamedTuple):
    """One person's way through a recording: index of the first instant, and x, y (m) from then on, `[n, 2]`."""

    first: int
    places: np.ndarray


def instants(frames: np.ndarray) -> np.ndarray:
    """`[R]` index of each row's instant, `ANNOTATION_PERIOD` apart; a break of the annotation is rounded to periods."""
    distinct = np.unique(frames)
    steps = np.maximum(np.rint(np.diff(distinct) / frames_per_period(frames)), 1)
    return np.concatenate([[0], np.cumsum(steps)]).astype(int)[np.searchsorted(distinct, frames)]


def visits(rows: Rows) -> list[Visit]:
    """Everybody's visits in the order in which they begin.

    Where a person was not annotated for an instant it went straight and evenly. Who isn't annotated for more than two
    periods has left, and comes again.
    """
    index, found = instants(rows.frame), []
    for person in np.unique(rows.id):
        mine = np.flatnonzero(rows.id == person)
        mine = mine[np.argsort(index[mine])]
        for part in np.split(mine, np.flatnonzero(np.diff(index[mine]) > _PERIODS_APART) + 1):
            at = np.arange(int(index[part[0]]), int(index[part[-1]]) + 1)
            places = [np.interp(at, index[part], values[part]) for values in (rows.x, rows.y)]
            found.append(Visit(int(at[0]), np.stack(places, axis=1)))
    return sorted(found, key=lambda visit: visit.first)


def recording_scene(rows: Rows, name: str = RECORDING) -> Scene:
    """An open area around a recording: its bounding box and a metre more, walls on the outside only.

    The robot drives 6 m, or what there is room for, straight across the way in which most people go, through a place
    where somebody has been. Other people than the recorded ones stroll anywhere.
    """
    low = np.array([rows.x.min(), rows.y.min()]) - _MARGIN
    high = np.array([rows.x.max(), rows.y.max()]) + _MARGIN
    places = np.stack([rows.x, rows.y], axis=1).astype(np.float32)
    ways = np.array([visit.places[-1] - visit.places[0] for visit in visits(rows)])
    # The direction along which people's ways are longest, either way: the flow's axis.
    along = np.linalg.eigh(ways.T @ ways)[1][:, -1]
    across = float(np.arctan2(along[0], -along[1]))

    def meet(u, robot_speed, speed):
        del robot_speed, speed
        index = jnp.minimum((u[0] * len(places)).astype(jnp.int32), len(places) - 1)
        x, y = jnp.asarray(places)[index].T
        heading = across + 0.5 * (2.0 * u[1] - 1.0) + jnp.where(u[2] < 0.5, 0.0, jnp.pi)
        ux, uy = jnp.cos(heading), jnp.sin(heading)
        ends = []
        for sign in (-_HALF_WAY, _HALF_WAY):
            ends += [jnp.clip(x + sign * ux, low[0] + 0.5, high[0] - 0.5)]
            ends += [jnp.clip(y + sign * uy, low[1] + 0.5, high[1] - 0.5)]
        # One that isn't recorded comes from ahead.
        first = [low[i] + 0.5 + u[3 + i] * (high[i] - low[i] - 1.0) for i in (0, 1)]
        return tuple(ends), straight(first[0], first[1], ends[0], ends[1])

    (x0, y0), (x1, y1) = low.tolist(), high.tolist()
    return Scene(
        name, (((x0, y0), (x1, y0), (x1, y1), (x0, y1)),), ((x0, y0, x1, y1),), MAX_PEDESTRIANS, meet,
    )  # fmt: skip
