"""Pedestrians who are not in an episode: slots of the world that nothing and nobody notices."""

import jax
import numpy as np
import pytest

from jaxnav.world import Params

PARAMS = Params(awareness=3.0, neighbor_distance=10.0, p_decides_late=1.0, small_talk=0.0)
WALKER = (2.0, 0.3, -4.5, 0.3)
# In the robot's place, in its way, in the walker's way, right before the laser, in the walker's place.
ABSENT = [(0.0, 0.0, 4.0, 0.0), (1.0, 0.0, -4.0, 0.0), (1.6, 0.3, 4.0, 0.3), (0.4, -0.1, -4.0, 0.0), WALKER]


@pytest.fixture
def alone_among_absent(situation):
    """The same episode in a world for one pedestrian, and in one for six of whom five are not there."""

    def pair(**settings):
        one, six = (situation(pedestrians=people, **settings) for people in ([WALKER], [WALKER, *ABSENT]))
        people = six.pedestrians.replace(present=np.arange(6) < 1)
        return one, six.replace(pedestrians=people)

    return pair


@pytest.mark.parametrize("asked", [0, 1, 2])
@pytest.mark.parametrize("first_draw", [0.0, 0.99], ids=["it speaks", "the robot speaks"])
def test_more_slots_than_people_give_the_same_motion(default, crowd, alone_among_absent, action, asked, first_draw):
    """Robot, walker, dialogue, reward and distances, step by step through a meeting."""
    one, six = alone_among_absent(first_draw=first_draw)
    met = False
    for _ in range(12):
        one, outcome = default.act(one, action(0.4, 0.1, asked), PARAMS)
        six, same = crowd.act(six, action(0.4, 0.1, asked), PARAMS)
        close(outcome, same)
        close(one.robot, six.robot)
        close(one.min_distance, six.min_distance)
        close(one.pedestrians, first_of(six.pedestrians))
        # The wording is drawn for all slots at once.
        close(one.encounters.replace(utterance=0), first_of(six.encounters).replace(utterance=0))
        assert not six.encounters.met[1:].any()
        met |= bool(one.encounters.met[0])
    assert met


def close(a, b):
    jax.tree.map(lambda x, y: np.testing.assert_allclose(x, y, rtol=1e-5, atol=1e-4), a, b)


def first_of(people):
    return jax.tree.map(lambda leaf: leaf[:1], people)


def test_they_are_neither_scanned_nor_listed_nor_mapped_nor_heard(default, crowd, alone_among_absent):
    one, six = alone_among_absent()
    # Whatever their slots say.
    said = six.encounters.replace(message=np.full(6, 2, np.int32), utterance=np.full(6, 9, np.uint32))
    there, seen = default.observe(one, PARAMS), crowd.observe(six.replace(encounters=said), PARAMS)
    np.testing.assert_allclose(seen.scan, there.scan, atol=1e-5)
    assert seen.seen.tolist() == [True, False, False, False]
    np.testing.assert_allclose(seen.pedestrians[:1], there.pedestrians, atol=1e-5)
    assert not np.any(seen.pedestrians[1:])
    rows, columns = np.nonzero(seen.pedestrian_map[0])
    middle = 3 - (rows.mean() + 0.5) * 0.125, 3 - (columns.mean() + 0.5) * 0.125
    assert middle == pytest.approx((2.0, 0.3), abs=0.03)
    assert np.sum(seen.pedestrian_map[0]) * 0.125**2 == pytest.approx(np.pi * 0.3**2, rel=0.15)


def test_they_are_not_touched(default, crowd, alone_among_absent, action):
    """The robot drives through all of them; those who are there it hits."""
    _, six = alone_among_absent(met=True)
    _, outcome = crowd.act(six, action(v=0.6), PARAMS)
    assert not outcome.collided
    assert outcome.pedestrian_distance > 1.0
    there = six.replace(pedestrians=six.pedestrians.replace(present=np.ones(6, bool)))
    _, outcome = crowd.act(there, action(v=0.6), PARAMS)
    assert outcome.hit_pedestrian
    assert outcome.pedestrian_distance < 0.0


def test_the_nearest_who_are_there_are_listed_first(crowd, situation):
    """Numbers 1, 3 and 5 are there, the farthest first."""
    places = [(0.5, 0.0), (3.0, 0.0), (0.6, 0.0), (2.0, 0.0), (0.7, 0.0), (1.0, 0.0)]
    state = situation(pedestrians=[(*place, *place) for place in places])
    there = np.arange(6) % 2 == 1
    seen = crowd.observe(state.replace(pedestrians=state.pedestrians.replace(present=there)), PARAMS)
    np.testing.assert_allclose(seen.pedestrians[:, 0], [1.0, 2.0, 3.0, 0.0], atol=1e-5)
    assert seen.seen.tolist() == [True, True, True, False]
