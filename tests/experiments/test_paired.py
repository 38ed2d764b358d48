"""Paired differences: of which seeds and episodes, and how wide their intervals are."""

import numpy as np
import pytest

from experiments.paired import pair
from jaxnav.statistics import packed


def test_pairs_are_of_the_same_seeds_and_episodes():
    rng = np.random.default_rng(0)
    wins, losses = rng.random((3, 1000)) < 0.9, rng.random((3, 1000)) < 0.7
    base = {"suite": "hard", "scene": "narrow", "budget": "paper"}
    one = base | {"method": "a", "seeds": [0, 2, 5], "episodes": 1000, "arrived": packed(wins)}
    other = base | {"method": "b", "seeds": [2, 3, 5], "episodes": 600, "arrived": packed(losses[:, :600])}
    found = pair(one, other)
    difference = np.mean([wins[i, :600].astype(int) - losses[j, :600] for i, j in ((1, 0), (2, 2))], axis=0)
    assert found["difference"] == pytest.approx(difference.mean())
    assert (found["episodes"], found["seeds"]) == (600, 2)
    assert found["ci95_half"] == pytest.approx(1.96 * difference.std() / 600**0.5)
    seeds = [(wins[i, :600].astype(int) - losses[j, :600]).mean() for i, j in ((1, 0), (2, 2))]
    assert found["seeds_ci95"] == pytest.approx(sorted(seeds))  # of two seeds each resample has both, or one of them
    # Robots that all do the same in an episode are worth no more than one of them.
    same = one | {"arrived": packed(np.repeat(wins[:1], 3, axis=0))}
    none = other | {"seeds": [0, 2, 5], "episodes": 1000, "arrived": packed(np.repeat(losses[:1], 3, axis=0))}
    alone = [row | {"seeds": [0], "arrived": row["arrived"][:1]} for row in (same, none)]
    assert pair(same, none)["ci95_half"] == pytest.approx(pair(*alone)["ci95_half"])


def test_a_scripted_robot_is_paired_with_every_seed():
    rng = np.random.default_rng(0)
    wins, rules = rng.random((3, 600)) < 0.8, rng.random(1000) < 0.95
    base = {"suite": "hard", "scene": "narrow"}
    one = base | {"method": "a", "budget": "paper", "seeds": [0, 2, 5], "episodes": 600, "arrived": packed(wins)}
    other = base | {"method": "planner", "budget": "none", "seeds": [], "episodes": 1000}
    found = pair(one, other | {"arrived": packed(rules[None])})
    assert found["difference"] == pytest.approx(wins.mean() - rules[:600].mean())
    assert (found["budget"], found["episodes"], found["seeds"]) == ("paper", 600, 3)
    difference = wins.mean(axis=0) - rules[:600]
    assert found["ci95_half"] == pytest.approx(1.96 * difference.std() / 600**0.5)
