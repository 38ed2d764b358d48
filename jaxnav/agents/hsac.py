"""Hybrid soft actor-critic: a twist and a code from one policy (Delalleau et al. 2019, "Discrete and continuous action
representation for practical RL in video games"; docs/world.md section 5).

Everything is a pure function of explicit state. Floats that one may want to vary between the members of a population
are leaves of `Hyperparameters`; `HSACConfig` holds sizes.
"""

import dataclasses
from typing import Any

import chex
import jax
import jax.numpy as jnp
import optax

from ..language.vocabulary import vocabulary
from ..world import Action, Snapshot
from ..world.types import MESSAGES, REQUESTS
from .distributions import code_log_probabilities, entropy, sample_twist
from .networks import ENCODERS, Actor, TwinCritic, message_codes, spoken_words

LANGUAGES = ("phrases", "codes")


@dataclasses.dataclass(frozen=True)
class HSACConfig:
    """Sizes of the learner: static under ``jit``.

    Attributes:
        encoder: how observations become features.
        language: what the actor hears: phrases, the embedding of a sentence; codes, the message itself as a one-hot.
        actor_widths: hidden layers of the actor.
        critic_widths: hidden layers of each critic.
        batch: transitions an update.
        updates_per_step: updates after each step of all episodes.
        huber_delta: error at which the critic loss turns linear.
    """

    encoder: str = "lidar"
    language: str = "phrases"
    actor_widths: tuple[int, ...] = (128, 128)
    critic_widths: tuple[int, ...] = (128, 128)
    batch: int = 512
    updates_per_step: int = 8
    huber_delta: float = 2.0

    def __post_init__(self):
        if self.encoder not in ENCODERS:
            raise ValueError(f"agent.encoder {self.encoder!r} is unknown: choose from {', '.join(ENCODERS)}")
        if self.language not in LANGUAGES:
            raise ValueError(f"agent.language {self.language!r} is unknown: choose from {', '.join(LANGUAGES)}")
        for name in ("batch", "updates_per_step"):
            value = getattr(self, name)
            if not isinstance(value, int) or value < 1:
                raise ValueError(f"agent.{name} is {value!r}: give a whole number of at least 1")
        for name in ("actor_widths", "critic_widths"):
            widths = getattr(self, name)
            if not widths or any(width < 1 for width in widths):
                raise ValueError(f"agent.{name} is {widths!r}: give at least one width, each at least 1")
        if not self.huber_delta > 0:
            raise ValueError(f"agent.huber_delta is {self.huber_delta!r}: give a number above 0")


@chex.dataclass(frozen=True)
class Hyperparameters:
    """Floats of the learner, leaves for ``vmap``.

    Attributes:
        actor_lr: learning rate of the actor.
        critic_lr: learning rate of the critics.
        temperature_lr: learning rate of the two log temperatures.
        final_lr: fraction of these rates that is left at the end of training; they decay linearly.
        discount: of the return, a step.
        tau: share of the critics that enters the target critics at each update.
        target_entropy_twist: nats, of the twist in [-1, 1]^2.
        target_entropy_code: fraction of log(number of codes), where codes count.
        initial_temperature: of twist and code.
        reward_scale: factor on rewards.
        word_noise: norm of the noise on the unit vectors of what is said, in training.
        word_errors: share of what is said that speech recognition garbles, in training.
        message_weight: of the auxiliary loss, by which the actor learns what phrases mean.
    """

    actor_lr: float = 1e-3
    critic_lr: float = 1e-3
    temperature_lr: float = 3e-3
    final_lr: float = 0.0
    discount: float = 0.97
    tau: float = 0.01
    target_entropy_twist: float = -2.0
    target_entropy_code: float = 0.36
    initial_temperature: float = 0.05
    reward_scale: float = 0.01
    word_noise: float = 0.6
    word_errors: float = 0.1
    message_weight: float = 1.0


