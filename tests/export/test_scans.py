"""Any laser, mounted anyhow, in a room whose ranges are known: the trained beams see the room."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxnav.export.modules import modules

BEAMS = 180
LASER = {"beams": BEAMS, "angle_min": -math.pi / 2, "angle_max": math.pi / 2, "range_max": 12.0}
TRAINED = np.linspace(-np.pi / 2, np.pi / 2, BEAMS)
LEFT, RIGHT, AHEAD, BEHIND = 2.0, -1.5, 4.0, -3.0  # walls of the room


@pytest.fixture(scope="module")
def scans(bundles):
    with modules(bundles("td3")[2], "scans") as (module,):
        yield module


def room(angles, x=0.0, y=0.0):
    """Closed-form ranges from (x, y) to the walls of a rectangular room."""
    cos, sin = np.cos(angles), np.sin(angles)
    with np.errstate(divide="ignore", over="ignore"):
        along = np.where(cos > 0, (AHEAD - x) / cos, (BEHIND - x) / cos)
        across = np.where(sin > 0, (LEFT - y) / sin, (RIGHT - y) / sin)
    return np.minimum(np.where(cos == 0, np.inf, along), np.where(sin == 0, np.inf, across))


def seen(scans, count, first, step, mount=(0.0, 0.0, 0.0, False), spoil=None):
    """What a laser of that geometry measures in the room, resampled."""
    x, y, yaw, upside_down = mount
    angles = first + step * np.arange(count)
    ranges = room(yaw + (-angles if upside_down else angles), x, y)
    if spoil is not None:
        ranges = spoil(ranges)
    return scans.LaserInput(LASER, scans.Mount(*mount))(scans.Scan(ranges, first, step))


def assert_room(found, step, slack=0.0):
    """Every beam sees what lies in its direction, give or take the spacing of the beams."""
    spread = (TRAINED[1] - TRAINED[0]) / 2 + abs(step) / 2 + slack
    around = room(TRAINED + np.linspace(-spread, spread, 201)[:, None])
    assert (found >= around.min(axis=0) - 2e-3).all() and (found <= around.max(axis=0) + 2e-3).all()


def test_the_trained_beams_are_taken_as_they_are(scans):
    ranges = np.random.default_rng(0).uniform(0.1, 11.9, BEAMS).astype(np.float32)
    found, points = scans.LaserInput(LASER, scans.Mount())(scans.Scan(ranges, -np.pi / 2, np.pi / (BEAMS - 1)))
    np.testing.assert_array_equal(found, ranges)
    np.testing.assert_allclose(np.hypot(*points.T), ranges, rtol=1e-6)


@given(
    count=st.integers(60, 1440), start=st.floats(-math.pi, math.pi), yaw=st.floats(-math.pi, math.pi),
    backwards=st.booleans(), upside_down=st.booleans(),
)  # fmt: skip
def test_whole_turns_of_any_fineness_and_direction(scans, count, start, yaw, backwards, upside_down):
    step = (-1 if backwards else 1) * 2 * math.pi / count
    found, points = seen(scans, count, start, step, (0.0, 0.0, yaw, upside_down))
    assert_room(found, step)
    on_wall = np.minimum(np.abs(points - [AHEAD, LEFT]), np.abs(points - [BEHIND, RIGHT])).min(axis=1)
    assert len(points) == count and on_wall.max() < 1e-9


@given(x=st.floats(-0.3, 0.3), y=st.floats(-0.3, 0.3), yaw=st.floats(-math.pi, math.pi), upside_down=st.booleans())
def test_a_laser_that_sits_elsewhere(scans, x, y, yaw, upside_down):
    """As seen from the middle of the robot; the directions then are spread unevenly."""
    step = 2 * math.pi / 720
    found, points = seen(scans, 720, -math.pi, step, (x, y, yaw, upside_down))
    assert_room(found, step, slack=0.5 * step)
    assert np.minimum(np.abs(points - [AHEAD, LEFT]), np.abs(points - [BEHIND, RIGHT])).min(axis=1).max() < 1e-9


@given(x=st.floats(-0.2, 0.2), y=st.floats(-0.2, 0.2), toward=st.floats(-1.4, 1.4), away=st.floats(0.6, 1.3))
def test_a_laser_that_sits_elsewhere_among_things(scans, x, y, toward, away):
    """Behind a post there are directions that it can't see, and the robot's middle could: nothing there is free."""
    post = away * math.cos(toward), away * math.sin(toward)
    angles = -math.pi + 2 * math.pi / 360 * np.arange(360)
    found, _ = scans.LaserInput(LASER, scans.Mount(x=x, y=y))(
        scans.Scan(np.minimum(room(angles, x, y), disc(angles, post, x, y)), -math.pi, 2 * math.pi / 360)
    )
    free = np.minimum(room(TRAINED), disc(TRAINED, post))
    # Nowhere much farther than it is, but for the rim of the post, and where the post is it is seen.
    rim = np.abs(TRAINED - toward) < math.asin(0.15 / away) + math.radians(4.0)
    step = math.radians(2.0)
    around = room(TRAINED + np.linspace(-step, step, 41)[:, None])
    assert (found[~rim] <= around.max(axis=0)[~rim] + 0.02).all()
    middle = np.abs(TRAINED - toward) < 0.5 * math.asin(0.15 / away)
    np.testing.assert_allclose(found[middle], free[middle], atol=0.06)


def test_half_a_turn_may_sit_elsewhere(scans):
    ranges = np.full(181, 3.0)
    found, _ = scans.LaserInput(LASER, scans.Mount(x=0.1))(scans.Scan(ranges, -math.pi / 2, math.pi / 180))
    assert (found <= 3.2).all() and abs(found[90] - 3.1) < 0.01


def disc(angles, centre, x=0.0, y=0.0, radius=0.15):
    """Closed-form ranges from (x, y) to a disc, inf beside it."""
    px, py = centre[0] - x, centre[1] - y
    along = np.cos(angles) * px + np.sin(angles) * py
    inside = radius**2 - (np.cos(angles) * py - np.sin(angles) * px) ** 2
    return np.where((inside >= 0) & (along > 0), along - np.sqrt(np.maximum(inside, 0.0)), np.inf)


def test_no_range_is_longer_than_the_longest(scans):
    """From the middle of the robot a wall may be farther away than from the laser in front of it."""
    ranges = np.full(360, 11.9)
    found, points = scans.LaserInput(LASER, scans.Mount(x=0.3))(scans.Scan(ranges, -math.pi, math.pi / 180))
    assert found.max() == 12.0 and np.hypot(*points.T).max() > 12.1


def test_a_thin_thing_between_two_trained_beams_is_seen(scans):
    """By a laser that is finer than the trained one; the nearest return in a beam's direction counts."""
    step = 2 * math.pi / 3600

    def stick(ranges):
        ranges[1800 + 4] = 0.7  # 0.4 degrees to the left of ahead: no trained beam points there
        return ranges

    found, _ = seen(scans, 3600, -math.pi, step, spoil=stick)
    near = np.flatnonzero(found < 1.0)
    assert len(near) == 1 and abs(TRAINED[near[0]]) < math.radians(1.0)


