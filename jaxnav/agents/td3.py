"""TD3: a deterministic twist, twin critics, delayed actor (Fujimoto et al. 2018). It steers and is silent."""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import optax
from flax import struct

from .. import fields
from ..world import Action, Observation
from .configs import ReplayConfig
from .learner import ADAM, Batch, Parameters, SilentLearner, descend, silent
from .losses import td3 as losses
from .networks import Actor, TwinCritic, message_codes


@dataclasses.dataclass(frozen=True)
class TD3Config(ReplayConfig):
    """Sizes of the learner: static under ``jit``."""

    actor_every: int = fields.whole(2, low=1, doc="updates of the critics for one of the actor")


@struct.dataclass
class TD3Hyperparameters:
    """Floats of the learner, leaves for ``vmap``."""

    actor_lr: float = fields.number(1e-3, low=0, doc="learning rate of the actor")
    critic_lr: float = fields.number(1e-3, low=0, doc="learning rate of the critics")
    final_lr: float = fields.probability(
        1.0, doc="fraction of these rates that is left at the end of training; they decay linearly"
    )
    discount: float = fields.probability(0.97, doc="of the return, a step")
    tau: float = fields.probability(
        0.02, doc="share of the critics and the actor that enters the target ones at each update of the actor"
    )
    exploration_noise: float = fields.number(0.2, low=0, doc="standard deviation of the noise on twists that are tried")
    target_noise: float = fields.number(
        0.2, low=0, doc="standard deviation of the noise on twists that the target critics judge"
    )
    target_noise_clip: float = fields.number(0.5, low=0, doc="the most of that noise")
    reward_scale: float = fields.number(0.01, above=0, doc="factor on rewards")


@struct.dataclass
class TD3State:
    """The part that training changes.

    Attributes:
        actor: its parameters.
        critic: parameters of both critics.
        target_actor: those of the target actor, which is evaluated.
        target_critic: those of the target critics.
        actor_optimiser: the state of its optimiser.
        critic_optimiser: likewise.
    """

    actor: Parameters
    critic: Parameters
    target_actor: Parameters
    target_critic: Parameters
    actor_optimiser: Any
    critic_optimiser: Any


class TD3(SilentLearner):
    """The `Learner`: a bundle of pure functions. Messages are heard as codes."""

    replays, horizon, squash = True, 1, "tanh"

    def __init__(self, config: TD3Config = TD3Config()):
        self.config = config
        self.actor_network = Actor(config.encoder, config.actor_widths, config.encoder_widths)
        self.critic_network = TwinCritic(config.encoder, config.critic_widths, config.encoder_widths, outputs=1)

    def init(self, key: jax.Array, observation: Observation, hyper: TD3Hyperparameters) -> TD3State:
        """Fresh parameters for observations shaped like ``observation`` (one, without a batch axis)."""
        del hyper
        key_actor, key_critic = jax.random.split(key)
        heard = message_codes(observation.dialogue)
        actor = self.actor_network.init(key_actor, observation, heard, method="steer")
        critic = self.critic_network.init(key_critic, observation, heard, jnp.zeros(2))
        return TD3State(
            actor=actor,
            critic=critic,
            target_actor=jax.tree.map(jnp.copy, actor),
            target_critic=jax.tree.map(jnp.copy, critic),
            actor_optimiser=ADAM.init(actor),
            critic_optimiser=ADAM.init(critic),
        )

    def policy(self, state: TD3State) -> Parameters:
        """The parameters of the target actor."""
        return state.target_actor

    def act(self, key: jax.Array, state: TD3State, observation: Observation, hyper: TD3Hyperparameters) -> Action:
        """The actor's twist with noise, for each observation `[..., ...]`, and no request."""
        twist = self.best_twist(state.actor, observation)
        return silent(jnp.clip(twist + hyper.exploration_noise * jax.random.normal(key, twist.shape), -1.0, 1.0))

    def best_twist(self, parameters: Parameters, observation: Observation) -> jax.Array:
        """The actor's twist `[..., 2]`."""
        heard = message_codes(observation.dialogue)
        mean: Any = self.actor_network.apply(parameters, observation, heard, method="steer")
        return jnp.tanh(mean)

    def q(self, critic: Parameters, observation: Observation, twist: jax.Array) -> jax.Array:
        """Q `[2, ...]` of both critics."""
        q: Any = self.critic_network.apply(critic, observation, message_codes(observation.dialogue), twist)
        return q[..., 0]

    def update(
        self, key: jax.Array, state: TD3State, batch: Batch, hyper: TD3Hyperparameters,
        lr_scale: jax.Array | float = 1.0, step: jax.Array | int = 0,
    ) -> tuple[TD3State, dict[str, jax.Array]]:  # fmt: skip
        """One step on the critics, and on the actor every so often.

        lr_scale: multiplies every rate; step: how many updates came before, for the delay.
        """
        target = losses.target(key, self.best_twist, self.q, state.target_actor, state.target_critic, batch, hyper)
        (critic_loss, q), gradient = jax.value_and_grad(losses.critic_loss, has_aux=True)(
            state.critic, self.q, batch, target, self.config.huber_delta
        )
        change, critic_optimiser = ADAM.update(gradient, state.critic_optimiser)
        critic = descend(state.critic, change, hyper.critic_lr * lr_scale)
        state = dataclasses.replace(state, critic=critic, critic_optimiser=critic_optimiser)

        def update_actor(state: TD3State):
            loss, gradient = jax.value_and_grad(losses.actor_loss)(
                state.actor, self.best_twist, self.q, state.critic, batch
            )
            change, actor_optimiser = ADAM.update(gradient, state.actor_optimiser)
            actor = descend(state.actor, change, hyper.actor_lr * lr_scale)
            new = dataclasses.replace(
                state,
                actor=actor,
                actor_optimiser=actor_optimiser,
                target_actor=optax.incremental_update(actor, state.target_actor, hyper.tau),
                target_critic=optax.incremental_update(state.critic, state.target_critic, hyper.tau),
            )
            return new, self.config.actor_every * loss  # the mean over updates is then that of those that had one

        state, actor_loss = jax.lax.cond(
            step % self.config.actor_every == 0, update_actor, lambda state: (state, jnp.float32(0.0)), state
        )
        return state, {"critic_loss": critic_loss, "q": q, "actor_loss": actor_loss}
