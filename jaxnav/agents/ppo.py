"""PPO: clipped policy gradient with generalised advantages (Schulman et al. 2017). A2C is made of it.

They steer and are silent.
"""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import optax
from flax import struct

from .. import fields
from ..world import Action, Observation
from .configs import RolloutConfig
from .learner import ADAM, Batch, Parameters, SilentLearner, descend, silent
from .losses.ppo import clipped_objective, gae, value_loss
from .networks import LOG_STD_RANGE, Actor, Value, message_codes


@dataclasses.dataclass(frozen=True)
class PPOConfig(RolloutConfig):
    """Sizes of the learner: static under ``jit``."""

    horizon: int = fields.again(RolloutConfig, "horizon", 25)
    epochs: int = fields.whole(8, low=1, doc="how often each step is used")
    minibatches: int = fields.whole(
        4, low=1, doc="parts into which the steps are split each time; divides horizon times train.episodes"
    )

    def updates(self, steps: int) -> int:
        return super().updates(steps) * self.epochs * self.minibatches


@struct.dataclass
class PPOHyperparameters:
    """Floats of the learner, leaves for ``vmap``."""

    actor_lr: float = fields.number(1e-3, low=0, doc="learning rate of the actor")
    critic_lr: float = fields.number(1e-3, low=0, doc="learning rate of the value network")
    final_lr: float = fields.probability(
        1.0, doc="fraction of these rates that is left at the end of training; they decay linearly"
    )
    average: float = fields.probability(
        0.01, doc="share of the actor that enters, at each update, the averaged one that is evaluated"
    )
    discount: float = fields.probability(0.97, doc="of the return, a step")
    gae_lambda: float = fields.probability(0.95, doc="share of the advantages that is taken from further steps")
    clip: float = fields.number(
        0.2, above=0, doc="the most by which the ratio of probabilities may differ from 1 to be rewarded"
    )
    entropy_weight: float = fields.number(0.003, low=0, doc="weight of the bonus on entropy")
    max_gradient_norm: float = fields.number(
        0.5, above=0, doc="longest gradient of actor or value network that is followed"
    )
    initial_std: float = fields.number(0.5, above=0, high=1, doc="standard deviation of the twist before training")
    reward_scale: float = fields.number(0.01, above=0, doc="factor on rewards")


@struct.dataclass
class PPOState:
    """The part that training changes.

    Attributes:
        actor: its parameters.
        averaged: their running average, which is evaluated.
        value: parameters of the value network.
        actor_optimiser: the state of its optimiser.
        value_optimiser: likewise.
    """

    actor: Parameters
    averaged: Parameters
    value: Parameters
    actor_optimiser: Any
    value_optimiser: Any


