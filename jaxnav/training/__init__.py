"""Training: configurations, runs, populations, evaluations. Names are imported when they are first asked for."""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .config import RunConfig, TrainConfig, make_agent, preset, resolve
    from .dataclass_json import differences, to_json
    from .evaluation import VALIDATION_SEED, Evaluator, episode_keys, metrics, play_block, scene_metrics
    from .policy import Policy
    from .population import Population, member
    from .rollout import Episode, EpisodeSummary, Player, play
    from .run import Run
    from .signals import Interrupted

_MODULES = {
    "config": ("RunConfig", "TrainConfig", "make_agent", "preset", "resolve"),
    "dataclass_json": ("differences", "to_json"),
    "evaluation": ("VALIDATION_SEED", "Evaluator", "episode_keys", "metrics", "play_block", "scene_metrics"),
    "policy": ("Policy",),
    "population": ("Population", "member"),
    "rollout": ("Episode", "EpisodeSummary", "Player", "play"),
    "run": ("Run",),
    "signals": ("Interrupted",),
}
_MODULE_OF = {name: module for module, names in _MODULES.items() for name in names}

__all__ = [
    "VALIDATION_SEED",
    "Episode",
    "EpisodeSummary",
    "Evaluator",
    "Interrupted",
    "Player",
    "Policy",
    "Population",
    "Run",
    "RunConfig",
    "TrainConfig",
    "differences",
    "episode_keys",
    "make_agent",
    "member",
    "metrics",
    "play",
    "play_block",
    "preset",
    "resolve",
    "scene_metrics",
    "to_json",
]


def __getattr__(name: str) -> Any:
    if name not in _MODULE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(importlib.import_module(f".{_MODULE_OF[name]}", __name__), name)
    globals()[name] = value
    return value
