"""PPO: clipped policy gradient with generalised advantages (Schulman et al. 2017), and what A2C shares with it.

They steer and are silent.
"""

import dataclasses
from typing import Any, ClassVar

import chex
import jax
import jax.numpy as jnp
import optax
from flax import struct

from ..world import Action
from .learner import ADAM, Batch, LearnerConfig, descend, silent
from .networks import LOG_STD_RANGE, Actor, Value, message_codes


@dataclasses.dataclass(frozen=True)
class RolloutConfig(LearnerConfig):
    """Sizes of a learner that learns from what it has just played: static under ``jit``.

    Attributes:
        horizon: steps of all episodes that an update learns from; divides train.steps_per_chunk.
    """

    horizon: int = 5

    epochs: ClassVar = 1
    minibatches: ClassVar = 1

    def __post_init__(self):
        super().__post_init__()
        self._check_whole("horizon", "epochs", "minibatches")

    def updates(self, steps):
        """How many updates ``steps`` steps of all episodes make."""
        return steps // self.horizon * self.epochs * self.minibatches


@dataclasses.dataclass(frozen=True)
class PPOConfig(RolloutConfig):
    """Sizes of the learner: static under ``jit``.

    Attributes:
        horizon: steps of all episodes that an update learns from; divides train.steps_per_chunk.
        epochs: how often each of them is used.
        minibatches: into how many parts they are split each time; divides horizon times train.episodes.
    """

    horizon: int = 25
    epochs: int = 8
    minibatches: int = 4


@struct.dataclass
class PPOHyperparameters:
    """Floats of the learner, leaves for ``vmap``.

    Attributes:
        actor_lr: learning rate of the actor.
        critic_lr: learning rate of the value network.
        final_lr: fraction of these rates that is left at the end of training; they decay linearly.
        average: share of the actor that enters, at each update, the averaged one that is evaluated.
        discount: of the return, a step.
        gae_lambda: share of the advantages that is taken from further steps.
        clip: the most by which the ratio of probabilities may differ from 1 to be rewarded.
        entropy_weight: of the bonus on entropy.
        max_gradient_norm: longest gradient of actor or value network that is followed.
        initial_std: standard deviation of the twist before training.
        reward_scale: factor on rewards.
    """

    actor_lr: float = 1e-3
    critic_lr: float = 1e-3
    final_lr: float = 1.0
    average: float = 0.01
    discount: float = 0.97
    gae_lambda: float = 0.95
    clip: float = 0.2
    entropy_weight: float = 0.003
    max_gradient_norm: float = 0.5
    initial_std: float = 0.5
    reward_scale: float = 0.01


@struct.dataclass
class PPOState:
    """Parameters of actor, of its average, and of the value network, and the state of their optimisers."""

    actor: chex.ArrayTree
    averaged: chex.ArrayTree
    value: chex.ArrayTree
    actor_optimiser: chex.ArrayTree
    value_optimiser: chex.ArrayTree


