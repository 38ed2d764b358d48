"""The reward term by term: the arithmetic, and the situations of a step that lead to each."""

import jax
import numpy as np
import pytest

from jaxnav.world import REWARDS, Params, StepEvents, World, WorldConfig, register_reward
from jaxnav.world.types import LEFT, NONE, RIGHT, STOP

PARAMS = Params()
NOTHING = dict.fromkeys(("goal", "shaping", "step", "closeness", "request", "response"), 0.0)


def events(**happened):
    """Nothing but what is given; nobody near."""
    false = dict.fromkeys(("arrived", "collided", "hit_pedestrian", "fits", "follows"), np.bool_(False))
    zero = dict.fromkeys(("progress", "goal_distance", "requested", "v", "w"), 0.0)
    return StepEvents(**false | zero | {"distance": 9.0, "min_distance": 9.0} | happened)


def terms_of(outcome):
    return {name: float(value) for name, value in outcome.reward_terms.items()}


@pytest.mark.parametrize(
    ("kind", "arrived", "collided", "expected"),
    [
        ("authors-code", False, False, {"shaping": 20.0, "step": -5.0, "closeness": -20.0}),
        ("authors-code", True, False, {"goal": 500.0, "closeness": -20.0}),
        ("authors-code", False, True, {"goal": -500.0}),
        ("paper-text", False, False, {"shaping": 20.0, "step": -5.0}),
        ("paper-text", True, False, {"goal": 500.0, "shaping": 20.0, "step": -5.0, "closeness": -35.0}),
        ("paper-text", False, True, {"goal": -500.0, "shaping": 20.0, "step": -5.0}),
    ],
)
def test_events_of_both_kinds_of_reward(kind, arrived, collided, expected):
    """0.1 m of progress, 0.6 m from a pedestrian, 0.3 m at the nearest of the episode."""
    happened = events(
        arrived=np.bool_(arrived), collided=np.bool_(collided), progress=0.1, distance=0.6, min_distance=0.3
    )
    terms = REWARDS[kind](happened, PARAMS)
    assert {name: float(value) for name, value in terms.items()} == pytest.approx(NOTHING | expected)


@pytest.mark.parametrize(("distance", "expected"), [(1.2, 0.0), (1.0, 0.0), (0.75, -12.5), (0.0, -50.0), (-0.1, -50.0)])
def test_closeness(distance, expected):
    terms = REWARDS["authors-code"](events(distance=distance), PARAMS)
    assert float(terms["closeness"]) == pytest.approx(expected)


@pytest.mark.parametrize(("fits", "follows"), [(True, False), (False, True), (True, True)])
def test_interaction_pays_once_each(fits, follows):
    terms = REWARDS["authors-code"](events(fits=fits, follows=follows), PARAMS)
    assert (float(terms["request"]), float(terms["response"])) == (20.0 * fits, 4.0 * follows)


def test_driving_toward_the_goal_pays_for_the_progress_less_the_time(default, situation, action):
    _, outcome = default.act(situation(), action(v=0.5))
    assert terms_of(outcome) == pytest.approx(NOTHING | {"shaping": 200 * 0.5 * 0.4, "step": -5.0}, abs=1e-3)
    _, outcome = default.act(situation(robot=(0, 0, np.pi)), action(v=0.5))
    assert terms_of(outcome)["shaping"] == pytest.approx(-200 * 0.5 * 0.4, abs=1e-3)


def test_closeness_counts_the_nearest_moment_within_the_step(default, situation, action):
    """Two pass each other in the step: 0.7 m between lines, so 0.43 m at the closest, farther before and after."""
    state = situation(twist=(0.6, 0.0), pedestrians=[(0.22, 0.7, -4.5, 0.7)], met=True)
    _, outcome = default.act(state, action(v=0.6), PARAMS.replace(awareness=0.0))
    assert float(outcome.pedestrian_distance) == pytest.approx(0.43, abs=1e-4)
    assert terms_of(outcome)["closeness"] == pytest.approx(-50 * 0.57, abs=1e-2)


