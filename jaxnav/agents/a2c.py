"""A2C: the advantage policy gradient, one step on each batch (Mnih et al. 2016). It steers and is silent."""

import dataclasses

from flax import struct

from .configs import RolloutConfig
from .losses.ppo import policy_gradient
from .ppo import PPO, PPOHyperparameters


@dataclasses.dataclass(frozen=True)
class A2CConfig(RolloutConfig):
    __doc__ = RolloutConfig.__doc__


@struct.dataclass
class A2CHyperparameters(PPOHyperparameters):
    __doc__ = PPOHyperparameters.__doc__

    average: float = 0.06  # it makes a sixth of PPO's updates: as long an average in steps of the world


class A2C(PPO):
    """`PPO` with the plain policy gradient, and one step on all of a batch."""

    policy_loss = staticmethod(policy_gradient)

    def __init__(self, config: A2CConfig = A2CConfig()):
        super().__init__(config)
