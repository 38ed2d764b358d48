"""Networks: one that reads a sentence, and the actor and critics on top of an encoder."""

from collections.abc import Sequence

import flax.linen as nn
import jax
import jax.numpy as jnp

from ..language.vocabulary import Vocabulary
from ..world.types import MESSAGES, REPLIES, REQUESTS, Observation, ObservedDialogue
from .encoders import encode, find_encoder
from .layers import MLP

LOG_STD_RANGE = (-5.0, 0.0)


def message_codes(dialogue: ObservedDialogue | None) -> jax.Array:
    """The messages themselves as S_c `[..., K, 3]`: a one-hot of stop, right, left, and zero for silence."""
    assert dialogue is not None  # every encoder reads it
    return jax.nn.one_hot(dialogue.message - 1, len(MESSAGES) - 1)


def message_words(dialogue: ObservedDialogue | None, vocabulary: Vocabulary) -> jax.Array:
    """The pedestrians' sentences `[..., K, D]`: the one place where (message, utterance) becomes a vector."""
    assert dialogue is not None
    return vocabulary.look_up(dialogue.message.astype(jnp.int32), dialogue.utterance)


class LangPreNet(nn.Module):
    """Words `[..., D]` -> log-probabilities of message `[..., 4]` and of reply `[..., 3]`.

    It reads a sentence without its side, decides whether the robot is asked to go to that side or to the other, and
    only then learns which side it is: left and right can't be treated differently, and a sentence without a side asks
    for none.
    """

    width: int = 96

    @nn.compact
    def __call__(self, words: jax.Array) -> tuple[jax.Array, jax.Array]:
        said, side = words[..., :-1], words[..., -1]
        # Of order 1 each, as the initialisation expects.
        x = nn.relu(nn.Dense(self.width)(said * said.shape[-1] ** 0.5))
        silence, stop, same, other = jnp.moveaxis(nn.Dense(len(MESSAGES))(x), -1, 0)
        right = jnp.where(side > 0, same, other)
        left = jnp.where(side > 0, other, same)
        sides = jnp.where(side[..., None] == 0, -1e9, jnp.stack([right, left], axis=-1))
        messages = jnp.concatenate([jnp.stack([silence, stop], axis=-1), sides], axis=-1)
        return nn.log_softmax(messages), nn.log_softmax(nn.Dense(len(REPLIES))(x))


class Actor(nn.Module):
    """(Observation, words `[..., K, D]` or S_c `[..., K, 3]`) -> mean and log_std of the twist before tanh, and logits
    `[..., requests]` of the request.

    With the language ``phrases`` words are read by `LangPreNet`, and its probabilities of stop, right and left are S_c.
    Mean and log_std are `[..., 2]`, one twist for all requests; ``per_request``, one for each, `[..., requests, 2]`.
    Parts that a learner doesn't call have no parameters.
    """

    encoder: str
    widths: Sequence[int]
    encoder_widths: tuple[int, ...] = ()
    language: str = "codes"
    requests: int = len(REQUESTS)
    per_request: bool = False

    def setup(self) -> None:
        self.state_encoder = find_encoder(self.encoder).build(self.encoder_widths)
        self.body = MLP(self.widths)
        twists = self.requests if self.per_request else 1
        self.mean_head, self.log_std_head = nn.Dense(2 * twists), nn.Dense(2 * twists)
        self.request_head = nn.Dense(self.requests)
        if self.language == "phrases":
            self.language_pre_net = LangPreNet()

    def __call__(self, observation: Observation, words: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
        return self.act(observation, self.listen(words))

    def act(self, observation: Observation, heard: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
        """The same, given an S_c."""
        x = self._features(observation, heard)
        return *self._gaussian(x), self.request_head(x)

    def steer(self, observation: Observation, heard: jax.Array) -> jax.Array:
        """Mean `[..., 2]` alone."""
        return self._twists(self.mean_head(self._features(observation, heard)))

    def gaussian(self, observation: Observation, heard: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Mean and log_std `[..., 2]`, without a request."""
        return self._gaussian(self._features(observation, heard))

    def _features(self, observation, heard):
        return self.body(encode(self.state_encoder, observation, heard))

    def _gaussian(self, x):
        mean, log_std = self._twists(self.mean_head(x)), self._twists(self.log_std_head(x))
        low, high = LOG_STD_RANGE
        return mean, low + 0.5 * (high - low) * (jnp.tanh(log_std) + 1.0)

    def _twists(self, x):
        return x.reshape(*x.shape[:-1], self.requests, 2) if self.per_request else x

    def listen(self, words: jax.Array) -> jax.Array:
        """S_c `[..., 3]` of words; silence, the zero vector, is zero."""
        if self.language == "codes":
            return words
        message, _ = self.language_pre_net(words)
        return jnp.exp(message[..., 1:]) * jnp.any(words != 0, axis=-1, keepdims=True)

    def understand(self, words: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Log-probabilities of message `[..., 4]` and reply `[..., 3]`; silence, the zero vector, is certain."""
        message, reply = self.language_pre_net(words)
        nothing = jnp.all(words == 0, axis=-1, keepdims=True)
        certain = jnp.where(jnp.arange(len(MESSAGES)) == 0, 0.0, -jnp.inf)
        return jnp.where(nothing, certain, message), jnp.where(nothing, certain[: len(REPLIES)], reply)


class TwinCritic(nn.Module):
    """(Observation, S_c `[..., K, 3]`, twist `[..., 2]`) -> Q of every request `[2, ..., outputs]`, estimated twice.

    A twist for each request, `[..., requests, 2]`, gives `[2, ..., requests, outputs]`: the observation enters once.
    """

    encoder: str
    widths: Sequence[int]
    encoder_widths: tuple[int, ...] = ()
    outputs: int = len(REQUESTS)

    @nn.compact
    def __call__(self, observation: Observation, heard: jax.Array, twist: jax.Array) -> jax.Array:
        x = encode(find_encoder(self.encoder).build(self.encoder_widths), observation, heard)
        x = jnp.expand_dims(x, tuple(range(x.ndim - 1, twist.ndim - 1)))
        x = jnp.concatenate([jnp.broadcast_to(x, (*twist.shape[:-1], x.shape[-1])), twist], axis=-1)
        return jnp.stack([nn.Dense(self.outputs)(MLP(self.widths)(x)) for _ in range(2)])


class Value(nn.Module):
    """(Observation, S_c `[..., K, 3]`) -> V `[...]`."""

    encoder: str
    widths: Sequence[int]
    encoder_widths: tuple[int, ...] = ()

    @nn.compact
    def __call__(self, observation: Observation, heard: jax.Array) -> jax.Array:
        x = encode(find_encoder(self.encoder).build(self.encoder_widths), observation, heard)
        return nn.Dense(1)(MLP(self.widths)(x))[..., 0]