def test_arrival_replaces_shaping_and_step(default, situation, action):
    _, outcome = default.act(situation(goal=(0.5, 0.0)), action(v=0.6))
    assert terms_of(outcome) == pytest.approx(NOTHING | {"goal": 500.0})
    assert (outcome.arrived.item(), outcome.terminated.item()) == (True, True)


@pytest.mark.parametrize(
    ("robot", "goal", "pedestrian"),
    [
        ((0.0, 0.0, 0.0), (4.5, 0.0), (0.45, 0.0, -4.5, 0.0)),
        ((4.7, 0.0, 0.0), (-4.5, 0.0), (-4.0, 4.0, -4.0, 4.0)),
        # In contact at the start of the step, when the goal is within its tolerance, too.
        ((0.2, 0.0, 0.0), (0.3, 0.0), (0.45, 0.0, -4.5, 0.0)),
        ((4.85, 0.0, 0.0), (4.8, 0.0), (-4.0, 4.0, -4.0, 4.0)),
    ],
    ids=["pedestrian", "wall", "pedestrian at the goal", "wall at the goal"],
)
def test_collision_costs_500_and_nothing_else(default, situation, action, robot, goal, pedestrian):
    state = situation(robot=robot, goal=goal, pedestrians=[pedestrian])
    _, outcome = default.act(state, action(v=0.6), PARAMS.replace(awareness=0.0))
    assert terms_of(outcome) == pytest.approx(NOTHING | {"goal": -500.0})
    assert (outcome.collided.item(), outcome.arrived.item(), outcome.terminated.item()) == (True, False, True)


def test_a_time_out_is_rewarded_as_any_step(default, situation, action):
    _, outcome = default.act(situation(t=99), action(v=0.5))
    assert terms_of(outcome) == pytest.approx(NOTHING | {"shaping": 40.0, "step": -5.0}, abs=1e-3)
    assert (outcome.truncated.item(), outcome.terminated.item()) == (True, False)


@pytest.mark.parametrize(
    ("pedestrian", "asked", "pays"),
    [
        ((2.5, 0.3, -4.5, 0.3), RIGHT, True),
        ((2.5, 0.3, -4.5, 0.3), LEFT, False),
        ((2.5, 0.3, -4.5, 0.3), STOP, False),
        ((2.5, 0.3, -4.5, 0.3), NONE, False),
        ((2.5, -0.3, -4.5, -0.3), LEFT, True),
        ((2.0, 2.0, 2.0, -4.5), STOP, True),
        ((2.0, 2.0, 2.0, -4.5), LEFT, False),
    ],
)
def test_a_request_pays_once_if_it_fits(default, situation, action, pedestrian, asked, pays):
    state = situation(pedestrians=[pedestrian], is_open=True, met=True, distance=3.0)
    state, outcome = default.act(state, action(request=asked))
    assert terms_of(outcome)["request"] == 20.0 * pays
    _, outcome = default.act(state, action(request=asked))
    assert terms_of(outcome)["request"] == 0.0


def test_a_request_that_does_not_count_does_not_pay(default, situation, action):
    state = situation(pedestrians=[(2.5, 0.3, -4.5, 0.3)])
    assert terms_of(default.act(state, action(request=RIGHT))[1])["request"] == 0.0


@pytest.mark.parametrize(
    ("message", "y", "v", "w", "pays"),
    [
        (STOP, 0.0, 0.15, 0.9, True),
        (STOP, 0.0, 0.16, -0.9, False),
        (RIGHT, 0.0, 0.6, -0.1, True),
        (RIGHT, 0.0, 0.0, 0.1, False),
        (RIGHT, -0.29, 0.0, 0.0, False),
        (RIGHT, -0.31, 0.0, 0.1, True),
        (RIGHT, 0.31, 0.0, 0.0, False),
        (LEFT, 0.0, 0.6, 0.1, True),
        (LEFT, 0.29, 0.0, 0.0, False),
        (LEFT, 0.31, 0.0, -0.1, True),
        (LEFT, -0.31, 0.0, 0.0, False),
        (NONE, 0.0, 0.0, 0.0, False),
    ],
)
def test_a_robot_that_does_what_it_was_asked_is_paid_every_step(default, situation, action, message, y, v, w, pays):
    """Its line runs along x through the origin; it stands y to the left of it."""
    state = situation(
        robot=(0.0, y, 0.0), pedestrians=[(2.5, 0.0, -4.5, 0.0)], is_open=True, met=True, pedestrian_first=True,
        message=message, distance=3.0, x=2.5, ux=-1.0, robot_ux=1.0,
    )  # fmt: skip
    _, outcome = default.act(state, action(v, w))
    assert terms_of(outcome)["response"] == 4.0 * pays
    closed = state.replace(encounters=state.encounters.replace(is_open=np.zeros(1, bool)))
    assert terms_of(default.act(closed, action(v, w))[1])["response"] == 0.0


