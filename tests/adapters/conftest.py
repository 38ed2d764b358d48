"""A world for the adapters that compiles fast, and what has to hold of observations when an episode is replaced."""

import numpy as np
import pytest

from jaxnav import Params, World, WorldConfig

WORLD = World(WorldConfig(scenes=("square",), beams=16))
# Nobody comes near a robot that stands still, and one that drives ahead may arrive in time or not.
PARAMS = Params(max_steps=5.0, goal_tolerance=4.0, preferred_speed=0.0)


@pytest.fixture(scope="session", name="world")
def _world():
    return WORLD


@pytest.fixture(scope="session", name="params")
def _params():
    return PARAMS


def follows(pose_before, pose):
    """Whether one `[..., 3, 3]` pose history is the other one step later: what was now has become the step before."""
    return np.array_equal(pose_before[..., 1:, :], pose[..., :2, :])


def is_first(pose):
    """Whether pose histories `[..., 3, 3]` are those of beginnings: nothing before, and a goal at least 4 m away."""
    past, now = pose[..., :2, :], pose[..., 2, :]
    return not past.any() and bool(np.all(np.hypot(now[..., 0], now[..., 1]) > 3.999)) and not now[..., 2].any()


@pytest.fixture(scope="session", name="follows")
def _follows():
    return follows


@pytest.fixture(scope="session", name="is_first")
def _is_first():
    return is_first
