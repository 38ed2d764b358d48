"""Hybrid soft actor-critic: a twist and a request from one policy (Delalleau et al. 2019, "Discrete and continuous action
representation for practical RL in video games"; docs/world.md section 5).

Everything is a pure function of explicit state. Floats that one may want to vary between the members of a population
are leaves of `HSACHyperparameters`; `HSACConfig` holds sizes.
"""

import dataclasses
from typing import Any

import chex
import jax
import jax.numpy as jnp
import optax
from flax import struct

from ..language.vocabulary import vocabulary
from ..world import Action
from ..world.types import MESSAGES
from .distributions import BINS, entropy, histogram, request_log_probabilities, sample_twist
from .layers import NORMS
from .learner import ADAM, Batch, ReplayConfig, descend
from .networks import Actor, TwinCritic, message_codes, spoken_words

LANGUAGES = ("phrases", "codes")
HEADS = ("shared", "per-request")


@dataclasses.dataclass(frozen=True)
class HSACConfig(ReplayConfig):
    """Sizes of the learner: static under ``jit``.

    Attributes:
        language: what the actor hears: phrases, the embedding of a sentence; codes, the message itself as a one-hot.
        requests: what the robot may ask: 4; 2, none and stop; 1, nothing at all.
        heads: of the twist: shared, one for all requests; per-request, one for each.
        mean_tanh: squash the mean of the twist once more, as the paper's authors do: it can't quite stop.
        twins: the critics' judgement is their min or their mean.
        critic: what a critic predicts: scalar, or a histogram of which the value is the mean: 51 bins from -12 to 20,
            in units of scaled rewards, beyond which values are clipped.
        critic_norm: layer, none, or batch: without target critics, like CrossQ, but with the batch's own statistics.
    """

    language: str = "phrases"
    requests: int = 4
    heads: str = "shared"
    mean_tanh: bool = False
    twins: str = "min"
    critic: str = "scalar"
    critic_norm: str = "layer"

    def __post_init__(self):
        super().__post_init__()
        choices = {
            "language": LANGUAGES, "requests": (1, 2, 4), "heads": HEADS, "twins": ("min", "mean"),
            "critic": ("scalar", "histogram"), "critic_norm": tuple(NORMS),
        }  # fmt: skip
        for name, allowed in choices.items():
            if getattr(self, name) not in allowed:
                choose = f"choose from {', '.join(map(str, allowed))}"
                raise ValueError(f"agent.{name} {getattr(self, name)!r} is unknown: {choose}")


@struct.dataclass
class HSACHyperparameters:
    """Floats of the learner, leaves for ``vmap``.

    Attributes:
        actor_lr: learning rate of the actor.
        critic_lr: learning rate of the critics.
        temperature_lr: learning rate of the two log temperatures.
        final_lr: fraction of these rates that is left at the end of training; they decay linearly.
        discount: of the return, a step.
        tau: share of the critics that enters the target critics at each update.
        average: share of the actor that enters, at each of its updates, the averaged one that is evaluated.
        target_entropy_twist: nats, of the twist in [-1, 1]^2.
        target_entropy_request: fraction of log(number of requests), where requests count.
        initial_temperature: of twist and request.
        backup_entropy: share of the entropy bonus that enters the critics' targets.
        reward_scale: factor on rewards.
        word_noise: norm of the noise on the unit vectors of what is said, in training.
        word_errors: share of what is said that speech recognition garbles, in training.
        message_weight: of the auxiliary loss, by which the actor learns what phrases mean.
    """

    actor_lr: float = 1e-3
    critic_lr: float = 1e-3
    temperature_lr: float = 3e-3
    final_lr: float = 1.0
    discount: float = 0.97
    tau: float = 0.01
    average: float = 0.01
    target_entropy_twist: float = -2.0
    target_entropy_request: float = 0.36
    initial_temperature: float = 0.05
    backup_entropy: float = 1.0
    reward_scale: float = 0.01
    word_noise: float = 0.6
    word_errors: float = 0.1
    message_weight: float = 1.0


@struct.dataclass
class HSACState:
    """Parameters of actor, of its average, of critics and target critics, log temperatures, states of optimisers."""

    actor: chex.ArrayTree
    averaged: chex.ArrayTree
    critic: chex.ArrayTree
    target_critic: chex.ArrayTree
    log_temperatures: dict
    actor_optimiser: chex.ArrayTree
    critic_optimiser: chex.ArrayTree
    temperature_optimiser: chex.ArrayTree


_LOG_TEMPERATURE_RANGE = (-10.0, 2.0)
_PHRASES = 128  # of the auxiliary loss, an update
_SMOOTHING = 0.05  # of its labels: what a sentence means is never quite certain
_ACTOR_METRICS = (
    "actor_loss", "twist_entropy", "request_entropy", "twist_temperature", "request_temperature", "message_loss",
)  # fmt: skip