class PPO(SilentLearner):
    """The `Learner`: a bundle of pure functions. Messages are heard as codes.

    The twist is a Gaussian that the world clips: no tanh, so that its density is known wherever it falls.
    """

    replays, squash = False, "clip"
    policy_loss = staticmethod(clipped_objective)

    def __init__(self, config: RolloutConfig = PPOConfig()):
        self.config = config
        self.horizon = config.horizon
        self.epochs, self.minibatches = getattr(config, "epochs", 1), getattr(config, "minibatches", 1)
        self.actor_network = Actor(config.encoder, config.actor_widths, config.encoder_widths)
        self.value_network = Value(config.encoder, config.critic_widths, config.encoder_widths)

    def init(self, key: jax.Array, observation: Observation, hyper: PPOHyperparameters) -> PPOState:
        """Fresh parameters for observations shaped like ``observation`` (one, without a batch axis)."""
        key_actor, key_value = jax.random.split(key)
        heard = message_codes(observation.dialogue)
        actor: Any = self.actor_network.init(key_actor, observation, heard, method="gaussian")
        # The networks' own start is a twist of 0.08 standard deviations: right for an entropy that is tuned, not here.
        low, high = LOG_STD_RANGE
        share = 2.0 * (jnp.log(jnp.float32(hyper.initial_std)) - low) / (high - low) - 1.0
        head = actor["params"]["log_std_head"]
        head["bias"] = jnp.full_like(head["bias"], jnp.arctanh(jnp.clip(share, -0.99, 0.99)))
        value = self.value_network.init(key_value, observation, heard)
        return PPOState(
            actor=actor,
            averaged=jax.tree.map(jnp.copy, actor),
            value=value,
            actor_optimiser=ADAM.init(actor),
            value_optimiser=ADAM.init(value),
        )

    def policy(self, state: PPOState) -> Parameters:
        """The parameters of the averaged actor."""
        return state.averaged

    def act(self, key: jax.Array, state: PPOState, observation: Observation, hyper: PPOHyperparameters) -> Action:
        """Sample a twist, as yet unclipped, for each observation `[..., ...]`, and no request."""
        del hyper
        mean, log_std = self.gaussian(state.actor, observation)
        return silent(mean + jnp.exp(log_std) * jax.random.normal(key, mean.shape))

    def best_twist(self, parameters: Parameters, observation: Observation) -> jax.Array:
        """The mean twist `[..., 2]`, clipped."""
        mean, _ = self.gaussian(parameters, observation)
        return jnp.clip(mean, -1.0, 1.0)

    def update(
        self, key: jax.Array, state: PPOState, batch: Batch, hyper: PPOHyperparameters,
        lr_scale: jax.Array | float = 1.0, step: jax.Array | int = 0,
    ) -> tuple[PPOState, dict[str, jax.Array]]:  # fmt: skip
        """``epochs`` passes over a batch of `[horizon, episodes]` steps in a row.

        lr_scale: multiplies every rate.
        Raises ValueError: the steps can't be parted into ``minibatches`` of the same size.
        """
        del step
        count, parts = batch.reward.size, self.minibatches
        if count % parts:
            raise ValueError(f"agent.minibatches is {parts}: give a divisor of the batch's {count} steps")
        values, next_values = (
            self.value(state.value, batch.observation),
            self.value(state.value, batch.next_observation),
        )
        advantages = gae(batch, values, next_values, hyper)
        log_density, _ = self.log_density(state.actor, batch.observation, batch.twist)
        data = {
            "observation": batch.observation, "twist": batch.twist, "advantage": advantages,
            "return": advantages + values, "log_density": log_density,
        }  # fmt: skip
        data = jax.tree.map(lambda leaf: leaf.reshape(-1, *leaf.shape[2:]), data)

        def minibatch(state, rows):
            part = jax.tree.map(lambda leaf: leaf[rows], data)
            (_, aux), gradient = jax.value_and_grad(self.loss, has_aux=True)((state.actor, state.value), part, hyper)
            (actor_change, actor_optimiser), (value_change, value_optimiser) = (
                ADAM.update(_shortened(slope, hyper.max_gradient_norm), optimiser)
                for slope, optimiser in zip(gradient, (state.actor_optimiser, state.value_optimiser), strict=True)
            )
            actor = descend(state.actor, actor_change, hyper.actor_lr * lr_scale)
            new = PPOState(
                actor=actor,
                averaged=optax.incremental_update(actor, state.averaged, hyper.average),
                value=descend(state.value, value_change, hyper.critic_lr * lr_scale),
                actor_optimiser=actor_optimiser,
                value_optimiser=value_optimiser,
            )
            return new, aux

        orders = jax.vmap(lambda key: jax.random.permutation(key, count))(jax.random.split(key, self.epochs))
        state, metrics = jax.lax.scan(minibatch, state, orders.reshape(-1, count // parts))
        metrics = jax.tree.map(jnp.mean, metrics)
        return state, metrics | {"q": jnp.mean(values)}

    def loss(
        self, params: tuple[Parameters, Parameters], part: dict[str, Any], hyper: PPOHyperparameters
    ) -> tuple[jax.Array, dict[str, jax.Array]]:
        """(policy loss - entropy_weight H + value loss, metrics), equation 9 of PPO, of (actor, value network)."""
        actor, value = params
        log_density, entropy = self.log_density(actor, part["observation"], part["twist"])
        critic_loss = value_loss(self.value(value, part["observation"]), part["return"])
        actor_loss = self.policy_loss(log_density, part["log_density"], part["advantage"], hyper)
        entropy = jnp.mean(entropy)
        metrics = {"critic_loss": critic_loss, "actor_loss": actor_loss, "twist_entropy": entropy}
        return actor_loss - hyper.entropy_weight * entropy + critic_loss, metrics

    def gaussian(self, actor: Parameters, observation: Observation) -> tuple[jax.Array, jax.Array]:
        """Mean and log_std of the twist, `[..., 2]` each."""
        heard = message_codes(observation.dialogue)
        outputs: Any = self.actor_network.apply(actor, observation, heard, method="gaussian")
        return outputs

    def log_density(self, actor: Parameters, observation: Observation, twist: jax.Array) -> tuple[jax.Array, jax.Array]:
        """(log density of the twists that were tried, entropy), each `[...]`."""
        mean, log_std = self.gaussian(actor, observation)
        noise = (twist - mean) * jnp.exp(-log_std)
        constant = 0.5 * jnp.log(2.0 * jnp.pi)
        return jnp.sum(-0.5 * noise * noise - log_std - constant, axis=-1), jnp.sum(log_std + constant + 0.5, axis=-1)

    def value(self, params: Parameters, observation: Observation) -> jax.Array:
        """V `[...]`."""
        v: Any = self.value_network.apply(params, observation, message_codes(observation.dialogue))
        return v


def _shortened(gradient, longest):
    """A gradient of that norm at most: a traced number, which `optax.clip_by_global_norm` doesn't take."""
    scale = jnp.minimum(1.0, longest / (optax.tree.norm(gradient) + 1e-6))
    return jax.tree.map(lambda leaf: scale * leaf, gradient)
