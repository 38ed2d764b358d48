"""One episode of the world: pure, differentiable, no batch axis, no networks, no files."""

from .config import WorldConfig
from .env import World, body_reach
from .params import Params, check_params
from .reward import REWARDS, RewardFunction, StepEvents, register_reward
from .scenes import SCENES, SUITES, Scene, default_params, register_scene
from .types import Action, Observation, Outcome, Snapshot, State, Walls

__all__ = [
    "REWARDS",
    "SCENES",
    "SUITES",
    "Action",
    "Observation",
    "Outcome",
    "Params",
    "RewardFunction",
    "Scene",
    "Snapshot",
    "State",
    "StepEvents",
    "Walls",
    "World",
    "WorldConfig",
    "body_reach",
    "check_params",
    "default_params",
    "register_reward",
    "register_scene",
]
