"""Playing and recording the same episodes."""

import jax
import numpy as np
import pytest

from jaxnav.world.types import AGREES, NONE


@pytest.fixture(scope="module")
def summary(evaluator, talker, talk):
    """What `play` made of the recorded episodes, in their order: leaves `[episodes]`."""
    summaries = evaluator.summaries(talker(talk.actor), talk.episodes, talk.seed)
    return jax.tree.map(np.ravel, summaries)


def test_recorded_episodes_begin_at_reset_and_stop_at_their_end(recorded, talk):
    recorded = recorded["talker"]
    assert [episode.scene for episode in recorded] == ["square"] * talk.episodes + ["hallway"] * talk.episodes
    for episode in recorded:
        ended = episode.outcomes.terminated | episode.outcomes.truncated
        n = len(ended)
        assert ended[-1] and not ended[:-1].any()
        np.testing.assert_array_equal(episode.states.t, np.arange(n + 1))
        assert all(len(leaf) == n + 1 for leaf in jax.tree.leaves(episode.states))
        assert all(len(leaf) == n for leaf in jax.tree.leaves(episode.outcomes))


def test_summaries_agree_with_what_was_recorded(recorded, summary, evaluator):
    params = evaluator.params
    for i, episode in enumerate(recorded["talker"]):
        outcomes = episode.outcomes
        for name in ("arrived", "collided", "hit_pedestrian", "truncated"):
            assert getattr(summary, name)[i] == getattr(outcomes, name)[-1], name
        assert summary.steps[i] == len(outcomes.reward)
        start = np.hypot(
            *(getattr(episode.states.pedestrians, k)[0, 0] - getattr(episode.states.robot, k)[0] for k in "xy")
        )
        surface = min(start - params.robot_radius - params.body_radius, outcomes.pedestrian_distance.min())
        assert summary.min_distance[i] == pytest.approx(surface, abs=1e-5)
        assert summary.comfortable_steps[i] == (outcomes.pedestrian_distance >= params.comfort_distance).sum()
        assert summary.request[i] == next((request for request in outcomes.requested if request), 0)
        assert summary.replied[i] == (outcomes.reply != NONE).any()
        assert summary.agreed[i] == (outcomes.reply == AGREES).any()


def test_an_episode_stops_counting_at_its_end(summary, evaluator):
    # `play` runs every episode for as many steps as the longest: those that ended before went on in vain.
    limit = int(evaluator.params.max_steps)
    assert (summary.steps < limit).any() and (summary.steps == limit).any()
    assert (summary.steps[summary.truncated] == limit).all()
    np.testing.assert_array_equal(summary.arrived.astype(int) + summary.collided + summary.truncated, 1)
    assert (summary.comfortable_steps <= summary.steps).all()