@chex.dataclass(frozen=True)
class Transition:
    """snapshot, next_snapshot: before and after, the true last state of an episode included; twist `[2]`; code;
    reward; terminated: True ends the return, a time-out does not."""

    snapshot: Snapshot
    next_snapshot: Snapshot
    twist: jax.Array
    code: jax.Array
    reward: jax.Array
    terminated: jax.Array


@chex.dataclass(frozen=True)
class Batch:
    """What an update learns from, `[batch, ...]`: a `Transition` with its snapshots rendered."""

    observation: chex.ArrayTree
    next_observation: chex.ArrayTree
    twist: jax.Array
    code: jax.Array
    reward: jax.Array
    terminated: jax.Array


@chex.dataclass(frozen=True)
class LearnerState:
    """Parameters of actor, critics and target critics, log temperatures, and the state of their optimisers."""

    actor: chex.ArrayTree
    critic: chex.ArrayTree
    target_critic: chex.ArrayTree
    log_temperatures: dict
    actor_optimiser: chex.ArrayTree
    critic_optimiser: chex.ArrayTree
    temperature_optimiser: chex.ArrayTree


_CODES = len(REQUESTS)
# All parameters as one vector: less to trace and compile than a dozen operations for each of many leaves.
_ADAM = optax.flatten(optax.scale_by_adam())
_LOG_TEMPERATURE_RANGE = (-10.0, 2.0)
_PHRASES = 128  # of the auxiliary loss, an update
_SMOOTHING = 0.05  # of its labels: what a sentence means is never quite certain


