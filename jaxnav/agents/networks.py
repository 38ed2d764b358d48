"""Networks: what reads a sentence, and the actor and critics on top of an encoder."""

from collections.abc import Sequence

import flax.linen as nn
import jax
import jax.numpy as jnp

from ..world.types import MESSAGES, REPLIES, REQUESTS
from .encoders import ENCODERS
from .layers import MLP

LOG_STD_RANGE = (-5.0, 0.0)


def message_codes(dialogue):
    """The messages themselves as S_c `[..., K, 3]`: a one-hot of stop, right, left, and zero for silence."""
    return jax.nn.one_hot(dialogue.message - 1, len(MESSAGES) - 1)


def spoken_words(dialogue, vocabulary):
    """What the pedestrians said, `[..., K, D]`: the one place where (message, utterance) becomes a vector."""
    return vocabulary.look_up(dialogue.message.astype(jnp.int32), dialogue.utterance)


class LangPreNet(nn.Module):
    """Words `[..., D]` -> log-probabilities of message `[..., 4]` and of reply `[..., 3]`.

    It reads what is said without the side, decides whether the robot is asked to go to that side or to the other, and
    only then learns which side it is: left and right can't be treated differently, and who names no side asks for none.
    """

    width: int = 96

    @nn.compact
    def __call__(self, words):
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
    Mean and log_std are `[..., 2]`, one twist for all requests; with ``per_request`` heads `[..., requests, 2]`, one for each.
    ``mean_tanh`` passes the mean through tanh, as the paper's authors do: sampled twists are then squashed twice.
    Parts that an algorithm doesn't call have no parameters.
    """

    encoder: str
    widths: Sequence[int]
    language: str = "codes"
    requests: int = len(REQUESTS)
    per_request: bool = False
    mean_tanh: bool = False

    def setup(self):
        self.state_encoder = ENCODERS[self.encoder]()
        self.body = MLP(self.widths)
        twists = self.requests if self.per_request else 1
        self.mean_head, self.log_std_head = nn.Dense(2 * twists), nn.Dense(2 * twists)
        self.request_head = nn.Dense(self.requests)
        if self.language == "phrases":
            self.language_pre_net = LangPreNet()

    def __call__(self, observation, words):
        return self.act(observation, self.listen(words))

    def act(self, observation, heard):
        """The same, of an S_c."""
        x = self.body(self.state_encoder(observation, heard))
        return *self._gaussian(x), self.request_head(x)

    def steer(self, observation, heard):
        """Mean `[..., 2]` alone."""
        return self._twists(self.mean_head(self.body(self.state_encoder(observation, heard))))

    def gaussian(self, observation, heard):
        """Mean and log_std `[..., 2]`, without a request."""
        return self._gaussian(self.body(self.state_encoder(observation, heard)))

    def _gaussian(self, x):
        mean, log_std = self._twists(self.mean_head(x)), self._twists(self.log_std_head(x))
        low, high = LOG_STD_RANGE
        log_std = low + 0.5 * (high - low) * (jnp.tanh(log_std) + 1.0)
        return jnp.tanh(mean) if self.mean_tanh else mean, log_std

    def _twists(self, x):
        return x.reshape(*x.shape[:-1], self.requests, 2) if self.per_request else x

    def listen(self, words):
        """S_c `[..., 3]` of words; silence, the zero vector, is zero."""
        if self.language == "codes":
            return words
        message, _ = self.language_pre_net(words)
        return jnp.exp(message[..., 1:]) * jnp.any(words != 0, axis=-1, keepdims=True)

    def understand(self, words):
        """Log-probabilities of message `[..., 4]` and reply `[..., 3]`; silence, the zero vector, is certain."""
        message, reply = self.language_pre_net(words)
        nothing = jnp.all(words == 0, axis=-1, keepdims=True)
        certain = jnp.where(jnp.arange(len(MESSAGES)) == 0, 0.0, -jnp.inf)
        return jnp.where(nothing, certain, message), jnp.where(nothing, certain[: len(REPLIES)], reply)


class TwinCritic(nn.Module):
    """(Observation, S_c `[..., K, 3]`, twist `[..., 2]`) -> Q of every request `[2, ..., outputs]`, estimated twice.

    A twist for each request, `[..., requests, 2]`, gives `[2, ..., requests, outputs]`: the observation is encoded once.
    """

    encoder: str
    widths: Sequence[int]
    outputs: int = len(REQUESTS)
    norm: str = "layer"

    @nn.compact
    def __call__(self, observation, heard, twist):
        x = ENCODERS[self.encoder](norm=self.norm)(observation, heard)
        x = jnp.expand_dims(x, tuple(range(x.ndim - 1, twist.ndim - 1)))
        x = jnp.concatenate([jnp.broadcast_to(x, (*twist.shape[:-1], x.shape[-1])), twist], axis=-1)
        return jnp.stack([nn.Dense(self.outputs)(MLP(self.widths, self.norm)(x)) for _ in range(2)])


class Value(nn.Module):
    """(Observation, S_c `[..., K, 3]`) -> V `[...]`."""

    encoder: str
    widths: Sequence[int]

    @nn.compact
    def __call__(self, observation, heard):
        return nn.Dense(1)(MLP(self.widths)(ENCODERS[self.encoder]()(observation, heard)))[..., 0]
