"""The hard suite: who is there, where they start, and what the robot is given of them."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxnav.world import SCENES, SUITES, Params, World, WorldConfig, default_params
from jaxnav.world.types import LEFT

NAMES = (*SUITES["hard"], *SUITES["hard-laser"])
PARAMS = default_params(NAMES)
EPISODES = 2048


@pytest.fixture(scope="module")
def world():
    """All eight scenes, their largest crowd."""
    return World(WorldConfig(scenes=NAMES, pedestrians=8))


@pytest.fixture(scope="module")
def starts(world):
    """First states of the scene of that name, `[EPISODES]`."""
    resets = jax.jit(jax.vmap(world.reset, in_axes=(0, None, None)))
    keys = jax.random.split(jax.random.key(0), EPISODES)
    states = {name: jax.device_get(resets(keys, PARAMS, jnp.int32(i))) for i, name in enumerate(NAMES)}
    return states.__getitem__


def clearance(name, x, y):
    """float64 distance of points to the nearest wall of a scene."""
    points = np.stack([x, y], axis=-1).astype(np.float64)
    best = np.full(points.shape[:-1], np.inf)
    for a, b in edges(name):
        t = np.clip((points - a) @ (b - a) / ((b - a) @ (b - a)), 0, 1)[..., None]
        best = np.minimum(best, np.linalg.norm(points - a - t * (b - a), axis=-1))
    return best


def edges(name):
    for chain in SCENES[name].chains:
        yield from zip(np.array(chain), np.array([*chain[1:], chain[0]]), strict=True)


def inside(name, x, y):
    """Whether points lie in free space, by how many walls a ray to the right crosses: an odd number."""
    crossings = np.zeros(np.shape(x), int)
    for (ax, ay), (bx, by) in edges(name):
        between = (ay > y) != (by > y)
        crossings += between & (x < ax + (np.where(between, y, ay) - ay) * (bx - ax) / np.where(ay == by, 1, by - ay))
    return crossings % 2 == 1


@pytest.mark.parametrize("name", NAMES)
def test_starts_way_points_and_goals_are_in_free_space_with_clearance(name, starts):
    state = starts(name)
    robot, people = state.robot, state.pedestrians
    there = people.present
    for x, y in (
        (robot.x, robot.y), (robot.goal_x, robot.goal_y), (people.x[there], people.y[there]),
        (people.via_x[there], people.via_y[there]), (people.goal_x[there], people.goal_y[there]),
    ):  # fmt: skip
        assert np.all(inside(name, x, y))
        assert clearance(name, x, y).min() >= 0.3 - 1e-4
    gap = np.hypot(people.x - robot.x[:, None], people.y - robot.y[:, None])
    assert gap[there].min() >= 1.5 - 1e-4


@pytest.mark.parametrize("name", NAMES)
def test_people_start_apart_from_each_other(name, starts):
    people = starts(name).pedestrians
    gaps = np.hypot(people.x[:, :, None] - people.x[:, None], people.y[:, :, None] - people.y[:, None])
    both = people.present[:, :, None] & people.present[:, None] & ~np.eye(8, dtype=bool)
    assert np.min(gaps, initial=np.inf, where=both) >= 0.6 - 1e-4


@pytest.mark.parametrize("name", NAMES)
def test_crowds(name, starts):
    """Four to eight walkers in crossflow, each as often as the others; one elsewhere, in the first slot."""
    present = starts(name).pedestrians.present
    counts = np.bincount(present.sum(axis=1), minlength=9)
    sizes = range(4, 9) if name.startswith("crossflow") else (1,)
    assert counts.sum() == counts[list(sizes)].sum()
    # 3.5 standard deviations.
    share = 1 / len(sizes)
    np.testing.assert_allclose(
        counts[list(sizes)] / EPISODES, share, atol=3.5 * np.sqrt(share * (1 - share) / EPISODES)
    )
    np.testing.assert_array_equal(present, np.arange(8) < present.sum(axis=1, keepdims=True))


def test_a_crowd_of_crossflow_walks_to_and_fro_at_right_angles_to_the_robot(starts):
    people, robot = starts("crossflow").pedestrians, starts("crossflow").robot
    there = people.present
    np.testing.assert_allclose(people.goal_x[there], people.x[there], atol=1e-5)
    np.testing.assert_allclose(np.abs(people.goal_y[there]), 3.4, atol=1e-5)
    np.testing.assert_allclose(people.vx[there], 0.0, atol=1e-5)
    assert np.all(np.abs(robot.goal_x - robot.x) > 8)
    # Both ways.
    assert np.mean(people.vy[there] > 0) == pytest.approx(0.5, abs=0.05)


def test_passages_lie_between_start_and_goal(starts):
    """A door is passed from one side to the other, a corner from one arm to the other, also by the pedestrian."""
    for name in ("doorway", "doorway-laser"):
        state = starts(name)
        assert np.all(np.sign(state.robot.x) == -np.sign(state.robot.goal_x))
        assert np.all(np.sign(state.robot.x) == -np.sign(state.pedestrians.x[:, 0]))
    for name in ("corner", "corner-laser"):
        robot = starts(name).robot
        assert np.all((robot.x < -0.9) ^ (robot.y > 0.9))
        assert np.all((robot.x < -0.9) ^ (robot.goal_x < -0.9))
        assert np.mean(robot.x < -0.9) == pytest.approx(0.5, abs=0.05)


def sees(name, x, y, to_x, to_y):
    """Whether the straight way between two points crosses no wall; float64, parametric."""
    clear = np.ones(np.shape(x), bool)
    dx, dy = to_x - x, to_y - y
    for (ax, ay), (bx, by) in edges(name):
        ex, ey = bx - ax, by - ay
        determinant = dx * ey - dy * ex
        safe = np.where(determinant == 0, 1.0, determinant)
        along = ((ax - x) * ey - (ay - y) * ex) / safe
        across = ((ax - x) * dy - (ay - y) * dx) / safe
        clear &= ~((determinant != 0) & (along > 0) & (along < 1) & (across >= 0) & (across <= 1))
    return clear


@pytest.mark.parametrize("name", ["corner", "corner-laser"])
def test_around_the_corner_neither_sees_the_other_at_the_start(name, starts):
    state = starts(name)
    ends = state.robot.x, state.robot.y, state.pedestrians.x[:, 0], state.pedestrians.y[:, 0]
    assert not np.any(sees(name, *(end.astype(np.float64) for end in ends)))


@pytest.fixture(scope="module")
def watch(world):
    return jax.jit(world.observe)


def met(starts, name, distance=0.6):
    """A state of the scene in which the first pedestrian stands on the robot's way, speaking."""
    state = jax.tree.map(lambda leaf: leaf[0], starts(name))
    robot, people = state.robot, state.pedestrians
    at = np.arange(8) == 0
    x, y = (getattr(robot, k) + distance * f(robot.heading) for k, f in (("x", np.cos), ("y", np.sin)))
    people = people.replace(x=np.where(at, x, people.x), y=np.where(at, y, people.y))
    said = state.encounters.replace(
        is_open=at, met=at, pedestrian_first=at, message=np.where(at, LEFT, 0).astype(np.int32),
        utterance=np.where(at, 7, 0).astype(np.uint32),
    )  # fmt: skip
    return state.replace(pedestrians=people, encounters=said)