class HSAC:
    """The bundle of pure functions: `init`, `act`, `update`."""

    replays, horizon = True, 1

    def __init__(self, config: HSACConfig = HSACConfig()):
        self.config = config
        per_request = config.heads == "per-request"
        self.actor_network = Actor(
            config.encoder, config.actor_widths, config.language, config.requests, per_request, config.mean_tanh
        )
        bins = len(BINS) if config.critic == "histogram" else 1
        self.critic_network = TwinCritic(
            config.encoder, config.critic_widths, config.requests * bins, config.critic_norm
        )
        # What is spoken in training. Requests need no words.
        self.training_vocabulary: Any = vocabulary("train") if config.language == "phrases" else None

    def init(self, key, observation, hyper: HSACHyperparameters) -> HSACState:
        """Fresh parameters for observations shaped like ``observation`` (one, without a batch axis)."""
        key_actor, key_critic = jax.random.split(key)
        actor = self.actor_network.init(
            key_actor, observation, self._words(observation, self.training_vocabulary), method=_whole_actor
        )
        critic = self.critic_network.init(key_critic, observation, message_codes(observation.dialogue), jnp.zeros(2))
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

    def policy(self, learner: HSACState) -> chex.ArrayTree:
        """The actor that is evaluated."""
        return learner.averaged

    def act(self, key, learner: HSACState, observation, hyper: HSACHyperparameters) -> Action:
        """Sample an action for each observation `[..., ...]`; a request that would not count is none."""
        key_twist, key_request = jax.random.split(key)
        mean, log_std, logits = self._policy(learner.actor, observation, self._noisy_vocabulary(hyper))
        twist, _ = sample_twist(key_twist, mean, log_std)
        request = jax.random.categorical(key_request, request_log_probabilities(logits, observation.may_request))
        return Action(twist=self._of_request(twist, request), request=request.astype(jnp.int32))

    def best_action(self, actor, observation, voice=True, vocabulary=None) -> Action:
        """Mean twist and most probable request; without ``voice`` the request is none.

        vocabulary: the `Vocabulary` from which what is said is drawn; by default that of training, without noise.
        """
        mean, _, logits = self._policy(
            actor, observation, self.training_vocabulary if vocabulary is None else vocabulary
        )
        return self._best(mean, logits, observation, voice)

    def vocabulary(self, split):
        """The `Vocabulary` of a split of phrases; None if this agent hears codes."""
        return vocabulary(split) if self.config.language == "phrases" else None

    def answer(self, actor, observation, heard) -> Action:
        """The best action of one who understands S_c ``heard`` `[K, 3]`, whatever the observation says."""
        mean, _, logits = self._heard_policy(actor, observation, heard)
        return self._best(mean, logits, observation, True)

    def understand(self, actor, words) -> Any:
        """Log-probabilities of message `[..., 4]` and reply `[..., 3]` of words `[..., D]`."""
        return self.actor_network.apply(actor, words, method="understand")

    def _best(self, mean, logits, observation, voice):
        log_p = request_log_probabilities(logits, observation.may_request & voice)
        request = jnp.argmax(log_p, axis=-1).astype(jnp.int32)
        return Action(twist=self._of_request(jnp.tanh(mean), request), request=request)

    def _of_request(self, twist, request):
        """The twist `[..., 2]` that goes with a request."""
        if self.config.heads == "shared":
            return twist
        return jnp.take_along_axis(twist, request[..., None, None], axis=-2)[..., 0, :]

    def update(self, key, state: HSACState, batch: Batch, hyper: HSACHyperparameters, lr_scale=1.0, step=0):
        """One step on critics, actor and temperatures. Returns (state, metrics).

        lr_scale: multiplies every rate; step: how many updates came before, for delays.
        """
        key_critic, key_actor = jax.random.split(key)
        temperatures = jax.tree.map(jnp.exp, state.log_temperatures)

        (critic_loss, q), gradient = jax.value_and_grad(self._critic_loss, has_aux=True)(
            state.critic, key_critic, state, batch, temperatures, hyper
        )
        change, critic_optimiser = ADAM.update(gradient, state.critic_optimiser)
        critic = descend(state.critic, change, hyper.critic_lr * lr_scale)
        state = state.replace(
            critic=critic,
            target_critic=optax.incremental_update(critic, state.target_critic, hyper.tau),
            critic_optimiser=critic_optimiser,
        )
        if self.config.actor_every == 1:
            state, metrics = self._update_actor(key_actor, state, batch, temperatures, hyper, lr_scale)
        else:
            state, metrics = jax.lax.cond(
                step % self.config.actor_every == 0,
                lambda state: self._update_actor(key_actor, state, batch, temperatures, hyper, lr_scale),
                lambda state: (state, dict.fromkeys(_ACTOR_METRICS, jnp.float32(0.0))),
                state,
            )
            # The mean over updates is then that of those that had one.
            metrics = {name: self.config.actor_every * value for name, value in metrics.items()}
        return state, {"critic_loss": critic_loss, "q": q, **metrics}

    def _update_actor(self, key, state, batch, temperatures, hyper, lr_scale):
        """(state, metrics) after a step on the actor and the temperatures."""
        (actor_loss, entropies), gradient = jax.value_and_grad(self._actor_loss, has_aux=True)(
            state.actor, key, state.critic, batch, temperatures, hyper
        )
        change, actor_optimiser = ADAM.update(gradient, state.actor_optimiser)
        actor = descend(state.actor, change, hyper.actor_lr * lr_scale)

        # d/d log alpha of alpha (H - target): too little entropy raises the temperature.
        targets = {
            "twist": hyper.target_entropy_twist, "request": hyper.target_entropy_request * jnp.log(self.config.requests),
        }  # fmt: skip
        spoke = entropies["counted"] > 0
        gradient = {name: temperatures[name] * (entropies[name] - targets[name]) for name in targets}
        gradient["request"] = jnp.where(spoke, gradient["request"], 0.0)
        change, temperature_optimiser = ADAM.update(gradient, state.temperature_optimiser)
        log_temperatures = jax.tree.map(
            lambda leaf: jnp.clip(leaf, *_LOG_TEMPERATURE_RANGE),
            descend(state.log_temperatures, change, hyper.temperature_lr * lr_scale),
        )
        state = state.replace(
            actor=actor,
            averaged=optax.incremental_update(actor, state.averaged, hyper.average),
            log_temperatures=log_temperatures,
            actor_optimiser=actor_optimiser,
            temperature_optimiser=temperature_optimiser,
        )
        values = (
            actor_loss, entropies["twist"], entropies["request"], temperatures["twist"], temperatures["request"],
            entropies["message_loss"],
        )  # fmt: skip
        return state, dict(zip(_ACTOR_METRICS, values, strict=True))

    def _words(self, observation, spoken):
        if self.config.language == "codes":
            return message_codes(observation.dialogue)
        return spoken_words(observation.dialogue, spoken)

    def _noisy_vocabulary(self, hyper) -> Any:
        if self.config.language == "codes":
            return None
        return self.training_vocabulary.replace(noise=hyper.word_noise, error_share=hyper.word_errors)

    def _policy(self, actor, observation, spoken) -> Any:
        """Mean, log_std and logits."""
        return self.actor_network.apply(actor, observation, self._words(observation, spoken))

    def _heard_policy(self, actor, observation, heard) -> Any:
        """The same, of one who understands S_c ``heard``."""
        return self.actor_network.apply(actor, observation, heard, method="act")

    def _q(self, critic, observation, twist) -> Any:
        """What the critics say of every request `[2, ..., requests]`, each with ``twist`` `[..., 2]` or with its own
        `[..., requests, 2]`; of histograms `[2, ..., requests, bins]`. Critics serve training only: they are told what was
        meant."""
        q = self.critic_network.apply(critic, observation, message_codes(observation.dialogue), twist)
        own = twist.ndim > observation.twist.ndim
        q = q.reshape(*q.shape[:-1], self.config.requests, -1)
        if own:
            q = jnp.moveaxis(jnp.diagonal(q, axis1=-3, axis2=-2), -1, -2)
        return q if self.config.critic == "histogram" else q[..., 0]

    def _judge(self, q):
        """Q `[..., requests]` of what both critics say."""
        if self.config.critic == "histogram":
            q = jax.nn.softmax(q, axis=-1) @ BINS
        return q.min(axis=0) if self.config.twins == "min" else q.mean(axis=0)

    def _value(self, q, log_density, log_p, counts, temperatures):
        return soft_value(self._judge(q), log_density, log_p, counts, temperatures)

    def _sample(self, key, policy, counts):
        """(twist, its log density `[..., 1 or requests]`, log p of the requests `[..., requests]`) of a policy's outputs."""
        mean, log_std, logits = policy
        twist, log_density = sample_twist(key, mean, log_std)
        if self.config.heads == "shared":
            log_density = log_density[..., None]
        return twist, log_density, request_log_probabilities(logits, counts)

    def _critic_loss(self, critic, key, state, batch, temperatures, hyper):
        """Soft Bellman error; the policy of the next state is that of a robot told what was meant.

        An approximation, on purpose: phrases of the train split are understood soon, and reading them again costs time.
        """
        after = batch.next_observation
        policy = self._heard_policy(state.actor, after, message_codes(after.dialogue))
        twist, log_density, log_p = self._sample(key, policy, after.may_request)
        if self.config.critic_norm == "batch":
            # Both ends in one batch: its statistics are those of both.
            if self.config.heads == "per-request":
                now = jnp.broadcast_to(batch.twist[..., None, :], twist.shape)
            else:
                now = batch.twist
            both = jax.tree.map(lambda *leaves: jnp.concatenate(leaves), batch.observation, after)
            q, next_q = jnp.split(self._q(critic, both, jnp.concatenate([now, twist])), 2, axis=1)
            next_q = jax.lax.stop_gradient(next_q)
        else:
            q, next_q = self._q(critic, batch.observation, batch.twist), self._q(state.target_critic, after, twist)
        bonus = jax.tree.map(lambda alpha: hyper.backup_entropy * alpha, temperatures)
        value = self._value(next_q, log_density, log_p, after.may_request, bonus)
        target = hyper.reward_scale * batch.reward + (1.0 - batch.terminated) * hyper.discount**batch.steps * value
        target = jax.lax.stop_gradient(target)
        request = batch.request[None, :, None]
        if self.config.critic == "histogram":
            log_q = jax.nn.log_softmax(jnp.take_along_axis(q, request[..., None], axis=2)[:, :, 0], axis=-1)
            loss = -jnp.sum(histogram(target) * log_q, axis=-1)
            chosen = jnp.exp(log_q) @ BINS
        else:
            chosen = jnp.take_along_axis(q, request, axis=-1)[..., 0]
            loss = optax.huber_loss(chosen, target[None], delta=self.config.huber_delta)
        return jnp.sum(jnp.mean(loss, axis=1)), jnp.mean(chosen)

    def _actor_loss(self, actor, key, critic, batch, temperatures, hyper):
        """-V(s) with every sample reparameterised and the request's probabilities not detached, and what phrases mean."""
        key, key_phrases = jax.random.split(key)
        policy = self._policy(actor, batch.observation, self._noisy_vocabulary(hyper))
        counts = batch.observation.may_request
        twist, log_density, log_p = self._sample(key, policy, counts)
        q = self._q(critic, batch.observation, twist)
        loss = -jnp.mean(self._value(q, log_density, log_p, counts, temperatures))
        counted = jnp.sum(counts)
        request_entropy = jnp.sum(jnp.where(counts, entropy(log_p), 0.0)) / jnp.maximum(counted, 1)
        message_loss = self._message_loss(actor, key_phrases, hyper)
        entropies = {
            "twist": -jnp.mean(jnp.sum(jnp.exp(log_p) * log_density, axis=-1)), "request": request_entropy,
            "counted": counted, "message_loss": message_loss,
        }  # fmt: skip
        return loss + hyper.message_weight * message_loss, jax.lax.stop_gradient(entropies)

    def _message_loss(self, actor, key, hyper):
        """Cross-entropy of message and reply over phrases of the train split, every message as often as any other."""
        if self.config.language == "codes":
            return jnp.float32(0.0)
        spoken = self._noisy_vocabulary(hyper)
        key_message, key_word = jax.random.split(key)
        message = jax.random.randint(key_message, (_PHRASES,), 0, len(MESSAGES))
        index, word = spoken.phrase(message, jax.random.bits(key_word, (_PHRASES,), jnp.uint32))
        meant = jnp.asarray(spoken.message)[index], jnp.asarray(spoken.reply)[index]
        said = self.understand(actor, spoken.vectors(index, word))
        return sum(
            -jnp.mean((1.0 - _SMOOTHING) * jnp.take_along_axis(p, label[:, None].astype(jnp.int32), axis=-1))
            - _SMOOTHING * jnp.mean(jnp.where(p > -1e8, p, 0.0))
            for p, label in zip(said, meant, strict=True)
        )


def soft_value(q, log_density, log_p, counts, temperatures):
    """V(s) `[...]` = sum_k p_k (Q_k - alpha_twist log pi_k(twist_k)) + alpha_request (H(p) - log n).

    q, log_p: `[..., requests]`; log_density: `[..., requests]`, or `[..., 1]` of one twist for all; counts: where a request
    counts, n is the number of requests there and 1 elsewhere. Subtracting log n keeps the discrete bonus from paying for
    staying alive.
    """
    bonus = jnp.where(counts, entropy(log_p) - jnp.log(log_p.shape[-1]), 0.0)
    expected = jnp.sum(jnp.exp(log_p) * (q - temperatures["twist"] * log_density), axis=-1)
    return expected + temperatures["request"] * bonus


def _whole_actor(actor, observation, words):
    """What `Actor` computes, and what it understands: all its parameters."""
    if actor.language == "phrases":
        actor.understand(words)
    return actor(observation, words)