@pytest.mark.parametrize("value", [math.inf, math.nan, 0.0, 12.0, 13.0, -1.0])
def test_no_return_is_the_longest_range(scans, value):
    def spoil(ranges):
        ranges[80:100] = value
        return ranges

    found, points = seen(scans, BEAMS, -np.pi / 2, np.pi / (BEAMS - 1), spoil=spoil)
    np.testing.assert_array_equal(found[80:100], 12.0)
    np.testing.assert_allclose(found[:80], room(TRAINED[:80]), rtol=1e-5)
    assert len(points) == BEAMS - 20


def test_nearer_than_can_be_measured_is_near(scans):
    def spoil(ranges):
        ranges[90] = -math.inf
        return ranges

    found, points = seen(scans, BEAMS, -np.pi / 2, np.pi / (BEAMS - 1), spoil=spoil)
    assert found[90] < 0.01 and np.hypot(*points.T).min() < 0.01


def test_what_does_not_cover_the_front_is_refused(scans):
    with pytest.raises(scans.Unusable, match="the policy needs -90 to 90 degrees"):
        seen(scans, 120, math.radians(-60), math.radians(1))
    # The last beam of a whole turn may be missing: it is the first one again.
    seen(scans, 359, -math.pi, 2 * math.pi / 360)


def test_a_mount_that_is_no_place_is_refused(scans):
    with pytest.raises(ValueError, match=r"give Mount\(x, y, yaw\), m and rad"):
        scans.LaserInput(LASER, scans.Mount(x=math.nan))
    for mount in (scans.Mount(yaw=180.0), (0.1, 0.0, 0.0), None):
        with pytest.raises(ValueError, match="mount is"):
            scans.LaserInput(LASER, mount)
