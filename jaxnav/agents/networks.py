"""Networks: how an `Observation` becomes features, and the actor and twin critics on top of them."""

from collections.abc import Sequence

import flax.linen as nn
import jax
import jax.numpy as jnp

from ..world.types import MESSAGES, REPLIES, REQUESTS

LOG_STD_RANGE = (-5.0, 0.0)
_SECTORS = 12


class MLP(nn.Module):
    """Dense, LayerNorm, ReLU for each width."""

    widths: Sequence[int]

    @nn.compact
    def __call__(self, x):
        for width in self.widths:
            x = nn.relu(nn.LayerNorm()(nn.Dense(width)(x)))
        return x


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


def pedestrian_features(observation, heard):
    """`[..., K, features]` of each observed pedestrian and the dialogue with it, of order 1; heard: S_c."""
    x, y, vx, vy = jnp.moveaxis(observation.pedestrians, -1, 0)
    distance = jnp.sqrt(x * x + y * y + 1e-12)
    dialogue = observation.dialogue
    motion = [
        observation.seen, x / 4, y / 4, x / distance, y / distance, jnp.minimum(distance, 2.0) / 2, vx * 2, vy * 2,
        dialogue.is_open, dialogue.pedestrian_first,
        jnp.minimum(dialogue.message_age, 10) / 10, jnp.minimum(dialogue.request_age, 10) / 10,
    ]  # fmt: skip
    return jnp.concatenate(
        [
            jnp.stack(motion, axis=-1),
            heard,
            jax.nn.one_hot(dialogue.request, len(REQUESTS)),
            jax.nn.one_hot(dialogue.reply, len(REPLIES)),
        ],
        axis=-1,
    )


def own_features(observation):
    """`[..., features]` of the robot itself: goal now and before, twist, whether it may ask; of order 1."""
    now = observation.pose[..., 2, :]
    x, y = now[..., 0], now[..., 1]
    distance = jnp.sqrt(x * x + y * y + 1e-12)
    scale = jnp.array([6.0, 6.0, 1.0])
    goal = [x / 6, y / 6, x / distance, y / distance, jnp.minimum(distance, 1.0)]
    past = observation.pose[..., :2, :] / scale
    return jnp.concatenate(
        [
            jnp.stack([*goal, now[..., 2], observation.may_request], axis=-1),
            past.reshape(*past.shape[:-2], 6),
            observation.twist,
        ],
        axis=-1,
    )


class LidarEncoder(nn.Module):
    """Scan, pedestrians, dialogue, S_c and pose -> `[..., features]`, whatever the number of pedestrians.

    The scan enters as exp(-range / 2), and once more as exp(-4 range) of the nearest echo in each of twelve sectors:
    the first tells what is where, the second tells 0.2 m from 0.3 m. Pedestrians are embedded one by one and summed.
    """

    scan_width: int = 64
    pedestrian_width: int = 64

    @nn.compact
    def __call__(self, observation, heard):
        ranges = observation.scan
        sectors = jnp.array_split(ranges, min(_SECTORS, ranges.shape[-1]), axis=-1)
        nearest = jnp.stack([sector.min(axis=-1) for sector in sectors], axis=-1)
        scan = MLP([self.scan_width])(jnp.concatenate([jnp.exp(-0.5 * ranges), jnp.exp(-4.0 * nearest)], axis=-1))
        people = MLP([self.pedestrian_width])(pedestrian_features(observation, heard)).sum(axis=-2)
        return jnp.concatenate([scan, people, own_features(observation)], axis=-1)


ENCODERS = {"lidar": LidarEncoder}


class Actor(nn.Module):
    """(Observation, words `[..., K, D]` or S_c `[..., K, 3]`) -> mean `[..., 2]` and log_std `[..., 2]` of the twist
    before tanh, logits `[..., 4]` of the code.

    With the language ``phrases`` words are read by `LangPreNet`, and its probabilities of stop, right and left are S_c.
    """

    encoder: str
    widths: Sequence[int]
    language: str

    def setup(self):
        self.state_encoder = ENCODERS[self.encoder]()
        self.body = MLP(self.widths)
        self.mean_head, self.log_std_head, self.code_head = nn.Dense(2), nn.Dense(2), nn.Dense(len(REQUESTS))
        if self.language == "phrases":
            self.language_pre_net = LangPreNet()

    def __call__(self, observation, words):
        return self.act(observation, self.listen(words))

    def act(self, observation, heard):
        """The same, of an S_c."""
        x = self.body(self.state_encoder(observation, heard))
        low, high = LOG_STD_RANGE
        log_std = low + 0.5 * (high - low) * (jnp.tanh(self.log_std_head(x)) + 1.0)
        return self.mean_head(x), log_std, self.code_head(x)

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
    """(Observation, S_c `[..., K, 3]`, twist `[..., 2]`) -> Q of every code `[2, ..., 4]`, estimated twice."""

    encoder: str
    widths: Sequence[int]

    @nn.compact
    def __call__(self, observation, heard, twist):
        x = jnp.concatenate([ENCODERS[self.encoder]()(observation, heard), twist], axis=-1)
        return jnp.stack([nn.Dense(len(REQUESTS))(MLP(self.widths)(x)) for _ in range(2)])
