"""Learners, encoders and scripted robots; `register_learner` and `register_encoder` make others known by name."""

from .a2c import A2C, A2CConfig, A2CHyperparameters
from .configs import LearnerConfig, ReplayConfig, RolloutConfig
from .encoders import ENCODERS, Encoder, find_encoder, register_encoder
from .features import dialogue_features, known, own_features, pedestrian_features
from .hsac import HSAC, HSACConfig, HSACHyperparameters
from .layers import MLP
from .learner import (
    ADAM,
    LEARNERS,
    Batch,
    HearingLearner,
    Learner,
    RegisteredLearner,
    SilentLearner,
    descend,
    find_learner,
    register_learner,
    silent,
)
from .networks import message_codes
from .ppo import PPO, PPOConfig, PPOHyperparameters
from .td3 import TD3, TD3Config, TD3Hyperparameters
from .twin import TorchTwin, dense_arrays, mlp_arrays

__all__ = [
    "A2C",
    "ADAM",
    "ENCODERS",
    "HSAC",
    "LEARNERS",
    "MLP",
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
    "descend",
    "dialogue_features",
    "find_encoder",
    "find_learner",
    "known",
    "message_codes",
    "mlp_arrays",
    "own_features",
    "pedestrian_features",
    "register_encoder",
    "register_learner",
    "silent",
]

register_learner("hsac", HSAC, HSACConfig, HSACHyperparameters)
register_learner("td3", TD3, TD3Config, TD3Hyperparameters)
register_learner("ppo", PPO, PPOConfig, PPOHyperparameters)
register_learner("a2c", A2C, A2CConfig, A2CHyperparameters)
