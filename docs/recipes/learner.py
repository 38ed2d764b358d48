"""A learner: DQN (Mnih et al. 2015) over a grid of twists. It steers and is silent.

jaxnav train --algo learner.py:DQN
"""

import flax.linen as nn
import jax
import jax.numpy as jnp
import numpy as np
import optax
from flax import struct

from jaxnav.agents import ADAM, MLP, RegisteredLearner, ReplayConfig, SilentLearner, descend, message_codes, silent

TWISTS = np.float32([(v, w) for v in (-1, 0, 1) for w in (-1, -0.5, 0, 0.5, 1)])


@struct.dataclass
class Hyperparameters:
    lr: float = 1e-3
    final_lr: float = 1.0  # which every learner has, as it has a discount
    discount: float = 0.97
    epsilon: float = 0.1
    tau: float = 0.01
    reward_scale: float = 0.01


class QNetwork(nn.Module):
    config: ReplayConfig

    @nn.compact
    def __call__(self, observation):
        encoder = self.config.encoding.build(self.config.encoder_widths)
        x = encoder(observation, message_codes(observation.dialogue))
        return nn.Dense(len(TWISTS))(MLP(self.config.critic_widths)(x))


class DeepQ(SilentLearner):
    replays, horizon = True, 1

    def __init__(self, config):
        self.config, self.network = config, QNetwork(config)

    def init(self, key, observation, hyper):
        q = self.network.init(key, observation)
        return {"q": q, "target": jax.tree.map(jnp.copy, q), "optimiser": ADAM.init(q)}

    def policy(self, state):
        return state["q"]

    def best_twist(self, parameters, observation):
        return jnp.asarray(TWISTS)[jnp.argmax(self.network.apply(parameters, observation), axis=-1)]

    def act(self, key, state, observation, hyper):
        key_explore, key_twist = jax.random.split(key)
        best = self.best_twist(state["q"], observation)
        other = jax.random.choice(key_twist, TWISTS, best.shape[:-1])
        return silent(jnp.where(jax.random.bernoulli(key_explore, hyper.epsilon, (*best.shape[:-1], 1)), other, best))

    def update(self, key, state, batch, hyper, lr_scale=1.0, step=0):
        """Equation 2 of the paper, with a target network that follows slowly."""
        after = self.network.apply(state["target"], batch.next_observation).max(axis=-1)
        target = hyper.reward_scale * batch.reward + hyper.discount**batch.steps * (1.0 - batch.terminated) * after
        index = jnp.argmin(jnp.abs(batch.twist[:, None] - TWISTS).sum(axis=-1), axis=-1)

        def loss(q):
            chosen = jnp.take_along_axis(self.network.apply(q, batch.observation), index[:, None], axis=-1)[:, 0]
            return jnp.mean(optax.huber_loss(chosen, target)), jnp.mean(chosen)

        (error, mean), slope = jax.value_and_grad(loss, has_aux=True)(state["q"])
        change, optimiser = ADAM.update(slope, state["optimiser"])
        q = descend(state["q"], change, hyper.lr * lr_scale)
        target = optax.incremental_update(q, state["target"], hyper.tau)
        return {"q": q, "target": target, "optimiser": optimiser}, {"critic_loss": error, "q": mean}


DQN = RegisteredLearner("dqn", DeepQ, ReplayConfig, Hyperparameters)
