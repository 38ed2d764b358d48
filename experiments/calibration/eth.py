"""Reads recordings in the ETH walking-pedestrians format: positions, assumed destinations, groups.

Format: Pellegrini, Ess, Schindler, van Gool, "You'll never walk alone", 2009. A row of obsmat.txt is frame, id, x, z,
y, vx, vz, vy, in metres and metres a second, 2.5 annotated frames a second; z and vz are 0. The velocities of the
format are central differences, which look one frame ahead: they are not read, so that no predictor sees the future.
"""

import pathlib
from typing import NamedTuple

import numpy as np

from jaxnav.errors import UserError
from jaxnav.world.people.recording import frames_per_period, read_recording, read_table


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
    try:
        rows = read_recording(path)
        targets = np.zeros((0, 2)) if destinations is None else read_table(destinations, (2,), "x, y")
    except ValueError as error:
        raise UserError(str(error)) from None
    frames, ids = rows.frame, rows.id
    people = _by_appearance(frames, ids)
    if len(people) < 2:
        raise UserError(f"{path}: holds {len(people)} person: give a recording of at least 2")
    instant = _instants(frames)
    position = np.full((instant.max() + 1, len(people), 2), np.nan)
    column = {person: n for n, person in enumerate(people)}
    position[instant, [column[person] for person in ids]] = np.stack([rows.x, rows.y], axis=1)
    return Recording(people.astype(int), position, targets, _group_numbers(groups, column))


def _by_appearance(frames, ids):
    """The distinct ids, first who is seen first."""
    order = np.lexsort((ids, frames))
    distinct, first = np.unique(ids[order], return_index=True)
    return distinct[np.argsort(first)]


def _instants(frames):
    """`[rows]` index of each row's instant. A break of the annotation, however long, becomes one empty instant."""
    distinct = np.unique(frames)
    steps = np.where(np.diff(distinct) == frames_per_period(frames), 1, 2)
    index = np.concatenate([[0], np.cumsum(steps)]).astype(int)
    return index[np.searchsorted(distinct, frames)]


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
