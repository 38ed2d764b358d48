"""Learners, encoders and scripted robots; `register_learner` and `register_encoder` make others known by name."""

from .a2c import A2C, A2CConfig, A2CHyperparameters
from .configs import LearnerConfig, ReplayConfig, RolloutConfig
from .encoders import ENCODERS, Encoder, find_encoder, register_encoder
from .hsac import HSAC, HSACConfig, HSACHyperparameters
from .learner import (
    LEARNERS,
    Batch,
    HearingLearner,
    Learner,
    RegisteredLearner,
    SilentLearner,
    find_learner,
    register_learner,
)
from .ppo import PPO, PPOConfig, PPOHyperparameters
from .td3 import TD3, TD3Config, TD3Hyperparameters
from .twin import TorchTwin, dense_arrays, mlp_arrays

__all__ = [
    "A2C",
    "ENCODERS",
    "HSAC",
    "LEARNERS",
    "PPO",
    "TD3",
    "A2CConfig",
    "A2CHyperparameters",
    "Batch",
    "Encoder",
    "HSACConfig",
    "HSACHyperparameters",
    "HearingLearner",
    "Learner",
    "LearnerConfig",
    "PPOConfig",
    "PPOHyperparameters",
    "RegisteredLearner",
    "ReplayConfig",
    "RolloutConfig",
    "SilentLearner",
    "TD3Config",
    "TD3Hyperparameters",
    "TorchTwin",
    "dense_arrays",
    "find_encoder",
    "find_learner",
    "mlp_arrays",
    "register_encoder",
    "register_learner",
]

register_learner("hsac", HSAC, HSACConfig, HSACHyperparameters)
register_learner("td3", TD3, TD3Config, TD3Hyperparameters)
register_learner("ppo", PPO, PPOConfig, PPOHyperparameters)
register_learner("a2c", A2C, A2CConfig, A2CHyperparameters)
