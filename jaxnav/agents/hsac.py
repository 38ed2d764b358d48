"""Hybrid soft actor-critic: a twist and a request from one policy (Delalleau et al. 2019, "Discrete and continuous
action representation for practical RL in video games"; docs/world.md section 5).

Everything is a pure function of explicit state. Floats that one may want to vary between the members of a population
are leaves of `HSACHyperparameters`; `HSACConfig` holds sizes.
"""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import optax
from flax import struct

from .. import fields
from ..language.vocabulary import Vocabulary, vocabulary
from ..world import Action, Observation
from ..world.types import REQUESTS
from .configs import ReplayConfig
from .distributions import request_log_probabilities, sample_twist
from .hybrid import HybridNetworks
from .learner import ADAM, Batch, Parameters, descend
from .losses.hsac import actor_loss, critic_loss, temperature_slope
from .networks import message_codes

LANGUAGES = ("phrases", "codes")
HEADS = ("shared", "per-request")
_LOG_TEMPERATURE_RANGE = (-10.0, 2.0)


@dataclasses.dataclass(frozen=True)
class HSACConfig(ReplayConfig):
    """Sizes of the learner: static under ``jit``."""

    language: str = fields.choice(
        "phrases",
        LANGUAGES,
        doc="the actor hears phrases, the embedding of a sentence, or codes, the message itself as a one-hot",
    )
    requests: int = fields.choice(
        4,
        (1, 2, *range(4, len(REQUESTS) + 1)),
        doc="how many requests the robot chooses from: 4; 2, none and stop; 1, nothing at all",
    )
    heads: str = fields.choice(
        "shared", HEADS, doc="of the twist: shared, one for all requests, or per-request, one for each"
    )


@struct.dataclass
class HSACHyperparameters:
    """Floats of the learner, leaves for ``vmap``."""

    actor_lr: float = fields.number(1e-3, low=0, doc="learning rate of the actor")
    critic_lr: float = fields.number(1e-3, low=0, doc="learning rate of the critics")
    temperature_lr: float = fields.number(3e-3, low=0, doc="learning rate of the two log temperatures")
    final_lr: float = fields.probability(
        1.0, doc="fraction of these rates that is left at the end of training; they decay linearly"
    )
    discount: float = fields.probability(0.97, doc="of the return, a step")
    tau: float = fields.probability(0.01, doc="share of the critics that enters the target critics at each update")
    average: float = fields.probability(
        0.01, doc="share of the actor that enters, at each update, the averaged one that is evaluated"
    )
    target_entropy_twist: float = fields.number(-2.0, unit="nats", doc="entropy aimed at, of the twist in [-1, 1]^2")
    target_entropy_request: float = fields.probability(
        0.36, doc="entropy aimed at, of requests where they count: fraction of log(number of requests)"
    )
    initial_temperature: float = fields.number(0.05, above=0, doc="temperature of twist and request before training")
    reward_scale: float = fields.number(0.01, above=0, doc="factor on rewards")
    word_noise: float = fields.number(0.6, low=0, doc="norm of the noise on the unit vectors of sentences, in training")
    word_errors: float = fields.probability(0.1, doc="share of sentences that speech recognition garbles, in training")
    message_weight: float = fields.number(
        1.0, low=0, doc="weight of the auxiliary loss by which the actor learns the meaning of phrases"
    )


@struct.dataclass
class HSACState:
    """The part that training changes.

    Attributes:
        actor: its parameters.
        averaged: their running average, which is evaluated.
        critic: parameters of both critics.
        target_critic: those of the target critics.
        log_temperatures: of twist and request.
        actor_optimiser: the state of its optimiser.
        critic_optimiser: likewise.
        temperature_optimiser: likewise.
    """

    actor: Parameters
    averaged: Parameters
    critic: Parameters
    target_critic: Parameters
    log_temperatures: dict
    actor_optimiser: Any
    critic_optimiser: Any
    temperature_optimiser: Any


