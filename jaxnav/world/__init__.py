"""One episode of the world: pure, differentiable, no batch axis, no networks, no files."""

from .config import WorldConfig
from .env import World, body_reach
from .params import Params, check_params
from .people import PEDESTRIAN_MODELS, PedestrianModel, register_people
from .reward import REWARDS, RewardFunction, StepEvents, register_reward
from .scenes import SCENES, SUITES, Scene, default_params, register_scene
from .types import Action, Observation, Outcome, Snapshot, State, Walls

__all__ = [
    "PEDESTRIAN_MODELS",
    "REWARDS",
    "SCENES",
    "SUITES",
    "Action",
    "Observation",
    "Outcome",
    "Params",
    "PedestrianModel",
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
    "register_people",
    "register_reward",
    "register_scene",
]
