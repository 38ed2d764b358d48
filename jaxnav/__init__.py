"""jaxnav: a differentiable 2D social-navigation world and a robot in it that learns to steer and to talk.

``run = train(preset("quick"), out="runs/mine")`` trains a robot, ``policy = load("runs/mine")`` takes it up again,
``evaluate``, ``record`` and ``compare`` play it. A `World` is ``reset``, ``step`` and ``observe`` of one episode.
"""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .agents import (
        A2C,
        HSAC,
        PPO,
        TD3,
        A2CConfig,
        A2CHyperparameters,
        HSACConfig,
        HSACHyperparameters,
        PPOConfig,
        PPOHyperparameters,
        TD3Config,
        TD3Hyperparameters,
    )
    from .agents.scripted import OrcaRobot, Planner, StraightLine
    from .api import compare, evaluate, load, record, train
    from .training.config import A2CRunConfig, HSACRunConfig, PPORunConfig, RunConfig, TD3RunConfig, preset
    from .world import SCENES, SUITES, Action, Params, Scene, World, WorldConfig, register_scene

__version__ = "0.1.0"

__all__ = [
    "A2C",
    "HSAC",
    "PPO",
    "SCENES",
    "SUITES",
    "TD3",
    "A2CConfig",
    "A2CHyperparameters",
    "A2CRunConfig",
    "Action",
    "HSACConfig",
    "HSACHyperparameters",
    "HSACRunConfig",
    "OrcaRobot",
    "PPOConfig",
    "PPOHyperparameters",
    "PPORunConfig",
    "Params",
    "Planner",
    "RunConfig",
    "Scene",
    "StraightLine",
    "TD3Config",
    "TD3Hyperparameters",
    "TD3RunConfig",
    "World",
    "WorldConfig",
    "compare",
    "evaluate",
    "load",
    "preset",
    "record",
    "register_scene",
    "train",
]

_SCRIPTED = ("OrcaRobot", "Planner", "StraightLine")
_FUNCTIONS = ("compare", "evaluate", "load", "record", "train")
_WORLD = ("SCENES", "SUITES", "Action", "Params", "Scene", "World", "WorldConfig", "register_scene")


def __getattr__(name: str) -> Any:
    """A public name, imported when it is first asked for: ``import jaxnav`` alone loads nothing."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    if name in _WORLD:
        module = "world"
    elif name in _FUNCTIONS:
        module = "api"
    elif name in _SCRIPTED:
        module = "agents.scripted"
    else:
        module = "training.config" if name == "preset" or name.endswith("RunConfig") else "agents"
    value = getattr(importlib.import_module(f".{module}", __name__), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
