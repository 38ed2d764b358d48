"""Legs against what gait laboratories measure, and against what a leg tracker relies on: feet that stand still."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxnav.world import Params, World, WorldConfig, gait

DT = 0.005
PARAMS = Params(dt=DT)
SPEEDS = [0.3, 0.5, 0.8, 1.2, 1.5]


@jax.jit
def legs(x, y, vx, vy, t, seed, params):
    """`[steps, legs, 2]`, the right legs first, of pedestrians `[steps, P]` at steps `[steps]`."""
    return jnp.stack(jax.vmap(gait.legs, in_axes=(0,) * 5 + (None, None))(x, y, vx, vy, t, seed, params), axis=-1)


def walk(speed, heading=0.4, steps=2000, seed=3_000_000_000, start=(1.0, -2.0), **params):
    """Legs `[steps, 2, 2]` of a pedestrian who walks straight at its preferred speed, 10 s by default."""
    t = np.arange(steps)
    vx, vy = speed * np.cos(heading), speed * np.sin(heading)
    path = [start[0] + vx * DT * t, start[1] + vy * DT * t, 0 * t + vx, 0 * t + vy]
    moving = [leaf[:, None].astype(np.float32) for leaf in path]
    params = jax.tree.map(np.float32, PARAMS.replace(**{"preferred_speed": speed, "max_speed": 2.0} | params))
    middle = np.stack(path[:2], axis=-1)
    return np.asarray(legs(*moving, t.astype(np.uint16), np.uint32(seed), params)), middle


def along_and_aside(legs, middle, heading=0.4):
    """Where the legs are relative to the middle: ahead of it and to its left, `[steps, 2]` each."""
    relative = legs - middle[:, None]
    return (
        relative @ [np.cos(heading), np.sin(heading)],
        relative @ [-np.sin(heading), np.cos(heading)],
    )


@pytest.mark.parametrize("speed", SPEEDS)
def test_a_foot_in_stance_stays_where_it_is(speed):
    """Sixty per cent of the time for each foot, a fifth of it both, and at all times at least one of them."""
    feet, _ = walk(speed, steps=round(4 * 2 * np.sqrt(0.39 / speed) / DT))  # four strides
    still = np.hypot(*np.diff(feet, axis=0).transpose(2, 0, 1)) < 0.02 * speed * DT + 1e-6
    np.testing.assert_allclose(still.mean(axis=0), 0.6, atol=0.02)
    assert still.any(axis=1).all()
    assert still.all(axis=1).mean() == pytest.approx(0.2, abs=0.03)


@pytest.mark.parametrize("speed", SPEEDS)
def test_a_foot_never_jumps_and_passes_the_body(speed):
    feet, middle = walk(speed)
    moved = np.hypot(*np.diff(feet, axis=0).transpose(2, 0, 1))
    # A swing of 40 % of the stride covers it along half a cosine: pi / 2 / 0.4 = 3.9 times the walking speed at most.
    assert moved.max() == pytest.approx(np.pi / 0.8 * speed * DT, rel=0.02)
    ahead, aside = along_and_aside(feet, middle)
    # 60 % of a stride from landing to lift-off, and a little more: a foot that swings is slower than the body at first.
    reach = 0.316 * 2 * np.sqrt(0.39 * speed)
    np.testing.assert_allclose([ahead.max(axis=0), -ahead.min(axis=0)], np.full((2, 2), reach), rtol=2e-3)
    np.testing.assert_allclose(aside, np.broadcast_to([-0.1, 0.1], aside.shape), atol=1e-5)


@pytest.mark.parametrize("speed", [1.1, 1.34, 1.5])
def test_steps_are_as_long_and_as_frequent_as_peoples(speed):
    """Healthy adults at 1.34 m/s: steps of 0.7 m, 90 to 120 a minute; their ratio 0.0065 m/(steps/min) at any speed."""
    feet, _ = walk(speed, heading=0.0)
    footprints = []
    for foot in (0, 1):
        x = feet[:, foot, 0]
        landed = np.nonzero((np.diff(x)[:-1] > 2e-5) & (np.diff(x)[1:] <= 2e-5))[0] + 1
        footprints += [(t * DT, x[t]) for t in landed]
    times, places = np.array(sorted(footprints)).T
    length, cadence = np.diff(places).mean(), 60 / np.diff(times).mean()
    np.testing.assert_allclose(np.diff(places), length, rtol=0.03)  # left as long as right: they alternate
    assert length / cadence == pytest.approx(0.0065, rel=0.02)
    assert 0.6 < length < 0.8 and 90 < cadence < 120


def test_legs_are_in_antiphase():
    """Half a stride later the left leg is where the right one was, relative to the body."""
    speed = 0.39  # a step a second
    feet, middle = walk(speed)
    ahead, _ = along_and_aside(feet, middle)
    later = round(1.0 / DT)
    np.testing.assert_allclose(ahead[later:, 1], ahead[:-later, 0], atol=1e-4)
    assert np.abs(ahead[:, 0] - ahead[:, 1]).max() > 0.35


def test_legs_close_up_at_rest_without_a_jump():
    for speed, apart in ((0.0, 0.0), (0.001, 0.002), (0.05, 0.1), (0.1, 0.2), (0.5, 0.2)):
        feet, middle = walk(speed, preferred_speed=0.5)
        _, aside = along_and_aside(feet, middle)
        np.testing.assert_allclose(aside[:, 1] - aside[:, 0], apart, atol=1e-6)
        stride = 2 * speed / np.sqrt(0.5 / 0.39)
        assert np.abs(feet - middle[:, None]).max() <= 0.3 * stride + apart / 2 + 1e-5


def test_turning_about_turns_the_legs_about_and_changes_no_phase():
    """The way a pedestrian faces, and where it is, has no part in when it steps."""
    one, other = along_and_aside(*walk(0.5, 0.4)), along_and_aside(*walk(0.5, -2.9, start=(-3.0, 4.0)), -2.9)
    np.testing.assert_allclose(one, other, atol=1e-5)


@pytest.mark.parametrize(("body", "leg"), [(0.05, 0.05), (0.1, 0.1), (0.2, 0.1), (0.25, 0.1)])
def test_legs_are_no_thicker_than_a_body_and_fit_in_a_wide_one_beside_each_other(body, leg):
    radius = gait.leg_radius(PARAMS.replace(body_radius=body))
    feet, middle = walk(0.5, body_radius=body)
    _, aside = along_and_aside(feet, middle)
    assert radius == pytest.approx(leg)
    assert np.abs(aside).max() + radius == pytest.approx(2 * leg, abs=1e-5)
    assert 2 * leg <= max(body, 2 * min(body, 0.1))


def test_people_are_out_of_step():
    count = 5
    zero = np.zeros((1, count), np.float32)
    phases = [
        np.asarray(legs(zero, zero, zero + 0.5, zero, np.uint16([t]), np.uint32(seed), PARAMS))[0, :count, 0]
        for t, seed in ((0, 1), (0, 2**31), (7, 1))
    ]
    assert np.abs(np.diff(np.sort(phases[0]))).min() > 0.01
    assert np.abs(phases[0] - phases[1]).min() > 0.01
    assert np.abs(phases[0] - phases[2]).max() > 0.01


def test_the_scan_sees_legs_where_they_are(situation):
    world = World(WorldConfig(body="legs", pedestrians=2, observation=("scan",), scenes=("square",)))
    params = Params(body_radius=0.2)
    state = situation(robot=(-1.0, 0.3, 0.1), pedestrians=[(1.0, 0.0, 4.0, 0.0), (0.0, 1.8, 1.0, 3.3)], t=9)
    scan = np.asarray(jax.jit(world.observe)(state, params).scan)
    angles = 0.1 + np.linspace(-np.pi / 2, np.pi / 2, 180)
    hits = np.array([-1.0, 0.3]) + scan[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    walkers = state.pedestrians
    middles = gait.legs(walkers.x, walkers.y, walkers.vx, walkers.vy, state.t, state.seed, params)
    middles = np.stack(middles, axis=-1)
    to_legs = np.linalg.norm(hits[:, None] - middles, axis=-1)
    on_people = np.abs(hits).max(axis=1) < 4.9
    np.testing.assert_allclose(to_legs[on_people].min(axis=1), 0.1, atol=1e-3)
    assert (np.abs(to_legs - 0.1) < 1e-3).sum(axis=0).min() > 2  # of each leg some of its beams


def test_gradients_are_finite_also_at_rest():
    def total(velocity, preferred_speed):
        zero = jnp.zeros(1)
        params = Params(preferred_speed=preferred_speed)
        feet = gait.legs(zero, zero, velocity[:1], velocity[1:], jnp.uint16(9), jnp.uint32(0), params)
        return sum(jnp.sum(coordinate) for coordinate in feet)

    gradient = jax.jit(jax.grad(total, argnums=(0, 1)))
    for velocity in ([0.0, 0.0], [0.5, 0.0], [1e-4, -1e-4]):
        for preferred_speed in (0.0, 0.5):
            leaves = jax.tree.leaves(gradient(jnp.array(velocity), preferred_speed))
            assert all(np.all(np.isfinite(leaf)) for leaf in leaves)
