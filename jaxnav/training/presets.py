"""The presets: worlds, training loops, sizes and floats of learners, each spelled out."""

import dataclasses
from collections.abc import Mapping
from typing import Any

from ..agents import (
    A2CConfig,
    A2CHyperparameters,
    HSACConfig,
    HSACHyperparameters,
    LearnerConfig,
    PPOConfig,
    PPOHyperparameters,
    TD3Config,
    TD3Hyperparameters,
)
from ..agents.encoders import GRID_PARTS
from ..world import Params
from .settings import TrainConfig, WorldSettings


@dataclasses.dataclass(frozen=True)
class Preset:
    """The defaults of runs.

    Attributes:
        world: of every learner.
        replay: training loop of learners that learn from replay.
        rollout: of those that learn from the steps just played: fewer episodes at once, as many steps in all. Chunks
            are as long: each draws as many fresh starts as there are episodes, a longer one would use them again.
        learners: sizes and floats of each learner by name.
    """

    world: WorldSettings
    replay: TrainConfig
    rollout: TrainConfig
    learners: Mapping[str, tuple[LearnerConfig, Any]]


_GRID_WORLD = WorldSettings(observation=GRID_PARTS)
_SHORT = TrainConfig(episodes=256, replay_rows=400, steps_per_chunk=25, total_steps=1000, evaluate_every=4)
_SHORT_ROLLOUT = TrainConfig(episodes=64, replay_rows=400, steps_per_chunk=25, total_steps=4000, evaluate_every=16)
_SMALL: Mapping[str, tuple[LearnerConfig, Any]] = {
    "hsac": (
        HSACConfig(encoder="lidar", actor_widths=(128, 128), critic_widths=(128, 128), batch=512, updates_per_step=4),
        HSACHyperparameters(actor_lr=1e-3, critic_lr=1e-3),
    ),
    "td3": (
        TD3Config(encoder="lidar", actor_widths=(128, 128), critic_widths=(128, 128), batch=512, updates_per_step=4),
        TD3Hyperparameters(actor_lr=1e-3, critic_lr=1e-3),
    ),
    "ppo": (
        PPOConfig(encoder="lidar", actor_widths=(128, 128), critic_widths=(128, 128), horizon=25, epochs=8),
        PPOHyperparameters(actor_lr=1e-3, critic_lr=1e-3),
    ),
    "a2c": (
        A2CConfig(encoder="lidar", actor_widths=(128, 128), critic_widths=(128, 128), horizon=5),
        A2CHyperparameters(actor_lr=1e-3, critic_lr=1e-3),
    ),
}

PRESETS: Mapping[str, Preset] = {
    "quick": Preset(world=WorldSettings(), replay=_SHORT, rollout=_SHORT_ROLLOUT, learners=_SMALL),
    "robust": Preset(
        world=WorldSettings(
            pedestrians=8,
            params=Params(crowd_size=4.0),  # where nothing is drawn: evaluations
            scan_noise=True,
            control_delay=2,
            randomise=(
                ("crowd_size", 1, 8),
                ("awareness", 0.0, 2.0),
                ("preferred_speed", 0.3, 1.4),
                ("compliance", 0.0, 1.0),
                ("scan_noise_std", 0.0, 0.1),
                ("scan_dropout", 0.0, 0.2),
                ("control_latency", 0, 2),
            ),
        ),
        replay=TrainConfig(episodes=256, replay_rows=400, steps_per_chunk=25, total_steps=1500, evaluate_every=4),
        rollout=TrainConfig(episodes=64, replay_rows=400, steps_per_chunk=25, total_steps=6000, evaluate_every=16),
        learners=_SMALL,
    ),
    "lidar": Preset(
        world=WorldSettings(),
        replay=TrainConfig(episodes=256, replay_rows=1500, steps_per_chunk=25, total_steps=3000, evaluate_every=10),
        rollout=TrainConfig(episodes=64, replay_rows=1500, steps_per_chunk=25, total_steps=12000, evaluate_every=40),
        learners={
            "hsac": (
                HSACConfig(
                    encoder="lidar", actor_widths=(256, 256), critic_widths=(256, 256), batch=512, updates_per_step=4
                ),
                HSACHyperparameters(actor_lr=1e-3, critic_lr=1e-3),
            ),
            "td3": (
                TD3Config(
                    encoder="lidar", actor_widths=(256, 256), critic_widths=(256, 256), batch=512, updates_per_step=4
                ),
                TD3Hyperparameters(actor_lr=1e-3, critic_lr=1e-3),
            ),
            "ppo": (
                PPOConfig(encoder="lidar", actor_widths=(256, 256), critic_widths=(256, 256), horizon=25, epochs=8),
                PPOHyperparameters(actor_lr=1e-3, critic_lr=1e-3),
            ),
            "a2c": (
                A2CConfig(encoder="lidar", actor_widths=(256, 256), critic_widths=(256, 256), horizon=5),
                A2CHyperparameters(actor_lr=1e-3, critic_lr=1e-3),
            ),
        },
    ),
    # Convolutions learn sooner at these rates than at 1e-3 (docs/learner.md).
    "grid": Preset(
        world=_GRID_WORLD,
        replay=_SHORT,
        rollout=_SHORT_ROLLOUT,
        learners={
            "hsac": (
                HSACConfig(encoder="grid", actor_widths=(128,), critic_widths=(128,), batch=256, updates_per_step=4),
                HSACHyperparameters(actor_lr=3e-4, critic_lr=3e-4),
            ),
            "td3": (
                TD3Config(encoder="grid", actor_widths=(128,), critic_widths=(128,), batch=256, updates_per_step=4),
                TD3Hyperparameters(actor_lr=3e-4, critic_lr=3e-4),
            ),
            "ppo": (
                PPOConfig(encoder="grid", actor_widths=(128,), critic_widths=(128,), horizon=25, epochs=8),
                PPOHyperparameters(actor_lr=3e-4, critic_lr=3e-4),
            ),
            "a2c": (
                A2CConfig(encoder="grid", actor_widths=(128,), critic_widths=(128,), horizon=5),
                A2CHyperparameters(actor_lr=3e-4, critic_lr=3e-4),
            ),
        },
    ),
    "grid-frozen": Preset(
        world=_GRID_WORLD,
        replay=_SHORT,
        rollout=_SHORT_ROLLOUT,
        learners={
            "hsac": (
                HSACConfig(
                    encoder="grid-frozen", actor_widths=(128,), critic_widths=(128,), batch=256, updates_per_step=4
                ),
                HSACHyperparameters(actor_lr=1e-3, critic_lr=1e-3),
            ),
            "td3": (
                TD3Config(
                    encoder="grid-frozen", actor_widths=(128,), critic_widths=(128,), batch=256, updates_per_step=4
                ),
                TD3Hyperparameters(actor_lr=1e-3, critic_lr=1e-3),
            ),
            "ppo": (
                PPOConfig(encoder="grid-frozen", actor_widths=(128,), critic_widths=(128,), horizon=25, epochs=8),
                PPOHyperparameters(actor_lr=1e-3, critic_lr=1e-3),
            ),
            "a2c": (
                A2CConfig(encoder="grid-frozen", actor_widths=(128,), critic_widths=(128,), horizon=5),
                A2CHyperparameters(actor_lr=1e-3, critic_lr=1e-3),
            ),
        },
    ),
}
