"""The world as a whole: events, determinism, gradients, no retracing, and errors that name what is wrong."""

import jax
import numpy as np
import pytest

from jaxnav.world import Action, Params, World, WorldConfig, check_params
from jaxnav.world.config import OBSERVATION_PARTS

OBLIVIOUS = Params(awareness=0.0)


def flags(outcome):
    return {
        name
        for name in ("arrived", "collided", "hit_pedestrian", "terminated", "truncated")
        if getattr(outcome, name).item()
    }


WALL = {"robot": (4.7, 0.0, 0.0)}  # touches the wall after 0.13 m of 0.24 m


@pytest.mark.parametrize(
    ("built", "swept", "at_the_end"),
    [
        # The goal is reached after 0.1 m; a standing pedestrian after 0.05 or 0.18 m.
        ({"goal": (0.4, 0.0), "pedestrians": [(0.32, 0.0, 0.32, 0.0)]}, "pedestrian", "arrived"),
        ({"goal": (0.4, 0.0), "pedestrians": [(0.45, 0.0, 0.45, 0.0)]}, "arrived", "arrived"),
        # Passing at 0.25 m between centres in the middle of the step, 0.33 m at its ends.
        ({"pedestrians": [(0.22, 0.25, -4.5, 0.25)]}, "pedestrian", None),
        ({"pedestrians": [(0.22, 0.28, -4.5, 0.28)]}, None, None),
        # The goal's disc is crossed within the step: 0.29 m beside the path, more at its ends.
        ({"goal": (0.12, 0.29)}, "arrived", "arrived"),
        (WALL | {"goal": (5.1, 0.0)}, "arrived", "arrived"),
        (WALL | {"goal": (5.2, 0.0)}, "wall", "arrived"),
        (WALL | {"goal": (-4.0, 0.0), "pedestrians": [(5.05, 0.0, 5.05, 0.0)]}, "pedestrian", "pedestrian"),
        (WALL | {"goal": (-4.0, 0.0), "pedestrians": [(5.15, 0.0, 5.15, 0.0)]}, "wall", "pedestrian"),
        ({}, None, None),
    ],
    ids=[
        "pedestrian before the goal", "goal before the pedestrian", "graze", "miss", "goal in passing",
        "goal before the wall", "wall before the goal", "pedestrian before the wall", "wall before the pedestrian",
        "nothing",
    ],
)  # fmt: skip
def test_the_earliest_event_of_a_step_wins(default, variant, situation, action, built, swept, at_the_end):
    """Tested over the whole step; or contacts at its end only, so that a goal reached within the step comes first."""
    expected = {
        None: set(),
        "arrived": {"arrived", "terminated"},
        "wall": {"collided", "terminated"},
        "pedestrian": {"collided", "hit_pedestrian", "terminated"},
    }
    for world, event in ((default, swept), (variant, at_the_end)):
        _, outcome = world.act(situation(met=True, **built), action(v=0.6), OBLIVIOUS)
        assert flags(outcome) == expected[event]


def test_the_swept_distance_is_that_of_the_nearest_moment(default, variant, situation, action):
    state = situation(pedestrians=[(0.22, 0.6, -4.5, 0.6)], met=True)
    nearest = [world.act(state, action(v=0.6), OBLIVIOUS)[1].pedestrian_distance.item() for world in (default, variant)]
    assert nearest == pytest.approx([0.6 - 0.27, np.hypot(0.22, 0.6) - 0.27], abs=1e-4)


@pytest.mark.parametrize(("t", "goal", "expected"), [
    (98, (4.0, 0.0), set()), (99, (4.0, 0.0), {"truncated"}), (99, (0.5, 0.0), {"arrived", "terminated"}),
])  # fmt: skip
def test_running_out_of_time_truncates_unless_the_episode_ends_otherwise(default, situation, action, t, goal, expected):
    state, outcome = default.act(situation(t=t, goal=goal), action(v=0.6))
    assert flags(outcome) == expected
    assert state.t == t + 1


def test_every_episode_ends_in_exactly_one_way(random_episodes):
    states, outcomes = random_episodes
    assert np.all(outcomes.terminated == (outcomes.arrived | outcomes.collided))
    assert not np.any(outcomes.arrived & outcomes.collided)
    assert not np.any(outcomes.hit_pedestrian & ~outcomes.collided)
    assert not np.any(outcomes.truncated & outcomes.terminated)
    out_of_time = states.t[1:] >= 50
    assert np.all(outcomes.truncated == (out_of_time & ~outcomes.terminated))
    ended = np.argmax(outcomes.terminated | outcomes.truncated, axis=0)
    assert ended.max() == 49
    ways = np.stack(
        [getattr(outcomes, name)[ended, np.arange(ended.size)] for name in ("arrived", "collided", "truncated")]
    )
    assert np.all(ways.sum(axis=0) == 1)
    assert np.all(ways.any(axis=1))


def test_distances_are_those_of_the_bodies(random_episodes):
    """The swept distance is at most that at the end of the step, and the minimum is kept in the state."""
    states, outcomes = random_episodes
    gap = np.hypot(
        states.pedestrians.x[..., 0] - states.robot.x, states.pedestrians.y[..., 0] - states.robot.y
    ) - 0.27  # fmt: skip
    assert np.all(outcomes.pedestrian_distance <= np.minimum(gap[1:], gap[:-1]) + 1e-4)
    assert np.all(outcomes.pedestrian_distance >= np.minimum(gap[1:], gap[:-1]) - 0.22 - 1e-4)  # half of 0.44 m
    lowest = np.minimum.accumulate(np.concatenate([gap[:1], outcomes.pedestrian_distance]), axis=0)
    np.testing.assert_allclose(states.min_distance, lowest, atol=1e-4)
    goal = np.hypot(states.robot.goal_x - states.robot.x, states.robot.goal_y - states.robot.y)[1:]
    np.testing.assert_allclose(outcomes.goal_distance, goal, atol=1e-4)


