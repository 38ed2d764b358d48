"""Windows: what they hold, and that nothing in them but the future knows of it."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from experiments.calibration import windows
from experiments.calibration.eth import Recording
from jaxnav.errors import UserError

OBSERVE, PREDICT = 4, 3


def recording(position, destinations=(), groups=None):
    people = position.shape[1]
    groups = np.arange(people) if groups is None else np.array(groups)
    return Recording(np.arange(people), np.asarray(position, float), np.reshape(destinations, (-1, 2)), groups)


def straight(instants, starts, velocities, spans):
    """People who walk evenly, there from instant a to before b of their span."""
    t = np.arange(instants)[:, None, None] * 0.4
    position = np.asarray(starts, float)[None] + t * np.asarray(velocities, float)[None]
    for person, (a, b) in enumerate(spans):
        position[:a, person] = position[b:, person] = np.nan
    return position


@st.composite
def crowds(draw):
    generator = np.random.default_rng(draw(st.integers(0, 10**6)))
    instants, people = draw(st.integers(8, 20)), draw(st.integers(2, 6))
    first = np.sort(generator.integers(0, instants - 1, people))
    first[0] = 0
    last = np.maximum(first + 2, generator.integers(0, instants + 1, people))
    last[0] = instants
    steps = generator.normal(size=(instants, people, 2)).cumsum(axis=0)
    for person in range(people):
        steps[: first[person], person] = steps[last[person] :, person] = np.nan
    return steps


@given(crowds(), st.integers(0, 10**6))
def test_nothing_but_the_future_depends_on_the_future(position, seed):
    cut = windows.cut(recording(position, [[9, 9], [-9, 0]]), OBSERVE, PREDICT)
    row = seed % len(cut.instant)
    now = cut.instant[row]
    changed = position.copy()
    changed[now + 1 :] += np.random.default_rng(seed).normal(size=changed[now + 1 :].shape)
    again = windows.cut(recording(changed, [[9, 9], [-9, 0]]), OBSERVE, PREDICT)
    for name in windows.Windows._fields:
        if name != "future":
            np.testing.assert_array_equal(getattr(cut, name)[row], getattr(again, name)[row], err_msg=name)


@given(crowds())
def test_who_counts_was_there_all_along_and_its_future_is_what_it_did(position):
    cut = windows.cut(recording(position), OBSERVE, PREDICT)
    seen = set()
    for row, place in zip(*np.nonzero(cut.weight), strict=True):
        now, person = cut.instant[row], cut.person[row, place]
        assert np.isfinite(position[now - OBSERVE + 1 : now + PREDICT + 1, person]).all()
        np.testing.assert_allclose(cut.future[row, place], position[now + 1 : now + PREDICT + 1, person], rtol=1e-5)
        seen.add((now, person))
    there = np.isfinite(position[..., 0])
    length = OBSERVE + PREDICT
    whole = {
        (a + OBSERVE - 1, p) for a in range(len(there) - length + 1) for p in range(there.shape[1])
        if there[a : a + length, p].all()
    }  # fmt: skip
    assert seen == whole


def test_velocities_are_differences_with_the_past_newest_first_and_a_gap_ends_them():
    position = straight(12, [[0, 0], [0, 5]], [[1, 0], [1, 0]], [(0, 12), (0, 12)])
    position[4:, 0, 0] += 0.4  # one step twice as fast
    position[2, 1] = np.nan
    cut = windows.cut(recording(position), 5, PREDICT)
    (row,) = np.flatnonzero(cut.instant == 4)
    np.testing.assert_allclose(cut.velocity[row, 0, :, 0], [2, 1, 1, 1], atol=1e-6)
    assert cut.known[row].tolist() == [[True] * 4, [True, False, False, False]]
    np.testing.assert_array_equal(cut.velocity[row, 1, 1:], 0)
    assert cut.weight[row].tolist() == [1, 0]  # someone with a gap is avoided, but not judged by


def test_newcomers_of_unknown_velocity_wait_and_places_are_padded():
    position = straight(12, [[0, 0], [3, 3]], [[1, 0], [0, 0]], [(0, 12), (4, 12)])
    cut = windows.cut(recording(position), OBSERVE, PREDICT)
    assert cut.present[:, 0].all()
    assert cut.present[:, 1].tolist() == [now >= 5 for now in cut.instant]
    assert cut.person[~cut.present].tolist() == [-1, -1]
    assert cut.standing[cut.present[:, 1], 1].all() and not cut.standing[:, 0].any()


def test_destinations_are_chosen_by_heading_within_45_degrees():
    place, destinations = np.zeros((4, 2)), np.array([[5.0, 0.0], [0.0, 5.0]])
    velocity = np.array([[1.0, 0.2], [0.2, 1.0], [-1.0, 0.0], [0.0, 0.0]])
    goal = windows.destination(place, velocity, destinations)
    np.testing.assert_allclose(goal, [[5, 0], [0, 5], [-100, 0], [0, 0]])
    np.testing.assert_allclose(windows.destination(place[:1], velocity[2:3], np.zeros((0, 2))), [[-100, 0]])


def test_split_keeps_people_and_instants_apart_and_weighs_everybody_alike():
    spans = [(0, 20), (0, 9), (8, 20), (10, 30), (12, 25), (28, 40)]
    velocities = [[1, 0]] * len(spans)
    position = straight(40, [[0, p] for p in range(len(spans))], velocities, spans)
    whole = recording(position)
    training, held_out = windows.split(whole, windows.cut(whole, OBSERVE, PREDICT), 0.5)
    assert np.unique(training.person[training.weight > 0]).tolist() == [0, 1]  # 2 stays into the time of 3
    assert np.unique(held_out.person[held_out.weight > 0]).tolist() == [3, 4, 5]
    assert training.instant.max() + PREDICT < 10
    for part in (training, held_out):
        totals = [part.weight[part.person == person].sum() for person in np.unique(part.person[part.weight > 0])]
        np.testing.assert_allclose(totals, 1, rtol=1e-6)


def test_recordings_that_are_too_short_are_refused():
    short = recording(straight(5, [[0, 0], [0, 1]], [[1, 0]] * 2, [(0, 5)] * 2))
    with pytest.raises(UserError, match="nobody who stays for 7 annotated frames: give a longer one"):
        windows.cut(short, OBSERVE, PREDICT)
    both = recording(straight(9, [[0, 0], [0, 1]], [[1, 0]] * 2, [(0, 9)] * 2))
    with pytest.raises(UserError, match=r"share is 0\.5: leaves 0 training people"):
        windows.split(both, windows.cut(both, OBSERVE, PREDICT), 0.5)