class HSAC:
    """The bundle of pure functions: `init`, `act`, `update`."""

    def __init__(self, config: HSACConfig = HSACConfig()):
        self.config = config
        self.actor = Actor(config.encoder, config.actor_widths, config.language)
        self.critic = TwinCritic(config.encoder, config.critic_widths)
        # What is spoken in training. Codes need no words.
        self.vocabulary: Any = vocabulary("train") if config.language == "phrases" else None

    def init(self, key, observation, hyper: Hyperparameters) -> LearnerState:
        """Fresh parameters for observations shaped like ``observation`` (one, without a batch axis)."""
        key_actor, key_critic = jax.random.split(key)
        actor = self.actor.init(key_actor, observation, self._words(observation, self.vocabulary), method=_whole_actor)
        critic = self.critic.init(key_critic, observation, message_codes(observation.dialogue), jnp.zeros(2))
        log_temperatures = {name: jnp.log(jnp.float32(hyper.initial_temperature)) for name in ("twist", "code")}
        return LearnerState(
            actor=actor,
            critic=critic,
            target_critic=jax.tree.map(jnp.copy, critic),
            log_temperatures=log_temperatures,
            actor_optimiser=_ADAM.init(actor),
            critic_optimiser=_ADAM.init(critic),
            temperature_optimiser=_ADAM.init(log_temperatures),
        )

    def act(self, key, actor, observation, hyper: Hyperparameters) -> Action:
        """Sample an action for each observation `[..., ...]`; a code that would not count is none."""
        key_twist, key_code = jax.random.split(key)
        mean, log_std, logits = self._policy(actor, observation, self._training_vocabulary(hyper))
        twist, _ = sample_twist(key_twist, mean, log_std)
        code = jax.random.categorical(key_code, code_log_probabilities(logits, observation.may_request))
        return Action(twist=twist, code=code.astype(jnp.int32))

    def best_action(self, actor, observation, voice=True, spoken=None) -> Action:
        """Mean twist and most probable code; without ``voice`` the code is none.

        spoken: the `Vocabulary` from which what is said is drawn; by default that of training, without noise.
        """
        mean, _, logits = self._policy(actor, observation, self.vocabulary if spoken is None else spoken)
        return self._best(mean, logits, observation, voice)

    def spoken(self, split):
        """The `Vocabulary` of a split of phrases; None if this agent hears codes."""
        return vocabulary(split) if self.config.language == "phrases" else None

    def answer(self, actor, observation, heard) -> Action:
        """The best action of one who understands S_c ``heard`` `[K, 3]`, whatever the observation says."""
        mean, _, logits = self._heard_policy(actor, observation, heard)
        return self._best(mean, logits, observation, True)

    def understand(self, actor, words) -> Any:
        """Log-probabilities of message `[..., 4]` and reply `[..., 3]` of words `[..., D]`."""
        return self.actor.apply(actor, words, method="understand")

    def _best(self, mean, logits, observation, voice):
        log_p = code_log_probabilities(logits, observation.may_request & voice)
        return Action(twist=jnp.tanh(mean), code=jnp.argmax(log_p, axis=-1).astype(jnp.int32))

    def update(self, key, state: LearnerState, batch: Batch, hyper: Hyperparameters, lr_scale=1.0):
        """One step on critics, actor and temperatures. Returns (state, metrics). ``lr_scale`` multiplies every rate."""
        key_critic, key_actor = jax.random.split(key)
        temperatures = jax.tree.map(jnp.exp, state.log_temperatures)

        target = self._target(key_critic, state, batch, temperatures, hyper)
        (critic_loss, q), gradient = jax.value_and_grad(self._critic_loss, has_aux=True)(state.critic, batch, target)
        step, critic_optimiser = _ADAM.update(gradient, state.critic_optimiser)
        critic = _descend(state.critic, step, hyper.critic_lr * lr_scale)

        (actor_loss, entropies), gradient = jax.value_and_grad(self._actor_loss, has_aux=True)(
            state.actor, key_actor, critic, batch, temperatures, hyper
        )
        step, actor_optimiser = _ADAM.update(gradient, state.actor_optimiser)
        actor = _descend(state.actor, step, hyper.actor_lr * lr_scale)

        # d/d log alpha of alpha (H - target): too little entropy raises the temperature.
        targets = {"twist": hyper.target_entropy_twist, "code": hyper.target_entropy_code * jnp.log(_CODES)}
        spoke = entropies["counted"] > 0
        gradient = {name: temperatures[name] * (entropies[name] - targets[name]) for name in targets}
        gradient["code"] = jnp.where(spoke, gradient["code"], 0.0)
        step, temperature_optimiser = _ADAM.update(gradient, state.temperature_optimiser)
        log_temperatures = jax.tree.map(
            lambda leaf: jnp.clip(leaf, *_LOG_TEMPERATURE_RANGE),
            _descend(state.log_temperatures, step, hyper.temperature_lr * lr_scale),
        )
        new = LearnerState(
            actor=actor,
            critic=critic,
            target_critic=optax.incremental_update(critic, state.target_critic, hyper.tau),
            log_temperatures=log_temperatures,
            actor_optimiser=actor_optimiser,
            critic_optimiser=critic_optimiser,
            temperature_optimiser=temperature_optimiser,
        )
        metrics = {
            "critic_loss": critic_loss, "actor_loss": actor_loss, "q": q,
            "twist_entropy": entropies["twist"], "code_entropy": entropies["code"],
            "twist_temperature": temperatures["twist"], "code_temperature": temperatures["code"],
            "message_loss": entropies["message_loss"],
        }  # fmt: skip
        return new, metrics

    def _words(self, observation, spoken):
        if self.config.language == "codes":
            return message_codes(observation.dialogue)
        return spoken_words(observation.dialogue, spoken)

    def _training_vocabulary(self, hyper) -> Any:
        if self.config.language == "codes":
            return None
        return self.vocabulary.replace(noise=hyper.word_noise, error_share=hyper.word_errors)

    def _policy(self, actor, observation, spoken) -> Any:
        """Mean, log_std and logits."""
        return self.actor.apply(actor, observation, self._words(observation, spoken))

    def _heard_policy(self, actor, observation, heard) -> Any:
        """The same, of one who understands S_c ``heard``."""
        return self.actor.apply(actor, observation, heard, method="act")

    def _q(self, critic, observation, twist) -> Any:
        """Q `[2, ..., codes]`. A critic serves training only: it is told what was meant."""
        return self.critic.apply(critic, observation, message_codes(observation.dialogue), twist)

    def _target(self, key, state, batch, temperatures, hyper):
        """Soft Bellman target `[batch]`: r + discount (1 - terminated) V(s'), of a robot told what was meant.

        An approximation, on purpose: phrases of the train split are understood soon, and reading them again costs time.
        """
        heard = message_codes(batch.next_observation.dialogue)
        mean, log_std, logits = self._heard_policy(state.actor, batch.next_observation, heard)
        log_p = code_log_probabilities(logits, batch.next_observation.may_request)
        twist, log_density = sample_twist(key, mean, log_std)
        q = self._q(state.target_critic, batch.next_observation, twist).min(axis=0)
        value = soft_value(q, log_density, log_p, batch.next_observation.may_request, temperatures)
        return hyper.reward_scale * batch.reward + hyper.discount * (1.0 - batch.terminated) * value

    def _critic_loss(self, critic, batch, target):
        q = self._q(critic, batch.observation, batch.twist)
        chosen = jnp.take_along_axis(q, batch.code[None, :, None], axis=-1)[..., 0]
        loss = optax.huber_loss(chosen, target[None], delta=self.config.huber_delta)
        return jnp.sum(jnp.mean(loss, axis=1)), jnp.mean(chosen)

    def _actor_loss(self, actor, key, critic, batch, temperatures, hyper):
        """-V(s) with every sample reparameterised and the code's probabilities not detached, and what phrases mean."""
        key, key_phrases = jax.random.split(key)
        mean, log_std, logits = self._policy(actor, batch.observation, self._training_vocabulary(hyper))
        counts = batch.observation.may_request
        log_p = code_log_probabilities(logits, counts)
        twist, log_density = sample_twist(key, mean, log_std)
        q = self._q(critic, batch.observation, twist).min(axis=0)
        loss = -jnp.mean(soft_value(q, log_density, log_p, counts, temperatures))
        counted = jnp.sum(counts)
        code_entropy = jnp.sum(jnp.where(counts, entropy(log_p), 0.0)) / jnp.maximum(counted, 1)
        message_loss = self._message_loss(actor, key_phrases, hyper)
        entropies = {
            "twist": -jnp.mean(log_density), "code": code_entropy, "counted": counted, "message_loss": message_loss,
        }  # fmt: skip
        return loss + hyper.message_weight * message_loss, jax.lax.stop_gradient(entropies)

    def _message_loss(self, actor, key, hyper):
        """Cross-entropy of message and reply over phrases of the train split, every message as often as any other."""
        if self.config.language == "codes":
            return jnp.float32(0.0)
        spoken = self._training_vocabulary(hyper)
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
    """V(s) `[...]` = sum_k p_k Q_k - alpha_twist log pi(twist) + alpha_code (H(p) - log n).

    q, log_p: `[..., codes]`; counts: where a code counts, n is the number of codes there and 1 elsewhere. Subtracting
    log n keeps the discrete bonus from paying for staying alive.
    """
    bonus = jnp.where(counts, entropy(log_p) - jnp.log(_CODES), 0.0)
    expected = jnp.sum(jnp.exp(log_p) * q, axis=-1)
    return expected - temperatures["twist"] * log_density + temperatures["code"] * bonus


def _whole_actor(actor, observation, words):
    """What `Actor` computes, and what it understands: all its parameters."""
    if actor.language == "phrases":
        actor.understand(words)
    return actor(observation, words)


def _descend(params, step, lr):
    return jax.tree.map(lambda leaf, change: leaf - lr * change, params, step)
