"""Configurations of runs: every value with its default, and their check as a whole."""

import dataclasses
import functools
from collections.abc import Sequence
from typing import Any

from ..agents import (
    A2CConfig,
    A2CHyperparameters,
    HSACConfig,
    HSACHyperparameters,
    Learner,
    PPOConfig,
    PPOHyperparameters,
    RegisteredLearner,
    RolloutConfig,
    TD3Config,
    TD3Hyperparameters,
    find_learner,
)
from ..errors import UserError
from ..fields import again, check, flag, nested, part, text, whole
from ..world import check_params
from .dataclass_json import from_json
from .presets import PRESETS
from .randomise import check_ranges
from .settings import TrainConfig, WorldSettings, is_map, scene_names

__all__ = [
    "PRESETS",
    "A2CRunConfig",
    "HSACRunConfig",
    "PPORunConfig",
    "RunConfig",
    "TD3RunConfig",
    "TrainConfig",
    "WorldSettings",
    "is_map",
    "make_agent",
    "preset",
    "resolve",
    "run_class",
    "run_from_json",
    "scene_names",
]


@dataclasses.dataclass(frozen=True)
class RunConfig:
    """A training run. Its scenes are ``world.scenes``; `of_scenes` changes them with the people who walk there."""

    preset: str = text(
        "quick",
        allowed=f"one of {', '.join(PRESETS)}",
        doc="defaults of all other values: quick (CPU minutes), robust (its world randomised), lidar (larger, longer), "
        "grid or grid-frozen (the paper's CNN on grid maps, for a GPU)",
    )
    algo: str = part(
        "hsac", ("hsac", "td3", "ppo", "a2c"), doc="the learner; td3, ppo and a2c steer only, without talking"
    )
    seed: int = whole(0, low=0, high=2**32 - 1, doc="seed of everything random")
    out: str = text(
        "", allowed="a folder", doc="the run's folder; runs/PRESET-SEED if empty, runs/ALGO-PRESET-SEED beside hsac"
    )
    resume: bool = flag(False, doc="go on with the run that the folder holds")
    world: WorldSettings = nested(WorldSettings, doc="sizes, switches and floats of the world")
    agent: Any = nested(type(None), doc="sizes of the learner")
    hyper: Any = nested(type(None), doc="floats of the learner")
    train: TrainConfig = nested(TrainConfig, doc="sizes of the training loop")

    def of_scenes(self, scenes: str | Sequence[str]) -> "RunConfig":
        """The same run in other scenes: see `WorldSettings.of_scenes`. UserError: unknown, or of different people."""
        try:
            return dataclasses.replace(self, world=self.world.of_scenes(scenes))
        except ValueError as error:
            raise UserError(str(error)) from None


@dataclasses.dataclass(frozen=True)
class HSACRunConfig(RunConfig):
    """A run of hybrid SAC."""

    agent: HSACConfig = nested(HSACConfig, doc="sizes of the learner")
    hyper: HSACHyperparameters = nested(HSACHyperparameters, doc="floats of the learner")


@dataclasses.dataclass(frozen=True)
class TD3RunConfig(RunConfig):
    """A run of TD3."""

    algo: str = again(RunConfig, "algo", "td3")
    agent: TD3Config = nested(TD3Config, doc="sizes of the learner")
    hyper: TD3Hyperparameters = nested(TD3Hyperparameters, doc="floats of the learner")


@dataclasses.dataclass(frozen=True)
class PPORunConfig(RunConfig):
    """A run of PPO."""

    algo: str = again(RunConfig, "algo", "ppo")
    agent: PPOConfig = nested(PPOConfig, doc="sizes of the learner")
    hyper: PPOHyperparameters = nested(PPOHyperparameters, doc="floats of the learner")
    train: TrainConfig = nested(lambda: PRESETS["quick"].rollout, doc="sizes of the training loop")


@dataclasses.dataclass(frozen=True)
class A2CRunConfig(RunConfig):
    """A run of A2C."""

    algo: str = again(RunConfig, "algo", "a2c")
    agent: A2CConfig = nested(A2CConfig, doc="sizes of the learner")
    hyper: A2CHyperparameters = nested(A2CHyperparameters, doc="floats of the learner")
    train: TrainConfig = nested(lambda: PRESETS["quick"].rollout, doc="sizes of the training loop")


