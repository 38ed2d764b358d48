"""A2C: the advantage policy gradient, one step on each batch (Mnih et al. 2016). It steers and is silent."""

import dataclasses

from flax import struct

from .. import fields
from .configs import RolloutConfig
from .losses.ppo import policy_gradient
from .ppo import PPO, PPOHyperparameters


@dataclasses.dataclass(frozen=True)
class A2CConfig(RolloutConfig):
    """Sizes of the learner: static under ``jit``."""


@struct.dataclass
class A2CHyperparameters(PPOHyperparameters):
    """Floats of the learner, leaves for ``vmap``."""

    # It makes a sixth of PPO's updates: as long an average in steps of the world.
    average: float = fields.again(PPOHyperparameters, "average", 0.06)


class A2C(PPO):
    """`PPO` with the plain policy gradient, and one step on all of a batch."""

    policy_loss = staticmethod(policy_gradient)

    def __init__(self, config: A2CConfig = A2CConfig()):
        super().__init__(config)
