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


def message_features(dialogue):
    """What the pedestrians said, `[..., K, features]`: the one place where a message index becomes a vector.

    A one-hot for now; the table of phrase embeddings, looked up by (message, utterance), replaces it here.
    """
    return jax.nn.one_hot(dialogue.message, len(MESSAGES))


def pedestrian_features(observation):
    """`[..., K, features]` of each observed pedestrian and the dialogue with it, of order 1."""
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
            message_features(dialogue),
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
    """Scan, pedestrians, dialogue and pose -> `[..., features]`, whatever the number of pedestrians.

    The scan enters as exp(-range / 2), and once more as exp(-4 range) of the nearest echo in each of twelve sectors:
    the first tells what is where, the second tells 0.2 m from 0.3 m. Pedestrians are embedded one by one and summed.
    """

    scan_width: int = 64
    pedestrian_width: int = 64

    @nn.compact
    def __call__(self, observation):
        ranges = observation.scan
        sectors = jnp.array_split(ranges, min(_SECTORS, ranges.shape[-1]), axis=-1)
        nearest = jnp.stack([sector.min(axis=-1) for sector in sectors], axis=-1)
        scan = MLP([self.scan_width])(jnp.concatenate([jnp.exp(-0.5 * ranges), jnp.exp(-4.0 * nearest)], axis=-1))
        people = MLP([self.pedestrian_width])(pedestrian_features(observation)).sum(axis=-2)
        return jnp.concatenate([scan, people, own_features(observation)], axis=-1)


ENCODERS = {"lidar": LidarEncoder}


class Actor(nn.Module):
    """Observation -> mean `[..., 2]` and log_std `[..., 2]` of the twist before tanh, logits `[..., 4]` of the code."""

    encoder: str
    widths: Sequence[int]

    @nn.compact
    def __call__(self, observation):
        x = MLP(self.widths)(ENCODERS[self.encoder]()(observation))
        low, high = LOG_STD_RANGE
        log_std = low + 0.5 * (high - low) * (jnp.tanh(nn.Dense(2)(x)) + 1.0)
        return nn.Dense(2)(x), log_std, nn.Dense(len(REQUESTS))(x)


class TwinCritic(nn.Module):
    """(Observation, twist `[..., 2]`) -> Q of every code `[2, ..., 4]`, two estimates on one encoder."""

    encoder: str
    widths: Sequence[int]

    @nn.compact
    def __call__(self, observation, twist):
        x = jnp.concatenate([ENCODERS[self.encoder]()(observation), twist], axis=-1)
        return jnp.stack([nn.Dense(len(REQUESTS))(MLP(self.widths)(x)) for _ in range(2)])