_RUNS = {"hsac": HSACRunConfig, "td3": TD3RunConfig, "ppo": PPORunConfig, "a2c": A2CRunConfig}


def run_class(algo: str) -> type[RunConfig]:
    """The class of the runs of an algorithm. UserError: there is none of that name."""
    learner = find_learner(algo)
    return _RUNS[algo] if algo in _RUNS else _run_class(learner)


@functools.cache
def _run_class(learner: RegisteredLearner) -> type[RunConfig]:
    """A run of a learner that isn't one of ours."""
    agent = nested(learner.config, doc="sizes of the learner")
    hyper = nested(learner.hyper, doc="floats of the learner")
    return dataclasses.make_dataclass(
        f"{learner.config.__name__.removesuffix('Config')}RunConfig",
        [
            ("algo", str, again(RunConfig, "algo", learner.name)),
            ("agent", learner.config, agent),
            ("hyper", learner.hyper, hyper),
        ],
        bases=(RunConfig,),
        namespace={"__doc__": f"A run of {learner.name}.", "__module__": __name__},
        frozen=True,
    )


def preset(name: str, algo: str = "hsac", scenes: str | Sequence[str] | None = None) -> RunConfig:
    """The defaults of a preset for an algorithm, in its scenes or in others.

    A learner that you registered has its own defaults, and the world and the training loop of the preset. UserError:
    there is no preset, algorithm or scene of that name.
    """
    if name not in PRESETS:
        raise UserError(f"preset {name!r} is unknown: choose from {', '.join(PRESETS)}")
    learner, cls, found = find_learner(algo), run_class(algo), PRESETS[name]
    agent, hyper = found.learners[algo] if algo in found.learners else (learner.config(), learner.hyper())
    train = found.replay if learner.make(agent).replays else found.rollout
    config = cls(preset=name, algo=algo, world=found.world, agent=agent, hyper=hyper, train=train)
    return config if scenes is None else config.of_scenes(scenes)


def make_agent(config: RunConfig) -> Learner:
    """The learner of a run."""
    return find_learner(config.algo).make(config.agent)


def resolve(config: RunConfig) -> RunConfig:
    """``config`` with people, widths and folder filled in, checked as a whole. UserError names field and remedy."""
    if type(config) is not run_class(config.algo):
        raise UserError(
            f"algo is {config.algo!r} in a {type(config).__name__}: begin with preset(name, {config.algo!r})"
        )
    missing = set(config.agent.encoding.reads) - set(config.world.observation)
    if missing:
        raise UserError(
            f"world.observation lacks {', '.join(sorted(missing))}: the {config.agent.encoder} encoder needs it"
        )
    if isinstance(config.agent, RolloutConfig):
        _check_rollout(config.agent, config.train)
    try:
        check(config, "")
        world = config.world.of_scenes(config.world.scenes)
        check_params(world.params, world)
        check_ranges(world.randomise, world.params, world)
        world.world()
        check(config.hyper, "hyper")
    except ValueError as error:
        raise UserError(str(error)) from None
    algo = "" if config.algo == "hsac" else f"{config.algo.rpartition(':')[2]}-"
    out = config.out or f"runs/{algo}{config.preset}-{config.seed}"
    return dataclasses.replace(config, world=world, agent=config.agent.filled(), out=out)


def _check_rollout(agent: RolloutConfig, train: TrainConfig) -> None:
    steps, parts = agent.horizon * train.episodes, getattr(agent, "minibatches", 1)
    if train.steps_per_chunk % agent.horizon:
        raise UserError(
            f"agent.horizon is {agent.horizon}: give a divisor of train.steps_per_chunk, which is "
            f"{train.steps_per_chunk}"
        )
    if steps % parts:
        raise UserError(
            f"agent.minibatches is {parts}: give a divisor of agent.horizon times train.episodes, which is {steps}"
        )


def run_from_json(data: dict[str, Any]) -> RunConfig:
    """The run that `to_json` made ``data`` of; ValueError names what is missing or unknown."""
    return from_json(run_class(data["algo"]), data)
