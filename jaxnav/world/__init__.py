"""One episode of the world: pure, differentiable, no batch axis, no networks, no files."""

from .env import World, body_reach, check_params
from .scenes import SCENES, SUITES, Scene, default_params
from .types import Action, Observation, Outcome, Params, Snapshot, State, Walls, WorldConfig

__all__ = [
    "SCENES",
    "SUITES",
    "Action",
    "Observation",
    "Outcome",
    "Params",
    "Scene",
    "Snapshot",
    "State",
    "Walls",
    "World",
    "WorldConfig",
    "body_reach",
    "check_params",
    "default_params",
]
