"""Reads recordings in the ETH walking-pedestrians format: positions, assumed destinations, groups.

Format: Pellegrini, Ess, Schindler, van Gool, "You'll never walk alone", 2009. A row of obsmat.txt is frame, id, x, z,
y, vx, vz, vy, in metres and metres a second, 2.5 annotated frames a second; z and vz are 0. The velocities of the
format are central differences, which look one frame ahead: they are not read, so that no predictor sees the future.
"""

import pathlib
from typing import NamedTuple

import numpy as np

from jaxnav.errors import UserError

ANNOTATION_PERIOD = 0.4  # seconds between two annotated frames
_COLUMNS = 8


class Recording(NamedTuple):
    """Tracks of N people over F instants, ``ANNOTATION_PERIOD`` seconds apart.

    ids: `[N]`, in the order of appearance; position: `[F, N, 2]` metres, NaN where a person is not there, and for
    everybody at an instant that was not annotated; destinations: `[D, 2]` where people are assumed to walk to, D may
    be 0; groups: `[N]`, people with the same number walk together, everybody else has a number of its own.
    """

    ids: np.ndarray
    position: np.ndarray
    destinations: np.ndarray
    groups: np.ndarray


def read(path, destinations=None, groups=None):
    """The `Recording` in a file; UserError names file, line or field, and remedy.

    destinations, groups: paths of the files that go with it, or None for none.
    """
    rows = _table(path, _COLUMNS, "frame, id, x, z, y, vx, vz, vy")
    frames, ids = rows[:, 0], rows[:, 1]
    for name, values in (("frame", frames), ("id", ids)):
        if np.any(values != np.round(values)) or np.any(values < 0):
            line = int(np.argmax((values != np.round(values)) | (values < 0)))
            raise UserError(f"{path}: {name} is {values[line]:g} in row {line + 1}: give whole numbers of at least 0")
    pairs, counts = np.unique(rows[:, :2], axis=0, return_counts=True)
    if np.any(counts > 1):
        frame, person = pairs[np.argmax(counts)]
        raise UserError(f"{path}: id {person:.0f} stands twice in frame {frame:.0f}: keep one row of each id a frame")
    people = _by_appearance(frames, ids)
    if len(people) < 2:
        raise UserError(f"{path}: holds {len(people)} person: give a recording of at least 2")
    instant = _instants(frames)
    position = np.full((instant.max() + 1, len(people), 2), np.nan)
    column = {person: n for n, person in enumerate(people)}
    position[instant, [column[person] for person in ids]] = rows[:, [2, 4]]
    targets = np.zeros((0, 2)) if destinations is None else _table(destinations, 2, "x, y")
    return Recording(people.astype(int), position, targets, _group_numbers(groups, column))


def _table(path, columns, meaning):
    """The numbers in a text file `[rows, columns]`."""
    try:
        lines = pathlib.Path(path).read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "it is not text"
        raise UserError(f"{path}: can't be read ({reason}): give the path of a file in the ETH format") from None
    rows = []
    for number, line in enumerate(lines, 1):
        words = line.split()
        if not words:
            continue
        if len(words) != columns:
            raise UserError(f"{path}: line {number} has {len(words)} columns: give {columns}, {meaning}")
        try:
            rows.append([float(word) for word in words])
        except ValueError:
            raise UserError(f"{path}: line {number} is not all numbers: give {columns}, {meaning}") from None
        if not np.all(np.isfinite(rows[-1])):
            raise UserError(f"{path}: line {number} holds a number that is not finite: remove or mend that line")
    if not rows:
        raise UserError(f"{path}: is empty: give rows of {columns} columns, {meaning}")
    return np.array(rows)


def _by_appearance(frames, ids):
    """The distinct ids, first who is seen first."""
    order = np.lexsort((ids, frames))
    distinct, first = np.unique(ids[order], return_index=True)
    return distinct[np.argsort(first)]


def _instants(frames):
    """`[rows]` index of each row's instant. A break of the annotation, however long, becomes one empty instant."""
    distinct = np.unique(frames)
    gaps = np.diff(distinct)
    period = _most_common(gaps)
    steps = np.where(gaps == period, 1, 2)
    index = np.concatenate([[0], np.cumsum(steps)]).astype(int)
    return index[np.searchsorted(distinct, frames)]


def _most_common(values):
    if len(values) == 0:
        return 1.0
    distinct, counts = np.unique(values, return_counts=True)
    return distinct[np.argmax(counts)]


def _group_numbers(path, column):
    """`[N]` a number for each group, and one of its own for everybody in none."""
    numbers = np.arange(len(column))
    if path is None:
        return numbers
    try:
        lines = pathlib.Path(path).read_text(encoding="utf-8").splitlines()
        groups = [[int(word) for word in line.split()] for line in lines]
    except OSError as error:
        raise UserError(f"{path}: can't be read ({error.strerror}): give the path of a groups file") from None
    except ValueError:
        raise UserError(f"{path}: is not all whole numbers: give the ids of one group a line") from None
    for group in groups:
        members = [column[person] for person in group if person in column]
        if members:
            numbers[members] = min(members)
    return numbers
