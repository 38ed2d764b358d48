"""The seven metrics against a plain count over recorded episodes."""

import jax
import numpy as np
import pytest

from jaxnav.statistics import wilson_interval
from jaxnav.training.evaluation import episode_keys
from jaxnav.world.types import AGREES, NONE, REFUSES, REQUESTS

EPISODES, SEED = 20, 5  # those of the fixture `talk`


@pytest.mark.parametrize(
    ("successes", "trials", "low", "high"),
    [
        (95, 100, 0.88825, 0.97846),  # statsmodels.stats.proportion.proportion_confint(95, 100, method="wilson")
        (81, 263, 0.2553, 0.3662),  # Newcombe 1998, Statistics in Medicine 17, table I
        (15, 148, 0.0624, 0.1605),  # likewise
        (0, 20, 0.0, 0.1611),  # likewise
        (1, 29, 0.0061, 0.1718),  # likewise
        (29, 29, 1 / (1 + 1.959964**2 / 29), 1.0),  # closed form of n of n
        (0, 500, 0.0, 1.959964**2 / (500 + 1.959964**2)),
        (0, 0, 0.0, 1.0),
    ],
)
def test_wilson_interval_is_the_published_one(successes, trials, low, high):
    assert wilson_interval(successes, trials) == pytest.approx([low, high], abs=5e-5)


def test_wilson_interval_is_symmetric_and_inside_the_unit_interval():
    for n in (1, 3, 500):
        for k in range(0, n + 1, max(1, n // 7)):
            low, high = wilson_interval(k, n)
            assert 0 <= low <= k / n + 1e-12 and k / n - 1e-12 <= high <= 1
            assert (low == 0, high == 1) == (k == 0, k == n)
            assert wilson_interval(n - k, n) == pytest.approx([1 - high, 1 - low])


@pytest.fixture(scope="module")
def result(evaluator, talker, talk):
    return evaluator.evaluate(talker(talk.actor), "last", talk.episodes, talk.seed)


def count(episodes, event):
    return sum(bool(getattr(episode.outcomes, event).any()) for episode in episodes) / len(episodes)


def mean(values):
    values = list(values)
    return sum(values) / len(values) if values else None


def arrived(episodes):
    return [episode for episode in episodes if episode.outcomes.arrived[-1]]


@pytest.mark.parametrize("scene", ["square", "hallway"])
def test_metrics_are_what_a_plain_count_gives(result, recorded, evaluator, talker, talk, scene):
    played, straight = ([e for e in of if e.scene == scene] for of in recorded.values())
    muted = evaluator.summaries(talker(talk.actor).muted(), EPISODES, SEED)
    muted = jax.tree.map(lambda leaf: leaf[evaluator.world.config.scenes.index(scene)], muted)
    metrics = result["scenes"][scene]
    expected = {
        "success": count(played, "arrived"),
        "success_ci95": wilson_interval(len(arrived(played)), EPISODES),
        "collision": count(played, "collided"),
        "human_collision": count(played, "hit_pedestrian"),
        "timeout": count(played, "truncated"),
        "steps": mean(len(e.outcomes.reward) for e in arrived(played)),
        "min_distance": mean(e.states.min_distance[-1] for e in arrived(played)),
        "comfort": float(np.mean(np.concatenate([e.outcomes.pedestrian_distance for e in played]) >= 0.5)),
        "straight_line_success": count(straight, "arrived"),
        "muted_success": muted.arrived.mean(),
        "muted_min_distance": mean(muted.min_distance[muted.arrived]),
    }
    said = [next((request for request in e.outcomes.requested if request), 0) for e in played]
    # A share of those who were asked and answered: some episodes end before the answer.
    answers = [e.outcomes.reply.max() for e in played]
    expected["complied"] = mean(float(answer == AGREES) for answer in answers if answer)
    assert metrics.pop("requests") == {name: said.count(request) / EPISODES for request, name in enumerate(REQUESTS)}
    assert metrics.keys() == expected.keys()
    for name, value in expected.items():
        assert metrics[name] == pytest.approx(value, abs=1e-5), name


def test_situations_are_worth_counting(recorded):
    events = ("arrived", "collided", "hit_pedestrian", "truncated")
    assert {0.0, 1.0}.isdisjoint(count(recorded["talker"], event) for event in events)
    replies = [episode.outcomes.reply.max() for episode in recorded["talker"]]
    assert set(replies) == {NONE, AGREES, REFUSES}


def test_outcomes_are_exclusive_and_human_collisions_are_collisions(evaluator, talker):
    for straight in (False, True):
        s = evaluator.summaries(talker(1.0), EPISODES, 1, straight=straight)
        np.testing.assert_array_equal(s.arrived.astype(int) + s.collided + s.truncated, 1)
        assert not (s.hit_pedestrian & ~s.collided).any()


def test_the_first_episodes_of_more_are_the_same(evaluator, talker, assert_same):
    few, more = (evaluator.summaries(talker(1.0), n, 3) for n in (5, EPISODES))
    assert few.steps.shape == (2, 5)
    assert_same(few, jax.tree.map(lambda leaf: leaf[:, :5], more))
    other = evaluator.summaries(talker(1.0), EPISODES, 4)
    assert (other.min_distance != more.min_distance).all()


def test_episodes_of_evaluation_are_those_of_no_training(evaluator):
    """Neither the key of a training run nor what is folded or split from it plays an evaluation episode."""
    keys = {tuple(data) for data in jax.random.key_data(episode_keys(0, np.arange(50))).tolist()}
    base = jax.random.key(0)
    others = [base[None], jax.random.split(base, 50), jax.vmap(lambda i: jax.random.fold_in(base, i))(np.arange(50))]
    assert len(keys) == 50
    assert keys.isdisjoint(tuple(data) for other in others for data in jax.random.key_data(other).tolist())


def test_the_muted_robot_never_asks_and_the_straight_one_neither(evaluator, talker):
    policy = talker(1.0)
    assert (evaluator.summaries(policy, EPISODES, SEED).request > 0).any()
    for robot, straight in ((policy.muted(), False), (policy, True)):
        summary = evaluator.summaries(robot, EPISODES, SEED, straight)
        assert not summary.request.any() and not summary.agreed.any()


def test_success_during_training_is_the_mean_of_one_block(evaluator, talker):
    arrived = evaluator.summaries(talker(1.0), 8, 2**31).arrived
    assert evaluator.success(talker(1.0), 2**31) == {"square": arrived[0].mean(), "hallway": arrived[1].mean()}


def test_nothing_to_average_is_none_not_nan(evaluator, talker):
    still = evaluator.evaluate(talker(-1.0), "last", 4, 0)["scenes"]["hallway"]
    assert still["success"] == 0.0
    assert still["steps"] is None and still["min_distance"] is None


def test_evaluation_has_exactly_the_keys_of_the_contract(evaluator, talker):
    result = evaluator.evaluate(talker(1.0), "best", 4, 9)
    assert list(result) == ["policy", "episodes", "seed", "wall_seconds", "scenes"]
    assert (result["policy"], result["episodes"], result["seed"]) == ("best", 4, 9)
    assert list(result["scenes"]) == ["square", "hallway"]
    for metrics in result["scenes"].values():
        assert set(metrics) == {
            "success", "success_ci95", "collision", "human_collision", "timeout", "steps", "min_distance", "comfort",
            "straight_line_success", "muted_success", "muted_min_distance", "requests", "complied",
        }  # fmt: skip
        assert tuple(metrics["requests"]) == REQUESTS
        assert sum(metrics["requests"].values()) == pytest.approx(1)
        assert len(metrics["success_ci95"]) == 2
