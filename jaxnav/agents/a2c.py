"""A2C: the advantage policy gradient, one step on each batch (Mnih et al. 2016). It steers and is silent."""

import dataclasses

import jax.numpy as jnp

from .ppo import PPO, RolloutConfig


@dataclasses.dataclass(frozen=True)
class A2CConfig(RolloutConfig):
    __doc__ = RolloutConfig.__doc__


class A2C(PPO):
    """`PPO` with the plain policy gradient, and one step on all of a batch."""

    def __init__(self, config: A2CConfig = A2CConfig()):
        super().__init__(config)

    def _actor_loss(self, log_density, part, hyper):
        """-A log pi."""
        del hyper
        return -jnp.mean(log_density * part["advantage"])