def test_the_terms_add_up_to_the_reward(random_episodes):
    outcomes = random_episodes[1]
    total = sum(np.asarray(term, np.float64) for term in outcomes.reward_terms.values())
    np.testing.assert_allclose(outcomes.reward, total, atol=1e-3)
    assert all(np.any(term != 0) for term in outcomes.reward_terms.values())


def test_parameters_scale_their_terms(default, situation, action):
    """Each weight reaches its term: doubled, the term doubles, and the others stay."""
    near = situation(pedestrians=[(2.0, 0.6, -4.5, 0.6)], is_open=True, met=True, distance=3.0, goal=(3.0, 0.0))
    near = near.replace(robot=near.robot.replace(x=np.float32(1.5)))
    act = action(v=0.3, request=RIGHT)
    once = terms_of(default.act(near, act)[1])
    for name in ("progress", "step", "closeness", "request"):
        field = {"progress": "shaping"}.get(name, name)
        twice = default.act(near, act, PARAMS.replace(**{f"reward_{name}": 2 * getattr(PARAMS, f"reward_{name}")}))[1]
        assert once[field] != 0
        assert terms_of(twice) == pytest.approx(once | {field: 2 * once[field]})


def _speed(happened, params):
    return {"speed": happened.v / params.max_v, "end": -1.0 * happened.collided}


def _raises(happened, params):
    raise RuntimeError("no money\nleft")


@pytest.mark.parametrize(
    ("reward", "says"),
    [
        (3, "3, a int"),
        (lambda happened: {}, "doesn't take two arguments"),
        (lambda happened, params: happened.v, "returns a"),
        (lambda happened, params: {}, "returns a dict"),
        (lambda happened, params: {"speed": np.zeros(2)}, r"term 'speed' is \w+ \[2\]"),
        (lambda happened, params: {"speed": happened.arrived}, "term 'speed' is bool"),
        (lambda happened, params: {"speed": happened.speed}, "raises AttributeError"),
        (_raises, r"_raises, which raises RuntimeError \(no money\)"),
    ],
)
def test_a_reward_that_is_none_is_refused_in_one_line(reward, says):
    with pytest.raises(ValueError, match=rf"^world\.reward is .*{says}.*: give a function .*terms$"):
        World(reward=reward)


def test_a_reward_of_ones_own_has_terms_of_its_own(situation, action):
    world = World(WorldConfig(), reward=_speed)
    state, act = situation(), action(v=0.3)
    _, outcome = jax.jit(world.step)(jax.random.key(0), state, act, PARAMS)
    assert {name: float(value) for name, value in outcome.reward_terms.items()} == pytest.approx(
        {"speed": 0.5, "end": 0.0}, abs=1e-6
    )
    assert float(outcome.reward) == pytest.approx(0.5)


def test_rewards_are_registered_once_each():
    register_reward("test-speed", _speed)
    try:
        assert register_reward("test-speed", _speed) is _speed
        World(WorldConfig(reward="test-speed"))
        with pytest.raises(ValueError, match=r"reward 'test-speed' is registered twice: give"):
            register_reward("test-speed", _raises)
        with pytest.raises(ValueError, match=r"world\.reward is three, a int: give a function"):
            register_reward("three", 3)
    finally:
        del REWARDS["test-speed"]
    with pytest.raises(ValueError, match=r"world\.reward is 'test-speed': choose authors-code, paper-text"):
        World(WorldConfig(reward="test-speed"))