@pytest.mark.parametrize("name", SUITES["hard"])
def test_the_laser_twin_gives_nobody_but_scans_and_hears_everybody(name, watch, starts):
    state = met(starts, name)
    twin = state.replace(scene=np.int32(NAMES.index(f"{name}-laser")))
    given, scanned = watch(state, PARAMS), watch(twin, PARAMS)
    assert given.seen[0]
    np.testing.assert_allclose(given.pedestrians[0, :2], [0.6, 0.0], atol=1e-4)
    assert not np.any(scanned.seen)
    assert not np.any(scanned.pedestrians)
    np.testing.assert_array_equal(scanned.scan, given.scan)
    assert np.min(scanned.scan[80:100]) == pytest.approx(0.6 - PARAMS.body_radius, abs=0.01)
    jax.tree.map(np.testing.assert_array_equal, scanned.dialogue, given.dialogue)
    assert scanned.dialogue.message[0] == LEFT


def test_twins_are_the_same_but_for_what_is_given():
    for name in SUITES["hard"]:
        one, twin = SCENES[name], SCENES[f"{name}-laser"]
        assert (one.chains, one.floors, one.meet, one.crowd, one.params) == (
            twin.chains, twin.floors, twin.meet, twin.crowd, twin.params,
        )  # fmt: skip
        assert one.sight in ("all", "line") and twin.sight == "none"


def test_suites():
    assert SUITES["parity"] == ("square", "hallway", "crosswalk")
    assert SUITES["hard"] == ("narrow", "doorway", "corner", "crossflow")
    assert SUITES["hard-laser"] == ("narrow-laser", "doorway-laser", "corner-laser", "crossflow-laser")
    assert {name for suite in SUITES.values() for name in suite} == set(SCENES)


def test_default_params_are_those_of_the_people_of_the_scenes():
    assert default_params(SUITES["parity"]) == Params()
    for name in NAMES:
        params = default_params((name,))
        assert params == PARAMS
        assert (params.preferred_speed, params.max_speed, params.body_radius) == (1.2, 1.2, 0.2)
        assert (params.p_decides_late, params.neighbor_distance, params.obey_steps) == (1.0, 1.5, 40.0)
    with pytest.raises(ValueError, match=r"world\.scenes mixes square and narrow.*choose scenes of one suite"):
        default_params(("square", "narrow"))
    with pytest.raises(ValueError, match="'moon'"):
        default_params(("moon",))


def test_crowds_that_find_no_place_are_refused_by_name_and_number():
    with pytest.raises(ValueError, match=r"world\.pedestrians is 3: scene crossflow needs at least 4"):
        World(WorldConfig(scenes=("narrow", "crossflow"), pedestrians=3))
    World(WorldConfig(scenes=("narrow", "crossflow"), pedestrians=4))
    with pytest.raises(ValueError, match=r"world\.pedestrians is 65: give a whole number from 1 to 64"):
        WorldConfig(pedestrians=65)
    WorldConfig(pedestrians=64)