class HSAC:
    """The `HearingLearner`: a bundle of pure functions."""

    replays, horizon = True, 1

    def __init__(self, config: HSACConfig = HSACConfig()):
        self.config, self.requests = config, config.requests
        self.can_ask, self.can_hear = config.requests > 1, config.language == "phrases"
        self.networks = HybridNetworks(config)
        self.actor_network, self.squash = self.networks.actor, "tanh"  # for export
        # The sentences of training. Requests need no words.
        self.training_vocabulary = self.vocabulary("train")

    def init(self, key: jax.Array, observation: Observation, hyper: HSACHyperparameters) -> HSACState:
        """Fresh parameters for observations shaped like ``observation`` (one, without a batch axis)."""
        key_actor, key_critic = jax.random.split(key)
        words = self.networks.words(observation, self.training_vocabulary)
        actor = self.networks.actor.init(key_actor, observation, words, method=_whole_actor)
        codes = message_codes(observation.dialogue)
        critic = self.networks.critic.init(key_critic, observation, codes, jnp.zeros(2))
        log_temperatures = {name: jnp.log(jnp.float32(hyper.initial_temperature)) for name in ("twist", "request")}
        return HSACState(
            actor=actor,
            averaged=jax.tree.map(jnp.copy, actor),
            critic=critic,
            target_critic=jax.tree.map(jnp.copy, critic),
            log_temperatures=log_temperatures,
            actor_optimiser=ADAM.init(actor),
            critic_optimiser=ADAM.init(critic),
            temperature_optimiser=ADAM.init(log_temperatures),
        )

    def policy(self, state: HSACState) -> Parameters:
        """The parameters of the averaged actor."""
        return state.averaged

    def act(self, key: jax.Array, state: HSACState, observation: Observation, hyper: HSACHyperparameters) -> Action:
        """Sample an action for each observation `[..., ...]`; a request that would not count is none."""
        key_twist, key_request = jax.random.split(key)
        mean, log_std, logits = self.networks.policy(state.actor, observation, self._noisy_vocabulary(hyper))
        twist, _ = sample_twist(key_twist, mean, log_std)
        request = jax.random.categorical(key_request, request_log_probabilities(logits, observation.may_request))
        return Action(twist=self.networks.twist_of(twist, request), request=request.astype(jnp.int32))

    def best_action(
        self,
        parameters: Parameters,
        observation: Observation,
        voice: jax.Array | bool = True,
        vocabulary: Vocabulary | None = None,
    ) -> Action:
        """Mean twist and most probable request; without ``voice`` the request is none.

        vocabulary: from which sentences are drawn; by default that of training, without noise.
        """
        if vocabulary is None or not self.can_hear:
            vocabulary = self.training_vocabulary
        return self._best(self.networks.policy(parameters, observation, vocabulary), observation, voice)

    def vocabulary(self, split: str) -> Vocabulary | None:
        """The `Vocabulary` of a split of phrases; None if this learner hears codes."""
        return vocabulary(split) if self.can_hear else None

    def answer(self, parameters: Parameters, observation: Observation, heard: jax.Array) -> Action:
        """The best action of a robot that understands S_c ``heard`` `[K, 3]`, whatever the observation says."""
        return self._best(self.networks.heard_policy(parameters, observation, heard), observation, True)

    def understand(self, parameters: Parameters, words: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Log-probabilities of message `[..., 4]` and reply `[..., 3]` of words `[..., D]`."""
        return self.networks.understand(parameters, words)

    def update(
        self, key: jax.Array, state: HSACState, batch: Batch, hyper: HSACHyperparameters,
        lr_scale: jax.Array | float = 1.0, step: jax.Array | int = 0,
    ) -> tuple[HSACState, dict[str, jax.Array]]:  # fmt: skip
        """One step on critics, actor and temperatures. lr_scale: multiplies every rate."""
        del step
        key_critic, key_actor = jax.random.split(key)
        temperatures = jax.tree.map(jnp.exp, state.log_temperatures)

        (loss, q), gradient = jax.value_and_grad(critic_loss, has_aux=True)(
            state.critic, key_critic, self.networks, state.target_critic, state.actor, batch, temperatures, hyper,
            self.config.huber_delta,
        )  # fmt: skip
        change, critic_optimiser = ADAM.update(gradient, state.critic_optimiser)
        critic = descend(state.critic, change, hyper.critic_lr * lr_scale)
        metrics = {"critic_loss": loss, "q": q}

        (loss, entropies), gradient = jax.value_and_grad(actor_loss, has_aux=True)(
            state.actor, key_actor, self.networks, critic, batch, self._noisy_vocabulary(hyper), temperatures, hyper
        )
        change, actor_optimiser = ADAM.update(gradient, state.actor_optimiser)
        actor = descend(state.actor, change, hyper.actor_lr * lr_scale)

        gradient = temperature_slope(entropies, temperatures, self.requests, hyper)
        change, temperature_optimiser = ADAM.update(gradient, state.temperature_optimiser)
        log_temperatures = descend(state.log_temperatures, change, hyper.temperature_lr * lr_scale)
        state = HSACState(
            actor=actor,
            averaged=optax.incremental_update(actor, state.averaged, hyper.average),
            critic=critic,
            target_critic=optax.incremental_update(critic, state.target_critic, hyper.tau),
            log_temperatures=jax.tree.map(lambda leaf: jnp.clip(leaf, *_LOG_TEMPERATURE_RANGE), log_temperatures),
            actor_optimiser=actor_optimiser,
            critic_optimiser=critic_optimiser,
            temperature_optimiser=temperature_optimiser,
        )
        metrics |= {
            "actor_loss": loss, "twist_entropy": entropies["twist"], "request_entropy": entropies["request"],
            "twist_temperature": temperatures["twist"], "request_temperature": temperatures["request"],
            "message_loss": entropies["message_loss"],
        }  # fmt: skip
        return state, metrics

    def _best(self, policy, observation, voice):
        mean, _, logits = policy
        log_p = request_log_probabilities(logits, observation.may_request & voice)
        request = jnp.argmax(log_p, axis=-1).astype(jnp.int32)
        return Action(twist=self.networks.twist_of(jnp.tanh(mean), request), request=request)

    def _noisy_vocabulary(self, hyper):
        if self.training_vocabulary is None:
            return None
        return dataclasses.replace(self.training_vocabulary, noise=hyper.word_noise, error_share=hyper.word_errors)


def _whole_actor(actor, observation, words):
    """The outputs of an `Actor`, of which all parameters are made: those that understand sentences, too."""
    if actor.language == "phrases":
        actor.understand(words)
    return actor(observation, words)