class PPO:
    """The bundle of pure functions: `init`, `act`, `update`. Messages are heard as codes.

    The twist is a Gaussian that the world clips: no tanh, so that its density is known wherever it falls.
    """

    replays = False

    def __init__(self, config: RolloutConfig = PPOConfig()):
        self.config = config
        self.horizon = config.horizon
        self.actor_network = Actor(config.encoder, config.actor_widths)
        self.value_network = Value(config.encoder, config.critic_widths)

    def init(self, key, observation, hyper: PPOHyperparameters) -> PPOState:
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

    def policy(self, learner: PPOState) -> chex.ArrayTree:
        """The actor that is evaluated."""
        return learner.averaged

    def act(self, key, learner: PPOState, observation, hyper: PPOHyperparameters) -> Action:
        """Sample a twist, as yet unclipped, for each observation `[..., ...]`, and no request."""
        del hyper
        mean, log_std = self._gaussian(learner.actor, observation)
        twist = mean + jnp.exp(log_std) * jax.random.normal(key, mean.shape)
        return silent(twist)

    def best_action(self, actor, observation, voice=True, vocabulary=None) -> Action:
        """The mean twist; it has no voice, and hears codes, whatever the ``vocabulary``."""
        del voice, vocabulary
        mean, _ = self._gaussian(actor, observation)
        return silent(jnp.clip(mean, -1.0, 1.0))

    def vocabulary(self, split):
        """None: this agent hears codes."""
        del split

    def update(self, key, state: PPOState, batch: Batch, hyper: PPOHyperparameters, lr_scale=1.0, step=0):
        """``epochs`` passes over a batch of `[horizon, episodes]` steps in a row. Returns (state, metrics).

        lr_scale: multiplies every rate.
        Raises ValueError: the steps can't be parted into ``minibatches`` of the same size.
        """
        del step
        count, parts = batch.reward.size, self.config.minibatches
        if count % parts:
            raise ValueError(f"agent.minibatches is {parts}: give a divisor of the batch's {count} steps")
        values, next_values = self._values(state.value, batch)
        advantages = gae(batch, values, next_values, hyper)
        data = {
            "observation": batch.observation, "twist": batch.twist, "advantage": advantages,
            "return": advantages + values, "log_density": self._log_density(state.actor, batch.observation, batch.twist)[0],
        }  # fmt: skip
        data = jax.tree.map(lambda leaf: leaf.reshape(-1, *leaf.shape[2:]), data)

        def minibatch(state, rows):
            part = jax.tree.map(lambda leaf: leaf[rows], data)
            (_, aux), gradient = jax.value_and_grad(self._loss, has_aux=True)((state.actor, state.value), part, hyper)
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

        orders = jax.vmap(lambda key: jax.random.permutation(key, count))(jax.random.split(key, self.config.epochs))
        state, metrics = jax.lax.scan(minibatch, state, orders.reshape(-1, count // parts))
        metrics = jax.tree.map(jnp.mean, metrics)
        return state, metrics | {"q": jnp.mean(values)}

    def _gaussian(self, actor, observation) -> Any:
        return self.actor_network.apply(actor, observation, message_codes(observation.dialogue), method="gaussian")

    def _log_density(self, actor, observation, twist):
        """(log density of the twists that were tried, entropy), each `[...]`."""
        mean, log_std = self._gaussian(actor, observation)
        noise = (twist - mean) * jnp.exp(-log_std)
        constant = 0.5 * jnp.log(2.0 * jnp.pi)
        return jnp.sum(-0.5 * noise * noise - log_std - constant, axis=-1), jnp.sum(log_std + constant + 0.5, axis=-1)

    def _values(self, params, batch):
        """V of both ends of each step, `[horizon, episodes]` each."""
        return self._value(params, batch.observation), self._value(params, batch.next_observation)

    def _value(self, params, observation) -> Any:
        return self.value_network.apply(params, observation, message_codes(observation.dialogue))

    def _loss(self, params, part, hyper):
        """Loss of actor and value network, and metrics."""
        actor, value = params
        log_density, entropy = self._log_density(actor, part["observation"], part["twist"])
        error = self._value(value, part["observation"]) - part["return"]
        value_loss = 0.5 * jnp.mean(error * error)
        actor_loss = self._actor_loss(log_density, part, hyper)
        entropy = jnp.mean(entropy)
        metrics = {"critic_loss": value_loss, "actor_loss": actor_loss, "twist_entropy": entropy}
        return actor_loss - hyper.entropy_weight * entropy + value_loss, metrics

    def _actor_loss(self, log_density, part, hyper):
        """-min(ratio A, clipped ratio A), advantages normalised."""
        advantage = normalised(part["advantage"])
        # Bounded where the clip decides anyway: exp of more would be infinite, and its gradient not a number.
        ratio = jnp.exp(jnp.clip(log_density - part["log_density"], -20.0, 20.0))
        clipped = jnp.clip(ratio, 1.0 - hyper.clip, 1.0 + hyper.clip)
        return -jnp.mean(jnp.minimum(ratio * advantage, clipped * advantage))


def _shortened(gradient, longest):
    """A gradient of that norm at most: a traced number, which `optax.clip_by_global_norm` doesn't take."""
    scale = jnp.minimum(1.0, longest / (optax.tree.norm(gradient) + 1e-6))
    return jax.tree.map(lambda leaf: scale * leaf, gradient)


def normalised(advantage):
    """Advantages with mean 0 and standard deviation 1."""
    return (advantage - jnp.mean(advantage)) / (jnp.std(advantage) + 1e-8)


def gae(batch: Batch, values, next_values, hyper):
    """Generalised advantages `[horizon, episodes]` (Schulman et al. 2016).

    A time-out bootstraps from its true last state, an arrival or a collision from nothing; neither looks further.
    """
    bootstrap = hyper.discount * (1.0 - batch.terminated) * next_values
    errors = hyper.reward_scale * batch.reward + bootstrap - values
    keep = hyper.discount * hyper.gae_lambda * (1.0 - batch.ended)

    def back(advantage, step):
        error, kept = step
        advantage = error + kept * advantage
        return advantage, advantage

    return jax.lax.scan(back, jnp.zeros_like(errors[0]), (errors, keep), reverse=True)[1]