def test_steps_are_deterministic_and_their_key_only_words_what_is_said(default, situation, action):
    params = Params(small_talk=1.0)
    state = situation(pedestrians=[(2.8, 0.0, -4.5, 0.0)])
    one, again = (default.step(jax.random.key(1), state, action(0.3, 0.3), params) for _ in range(2))
    jax.tree.map(np.testing.assert_array_equal, one, again)
    other = default.step(jax.random.key(2), state, action(0.3, 0.3), params)
    assert one[0].encounters.utterance != other[0].encounters.utterance
    worded = [
        (state.replace(encounters=state.encounters.replace(utterance=0)), outcome) for state, outcome in (one, other)
    ]
    jax.tree.map(np.testing.assert_array_equal, *worded)


def test_resets_are_deterministic_and_differ_by_key(default):
    keys = jax.random.split(jax.random.key(1), 2048).at[1].set(jax.random.key(9)).at[0].set(jax.random.key(9))
    state = jax.tree.map(np.asarray, default.resets(keys, Params(), np.zeros(2048, np.int32)))
    for leaf in jax.tree.leaves((state.robot, state.pedestrians, state.traits, state.seed)):
        assert np.array_equal(leaf[0], leaf[1])
    assert np.unique(state.robot.x).size > 2000
    assert np.unique(state.seed).size > 2000


def test_a_reset_draws_its_scene_evenly():
    """Where no scene is named. Only the draw is kept by the compiler, so that this is cheap."""
    world = World()
    keys = jax.random.split(jax.random.key(0), 3000)
    drawn = jax.jit(jax.vmap(lambda key: world.reset(key, Params()).scene))(keys)
    assert np.bincount(drawn) / 3000 == pytest.approx([1 / 3] * 3, abs=0.04)


def test_steps_are_traced_once(default, situation, action):
    """Built states and those that a step or a reset returns, other scenes, other parameters: `default.step` counts."""
    for scene in range(3):
        state, _ = default.act(situation(scene=scene, t=7), action(0.5, request=1), Params(max_v=0.4, dt=0.2))
        state, _ = default.act(state, action(0.1), Params(compliance=0.0))
    kinds = [
        [(leaf.shape, leaf.dtype, leaf.weak_type) for leaf in jax.tree.leaves(state)]
        for state in (jax.eval_shape(default.world.reset, jax.random.key(0), Params()), state)
    ]
    assert kinds[0] == kinds[1]


@pytest.mark.parametrize(
    ("field", "value", "remedy"),
    [
        ("dt", float("nan"), "above 0"),
        ("reward_step", float("inf"), "finite"),
        ("robot_radius", -0.17, "above 0"),
        ("robot_radius", 0.0, "above 0"),
        ("body_radius", -0.1, "at least 0"),
        ("goal_tolerance", -0.3, "at least 0"),
        ("preferred_speed", -0.5, "at least 0"),
        ("max_steps", 0.0, "above 0"),
        ("p_pedestrian_first", 1.5, "0 to 1"),
        ("compliance", -0.1, "0 to 1"),
        ("scan_dropout", 2.0, "0 to 1"),
        ("message_exceptions", 1.01, "0 to 1"),
        ("small_talk", -1.0, "0 to 1"),
    ],
)
def test_params_out_of_range_are_refused_by_name_value_and_range(field, value, remedy):
    params = Params(**{field: value})
    with pytest.raises(ValueError, match=rf"{field} is {value}.*{remedy}"):
        World().reset(jax.random.key(0), params)
    with pytest.raises(ValueError, match=field):  # one of a batch
        check_params(params.replace(**{field: np.array([getattr(Params(), field), value])}))


@pytest.mark.parametrize("scene", [3, 7, -1, np.int32(3)])
def test_a_scene_out_of_range_is_refused(scene):
    with pytest.raises(ValueError, match=rf"scene is {scene}: give an index into world\.scenes, 0 to 2"):
        World().reset(jax.random.key(0), Params(), scene)


def test_params_within_their_range_pass_and_so_do_traced_ones():
    check_params(Params(compliance=0.0, small_talk=1.0, awareness=0.0, preferred_speed=0.0, reward_step=5.0))
    jax.eval_shape(check_params, Params(dt=-1.0))


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("pedestrians", 0), ("pedestrians", 1.5), ("nearest", 0), ("beams", 1), ("beams", True), ("wall_neighbors", -1),
        ("max_neighbors", 0), ("scan_delay", -1), ("control_delay", 0.5),
        ("observation", ("scan", "smell")), ("reward", 3), ("scenes", ()),
        ("scenes", ["square"]), ("scenes", "square"), ("observation", ["scan"]), ("observation", "scan"),
    ],
)  # fmt: skip
def test_config_errors_name_the_field(field, value):
    with pytest.raises(ValueError, match=rf"world\.{field}"):
        WorldConfig(**{field: value})


@pytest.mark.parametrize("pedestrians", [1, 6])
def test_no_axis_is_added_silently(pedestrians):
    """The code is for one episode: an axis that broadcasting adds by itself is a mistake here."""
    world = World(WorldConfig(pedestrians=pedestrians, observation=OBSERVATION_PARTS, scan_noise=True))
    with jax.numpy_rank_promotion("raise"):
        state = jax.eval_shape(world.reset, jax.random.key(0), Params())
        action = Action(twist=jax.ShapeDtypeStruct((2,), float), request=jax.ShapeDtypeStruct((), int))
        jax.eval_shape(world.step, jax.random.key(0), state, action, Params())
        jax.eval_shape(world.observe, state, Params())
