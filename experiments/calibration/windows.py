"""Windows of a recording: what a predictor may know at an instant, and what people did afterwards.

Everything in a window but ``future`` is known at its instant: nobody who appears later is in it, velocities are
differences with the past, and a destination is chosen by the heading so far.
"""

from typing import NamedTuple

import numpy as np

from jaxnav.errors import UserError
from jaxnav.world.people.recording import ANNOTATION_PERIOD

STANDING = 0.3  # m/s: who was slower than this while observed is taken to stand
_FAR = 100.0  # metres ahead: the destination of somebody of whom none is assumed
_TOWARD = np.cos(np.radians(45.0))  # a destination lies within this angle of the heading


class Windows(NamedTuple):
    """M windows of P people each, robots among them; unused places are not ``present``.

    instant: `[M]` index of now; position: `[M, P, 2]`; velocity: `[M, P, H, 2]` over the last H steps, newest first,
    0 where unknown; known: `[M, P, H]` whether it is; goal: `[M, P, 2]`; standing, robot, present: `[M, P]` bool;
    group: `[M, P]` int; future: `[M, P, T, 2]` positions at the T following instants, 0 where unknown; weight:
    `[M, P]` how much that future counts, 0 if it isn't known; person: `[M, P]` int index of the person, -1 for nobody.
    """

    instant: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    known: np.ndarray
    goal: np.ndarray
    standing: np.ndarray
    robot: np.ndarray
    present: np.ndarray
    group: np.ndarray
    future: np.ndarray
    weight: np.ndarray
    person: np.ndarray

    def take(self, index):
        """The windows with these indices."""
        return Windows(*(field[index] for field in self))


def cut(recording, observe=8, predict=12):
    """`Windows` of a `Recording`, one at every instant at which somebody's future counts.

    observe, predict: instants of the past, now included, and of the future; who was there in all of them is a target.
    UserError: nobody was.
    """
    position = recording.position
    there = np.isfinite(position[..., 0])
    instants = []
    for now in range(observe - 1, len(position) - predict):
        target = np.all(there[now - observe + 1 : now + predict + 1], axis=0)
        if target.any():
            # Of somebody seen once nothing is known but a place: no velocity, so no prediction.
            instants.append((now, target, np.flatnonzero(there[now] & there[now - 1])))
    if not instants:
        raise UserError(
            f"the recording has nobody who stays for {observe + predict} annotated frames: give a longer one"
        )
    places = max(len(people) for _, _, people in instants)
    return _stack([_window(recording, *instant, observe, predict, places) for instant in instants])


def _window(recording, now, target, people, observe, predict, places):
    past = recording.position[now - observe + 1 : now + 1, people]
    velocity = (np.diff(past, axis=0) / ANNOTATION_PERIOD)[::-1].transpose(1, 0, 2)
    # An unknown velocity is also the end of what counts: nobody's earlier visit says how it walks now.
    known = np.logical_and.accumulate(np.isfinite(velocity[..., 0]), axis=1)
    velocity = np.where(known[..., None], velocity, 0.0)
    mean = velocity.sum(1) / known.sum(1, keepdims=True)
    future = np.nan_to_num(recording.position[now + 1 : now + 1 + predict, people].transpose(1, 0, 2))
    alone = np.zeros(len(people), bool)
    fields = {
        "instant": np.array(now),
        "position": past[-1],
        "velocity": velocity,
        "known": known,
        "goal": destination(past[-1], mean, recording.destinations),
        "standing": np.linalg.norm(mean, axis=1) < STANDING,
        "robot": alone,
        "present": ~alone,
        "group": recording.groups[people],
        "future": future,
        "weight": target[people].astype(float),
        "person": people,
    }
    blank = {"person": -1}
    return [_pad(fields[name], places, blank.get(name, 0)) for name in Windows._fields]


def destination(position, velocity, destinations):
    """Where people `[N, 2]` walk to `[N, 2]`: the assumed destination nearest to their heading, else far ahead."""
    speed = np.linalg.norm(velocity, axis=1, keepdims=True)
    heading = velocity / np.maximum(speed, 1e-9)
    ahead = position + _FAR * heading
    if len(destinations) == 0:
        return ahead
    offset = destinations[None] - position[:, None]
    cosine = (offset * heading[:, None]).sum(2) / np.maximum(np.linalg.norm(offset, axis=2), 1e-9)
    best = cosine.argmax(1)
    return np.where(cosine.max(1)[:, None] > _TOWARD, destinations[best], ahead)


def _pad(values, places, blank):
    if values.ndim == 0:
        return values
    width = [(0, places - len(values))] + [(0, 0)] * (values.ndim - 1)
    return np.pad(values, width, constant_values=blank)


def _stack(windows):
    """`Windows` of rows of fields, floats as float32."""
    fields = [np.stack(field) for field in zip(*windows, strict=True)]
    return Windows(*(field.astype(np.float32) if field.dtype == float else field for field in fields))


def split(recording, windows, share):
    """(training, held-out) `Windows`, split by person: of all people the first ``share`` to appear are for training.

    Training ends, futures included, before the first held-out person appears. UserError: one of the two is empty.
    """
    border = round(share * len(recording.ids))
    there = np.isfinite(recording.position[:, border:, 0]).any(axis=1)
    first_held_out = int(np.argmax(there)) if there.any() else len(there)
    early = windows.instant + windows.future.shape[2] < first_held_out
    belongs = {"training": early[:, None] & (windows.person < border), "held-out": windows.person >= border}
    parts = []
    for name, mine in belongs.items():
        target = (windows.weight > 0) & mine
        people, counts = np.unique(windows.person[target], return_counts=True)
        if len(people) < 2:
            raise UserError(
                f"share is {share:g}: leaves {len(people)} {name} people of {len(recording.ids)} who stay long enough: "
                "give a longer recording, or another share between 0 and 1"
            )
        counts = dict(zip(people, counts, strict=True))
        # Everybody counts alike, however long it stays.
        weight = np.zeros_like(windows.weight)
        weight[target] = [1.0 / counts[person] for person in windows.person[target]]
        parts.append(_trim(windows._replace(weight=weight).take(np.flatnonzero(target.any(axis=1)))))
    return tuple(parts)


def _trim(windows):
    """The same without the places that nobody takes in any window."""
    places = windows.present.any(axis=0).sum()
    return Windows(windows.instant, *(field[:, :places] for field in windows[1:]))
