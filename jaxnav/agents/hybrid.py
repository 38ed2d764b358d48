"""The networks of hybrid SAC as functions of parameters and observations."""

from typing import Any

import jax
import jax.numpy as jnp

from ..language.vocabulary import Vocabulary
from ..world import Observation
from .distributions import request_log_probabilities, sample_twist
from .learner import Parameters
from .networks import Actor, TwinCritic, message_codes, message_words

PolicyOutputs = tuple[jax.Array, jax.Array, jax.Array]  # mean, log_std, and logits of the request


class HybridNetworks:
    """Actor and critics of an `HSACConfig`. ``per_request``: whether each request has a twist of its own."""

    def __init__(self, config: Any):
        self.per_request = config.heads == "per-request"
        self.actor = Actor(
            config.encoder,
            config.actor_widths,
            config.encoder_widths,
            config.language,
            config.requests,
            self.per_request,
        )
        self.critic = TwinCritic(config.encoder, config.critic_widths, config.encoder_widths, config.requests)

    def words(self, observation: Observation, vocabulary: Vocabulary | None) -> jax.Array:
        """Words `[..., K, D]`, drawn from the vocabulary; without one the messages themselves, S_c `[..., K, 3]`."""
        if vocabulary is None:
            return message_codes(observation.dialogue)
        return message_words(observation.dialogue, vocabulary)

    def policy(self, actor: Parameters, observation: Observation, vocabulary: Vocabulary | None) -> PolicyOutputs:
        """The actor's outputs; sentences are drawn from the vocabulary."""
        outputs: Any = self.actor.apply(actor, observation, self.words(observation, vocabulary))
        return outputs

    def heard_policy(self, actor: Parameters, observation: Observation, heard: jax.Array) -> PolicyOutputs:
        """The actor's outputs for a robot that understands S_c ``heard`` `[..., K, 3]`."""
        outputs: Any = self.actor.apply(actor, observation, heard, method="act")
        return outputs

    def understand(self, actor: Parameters, words: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Log-probabilities of message `[..., 4]` and reply `[..., 3]` of words `[..., D]`."""
        outputs: Any = self.actor.apply(actor, words, method="understand")
        return outputs

    def q(self, critic: Parameters, observation: Observation, twist: jax.Array) -> jax.Array:
        """Both critics' Q of every request `[2, ..., requests]`.

        Each request is judged with ``twist`` `[..., 2]`, or with its own of `[..., requests, 2]`. Critics serve
        training only: they are told what was meant.
        """
        q: Any = self.critic.apply(critic, observation, message_codes(observation.dialogue), twist)
        return jnp.diagonal(q, axis1=-2, axis2=-1) if twist.ndim > observation.twist.ndim else q

    def sample(self, key: jax.Array, policy: PolicyOutputs, counts: jax.Array) -> PolicyOutputs:
        """(twist, its log density `[..., 1 or requests]`, log p of the requests `[..., requests]`)."""
        mean, log_std, logits = policy
        twist, log_density = sample_twist(key, mean, log_std)
        if not self.per_request:
            log_density = log_density[..., None]
        return twist, log_density, request_log_probabilities(logits, counts)

    def twist_of(self, twist: jax.Array, request: jax.Array) -> jax.Array:
        """The twist `[..., 2]` that goes with a request."""
        if not self.per_request:
            return twist
        return jnp.take_along_axis(twist, request[..., None, None], axis=-2)[..., 0, :]
