"""The laser against an independent float64 computation, closed forms of a box, and the statistics of its noise."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from jaxnav.world import SCENES, Params, World, WorldConfig, lidar
from jaxnav.world.geometry import Vec2

BEAMS = 61
RANGE = 9.0
DISCS = 3
WORLD = World(WorldConfig(scenes=tuple(SCENES), pedestrians=8))


@jax.jit
def scan(scene, x, y, heading, discs, radius):
    cos, sin = jnp.cos(heading), jnp.sin(heading)
    directions = lidar.beam_directions(BEAMS)
    ranges = lidar.raycast(Vec2(x, y), Vec2(cos, sin), WORLD.walls(scene), directions, RANGE)
    return lidar.raycast_discs(ranges, Vec2(x, y), Vec2(cos, sin), Vec2(*discs), radius, directions)


def brute_force(segments, discs, radius, x, y, angles):
    """Ranges in float64, ray by ray: a 2 x 2 system for a segment `[4]`, a quadratic for a disc."""
    ranges = np.full(len(angles), RANGE)
    for i, angle in enumerate(angles):
        d = np.array([np.cos(angle), np.sin(angle)])
        for ax, ay, bx, by in segments:
            system = np.array([d, [ax - bx, ay - by]]).T
            if abs(np.linalg.det(system)) > 1e-12:
                r, s = np.linalg.solve(system, [ax - x, ay - y])
                if r >= 0 and 0 <= s <= 1:
                    ranges[i] = min(ranges[i], r)
        for cx, cy in discs.T:
            roots = np.roots([1.0, -2 * d @ [cx - x, cy - y], (cx - x) ** 2 + (cy - y) ** 2 - radius**2])
            if np.isreal(roots).all() and roots.real.min() > 0:
                ranges[i] = min(ranges[i], roots.real.min())
    return ranges


def segments_of(scene):
    return [(*a, *b) for chain in SCENES[scene].chains for a, b in zip(chain, [*chain[1:], chain[0]], strict=True)]


@pytest.mark.parametrize("scene", range(len(SCENES)), ids=list(SCENES))
@settings(max_examples=40)
@given(data=st.data())
def test_scan_is_what_brute_force_finds(scene, data):
    name = list(SCENES)[scene]
    floors = np.array(SCENES[name].floors)
    floor = floors[data.draw(st.integers(0, len(floors) - 1))]
    place = st.tuples(
        *(st.floats(low + 0.05, high - 0.05) for low, high in ((floor[0], floor[2]), (floor[1], floor[3])))
    )
    x, y = data.draw(place)
    heading = data.draw(st.floats(-4.0, 4.0))
    discs = np.array(data.draw(st.lists(place, min_size=DISCS, max_size=DISCS))).T
    radius = 0.2
    assume((np.hypot(discs[0] - x, discs[1] - y) > radius + 0.01).all())

    measured = np.asarray(scan(scene, x, y, heading, discs.astype(np.float32), radius))
    angles = heading + np.linspace(-np.pi / 2, np.pi / 2, BEAMS)
    # At an edge the range jumps: float32 may see either side of it, so the beam is bracketed by its neighbourhood.
    around = [brute_force(segments_of(name), discs, radius, x, y, angles + delta) for delta in (-2e-5, 0.0, 2e-5)]
    low, high = np.min(around, axis=0), np.max(around, axis=0)
    assert np.all(measured >= low - 1e-3) and np.all(measured <= high + 1e-3)


@pytest.mark.parametrize("heading", np.arange(4) * np.pi / 2)
@pytest.mark.parametrize(("x", "y"), [(0.0, 0.0), (-4.5, 1.25), (3.0, -4.9)])
def test_box_closed_form(x, y, heading):
    """Perpendicular beams read the distance to the wall, 45 degree ones sqrt(2) times the nearer of two."""
    right, left = -np.pi / 2, np.pi / 2
    to_wall = [5 - x, 5 - y, 5 + x, 5 + y]  # ahead for headings 0, 90, 180, 270 degrees
    quarter = round(heading / (np.pi / 2))
    ahead, to_left, to_right = (to_wall[(quarter + turn) % 4] for turn in (0, 1, 3))
    nothing = np.full((2, 1), 50.0, np.float32)
    measured = scan(0, x, y, heading, np.broadcast_to(nothing, (2, DISCS)), 0.2)
    diagonal = [np.sqrt(2) * min(ahead, to_right), np.sqrt(2) * min(ahead, to_left)]
    expected = np.minimum([to_right, diagonal[0], ahead, diagonal[1], to_left], RANGE)
    at = [round((angle - right) / (left - right) * (BEAMS - 1)) for angle in np.linspace(right, left, 5)]
    np.testing.assert_allclose(np.asarray(measured)[at], expected, atol=2e-5)


def test_disc_closed_form_and_what_is_behind():
    discs = np.array([[2.0, -2.0, 3.0], [0.0, 0.0, 0.0]], np.float32)  # ahead, behind, hidden by the first
    measured = np.asarray(scan(0, 0.0, 0.0, 0.0, discs, 0.2))
    assert measured[BEAMS // 2] == pytest.approx(1.8)
    seen = np.abs(np.linspace(-np.pi / 2, np.pi / 2, BEAMS)) < np.arcsin(0.1)
    assert np.all(measured[seen] < 2.0) and np.all(measured[~seen] >= 5.0 - 1e-5)


def test_from_within_a_disc_the_scan_is_that_of_the_walls():
    far = np.full((2, DISCS), 50.0, np.float32)
    around = far.copy()
    around[:, 0] = 0.05
    np.testing.assert_array_equal(scan(0, 0.0, 0.0, 0.3, around, 0.2), scan(0, 0.0, 0.0, 0.3, far, 0.2))


def test_scan_has_the_gradient_of_driving_toward_a_wall():
    far = jnp.full((2, DISCS), 50.0)
    gradient = jax.jit(jax.grad(lambda pose, weights, discs: jnp.sum(weights * scan(2, *pose, discs, 0.2))))
    ahead = gradient(jnp.array([0.0, 0.3, 0.0]), (np.arange(BEAMS) == BEAMS // 2).astype(np.float32), far)
    np.testing.assert_allclose(ahead, [-1.0, 0.0, 0.0], atol=1e-5)
    # On a corner of the walls, with a disc on top of the robot.
    on_corner = gradient(jnp.array([-1.3, -1.3, 0.0]), jnp.ones(BEAMS), jnp.full((2, DISCS), -1.3))
    assert np.all(np.isfinite(on_corner))


def test_noise_has_its_standard_deviation_and_dropout_share():
    params = Params(scan_noise_std=0.05, scan_dropout=0.1, scan_range=RANGE)
    noisy = np.asarray(lidar.add_noise(jax.random.key(1), jnp.full(200_000, 4.0), params))
    lost = noisy == RANGE
    assert lost.mean() == pytest.approx(0.1, abs=0.003)  # 4 standard errors
    assert noisy[~lost].std() == pytest.approx(0.05, rel=0.01)
    assert noisy[~lost].mean() == pytest.approx(4.0, abs=5e-4)
    z = (noisy[~lost] - 4.0) / 0.05
    assert (np.abs(z) > 1.96).mean() == pytest.approx(0.05, abs=0.003)
    assert np.corrcoef(noisy[:-1] * ~lost[:-1], noisy[1:] * ~lost[1:])[0, 1] == pytest.approx(0.0, abs=0.01)


def test_noise_leaves_a_miss_a_miss_and_stays_within_the_range():
    params = Params(scan_noise_std=0.5, scan_dropout=0.0, scan_range=RANGE)
    assert np.all(np.asarray(lidar.add_noise(jax.random.key(1), jnp.full(1000, RANGE), params)) == RANGE)
    close = np.asarray(
        lidar.add_noise(jax.random.key(1), jnp.concatenate([jnp.full(500, 0.1), jnp.full(500, 8.9)]), params)
    )
    assert close.min() == 0.0 and close.max() == RANGE


def test_observed_noise_depends_on_seed_and_time_alone(variant, situation):
    noisy = variant.observe
    params = Params(scan_range=3.0, scan_dropout=0.0)
    state = situation(robot=(3.5, 0.0, 0.0))
    scan = np.asarray(noisy(state, params).scan)
    np.testing.assert_array_equal(scan, noisy(state, params).scan)
    later, other = (noisy(state.replace(**change), params).scan for change in ({"t": 1}, {"seed": np.uint32(8)}))
    hit = scan < 3.0
    assert hit.any() and not hit.all()
    assert np.all(scan[hit] != np.asarray(later)[hit]) and np.all(scan[hit] != np.asarray(other)[hit])
    # Without noise the same beams miss.
    silent = noisy(state, params.replace(scan_noise_std=0.0)).scan
    np.testing.assert_array_equal(np.asarray(silent) == 3.0, ~hit)


def test_noise_is_independent_between_beams_steps_and_episodes(variant, situation):
    """Correlations of errors and of dropouts over 60 x 60 scans of a robot that stands: 0, give or take 4 sigma."""
    steps, seeds, params = np.arange(60, dtype=np.int32), np.arange(60, dtype=np.uint32), Params(scan_dropout=0.2)
    state = jax.tree.map(jnp.asarray, situation())

    @jax.jit
    @jax.vmap
    def scans(seed):
        return jax.vmap(lambda t: variant.world.observe(state.replace(t=t, seed=seed), params).scan)(steps)

    exact = variant.observe(state, params.replace(scan_noise_std=0.0, scan_dropout=0.0)).scan
    measured = np.asarray(scans(seeds))
    lost = measured == 12.0
    assert lost.mean() == pytest.approx(0.2, abs=0.002)
    errors = np.where(lost, 0.0, measured - exact)
    assert errors[~lost].std() == pytest.approx(0.01, rel=0.01)
    # Of one with another, either way: errors and dropouts of the next episode, step or beam.
    lost = lost - lost.mean()
    for one, other in ((errors, errors), (errors, lost), (lost, errors), (lost, lost)):
        for axis in range(3):
            count = one.shape[axis] - 1
            product = np.take(one, np.arange(count), axis) * np.take(other, np.arange(1, count + 1), axis)
            assert abs(product.mean() / (one.std() * other.std())) < 4 / np.sqrt(product.size)
