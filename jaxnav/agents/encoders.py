"""Encoders: how an `Observation` becomes features."""

import functools
from collections.abc import Sequence

import flax.linen as nn
import jax
import jax.numpy as jnp

from ..world.geometry import closest_approach, norm, unit
from ..world.types import REPLIES, REQUESTS
from .layers import MLP

SECTORS = 12
_TOP_SPEED = 0.6  # that of the default `Params`, m/s
_HORIZON = 6.0  # s


def pedestrian_features(observation, heard):
    """`[..., K, features]` of each observed pedestrian and the dialogue with it, of order 1; heard: S_c."""
    x, y, vx, vy = jnp.moveaxis(observation.pedestrians, -1, 0)
    distance = jnp.sqrt(x * x + y * y + 1e-12)
    motion = [
        observation.seen, x / 4, y / 4, x / distance, y / distance, jnp.minimum(distance, 2.0) / 2, vx * 2, vy * 2,
    ]  # fmt: skip
    return jnp.concatenate([jnp.stack(motion, axis=-1), dialogue_features(observation.dialogue, heard)], axis=-1)


def approach_features(observation):
    """`[..., K, 12]` when and how near each pedestrian comes to the robot, of order 1; 0 of who is not in sight.

    For four ways in which the robot may go on straight: as now, at 0.6 m/s ahead, at 0.6 m/s to the goal, and standing.
    Of each the time of the closest approach within 6 s, the distance of the centres then, and
    exp(-time / 2 - 3 max(distance - 0.3, 0)): at 0.3 m they nearly touch. Who recedes is nearest now.
    """
    x, y, vx, vy = jnp.moveaxis(observation.pedestrians, -1, 0)
    speed, goal = observation.twist[..., :1], observation.pose[..., 2, :]
    goal_x, goal_y = unit(goal[..., :1], goal[..., 1:2])
    features = []
    for own_x, own_y in ((speed, 0.0), (_TOP_SPEED, 0.0), (_TOP_SPEED * goal_x, _TOP_SPEED * goal_y), (0.0, 0.0)):
        relative_x, relative_y = vx - own_x, vy - own_y
        time = closest_approach(x, y, relative_x, relative_y, _HORIZON)
        distance = norm(x + time * relative_x, y + time * relative_y)
        danger = jnp.exp(-0.5 * time - 3.0 * jnp.maximum(distance - 0.3, 0.0))
        features += [time / 4, jnp.minimum(distance, 2.0) / 2, danger]
    return jnp.stack(features, axis=-1) * observation.seen[..., None]


def dialogue_features(dialogue, heard):
    """`[..., K, features]` of the dialogue with each observed pedestrian, of order 1; heard: S_c."""
    state = [
        dialogue.is_open, dialogue.pedestrian_first,
        jnp.minimum(dialogue.message_age, 10) / 10, jnp.minimum(dialogue.request_age, 10) / 10,
    ]  # fmt: skip
    return jnp.concatenate(
        [
            jnp.stack(state, axis=-1),
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


def known(observation):
    """`[..., K, 1]`: 1 for pedestrians who are seen or in dialogue, 0 for rows of nobody, which must not count."""
    dialogue = observation.dialogue
    there = (dialogue.is_open != 0) | (dialogue.utterance != 0) | (dialogue.message != 0) | (dialogue.request != 0)
    if observation.seen is not None:  # None of an observation without a list of pedestrians
        there |= observation.seen
    return there[..., None].astype(jnp.float32)


class LidarEncoder(nn.Module):
    """Scan, pedestrians, dialogue, S_c and pose -> `[..., features]`, whatever the number of pedestrians.

    The scan enters as exp(-range / 2), and once more as exp(-4 range) of the nearest echo in each of twelve sectors:
    the first tells what is where, the second tells 0.2 m from 0.3 m. Pedestrians are embedded one by one and summed;
    with ``approach`` their `approach_features`, too.
    """

    norm: str = "layer"
    approach: bool = False
    scan_width: int = 64
    pedestrian_width: int = 64

    @nn.compact
    def __call__(self, observation, heard):
        ranges = observation.scan
        sectors = jnp.array_split(ranges, min(SECTORS, ranges.shape[-1]), axis=-1)
        nearest = jnp.stack([sector.min(axis=-1) for sector in sectors], axis=-1)
        echoes = jnp.concatenate([jnp.exp(-0.5 * ranges), jnp.exp(-4.0 * nearest)], axis=-1)
        scan = MLP([self.scan_width], self.norm)(echoes)
        people = pedestrian_features(observation, heard)
        if self.approach:
            people = jnp.concatenate([people, approach_features(observation)], axis=-1)
        people = MLP([self.pedestrian_width], self.norm)(people)
        people = (people * known(observation)).sum(axis=-2)
        return jnp.concatenate([scan, people, own_features(observation)], axis=-1)


class Convolution(nn.Module):
    """What ``nn.Conv(channels, (3, 3))`` computes, as one matrix product of the nine neighbours of every cell.

    Training is a loop, and inside of a loop XLA runs convolutions on a CPU two orders of magnitude slower.
    """

    channels: int

    @nn.compact
    def __call__(self, x):
        *lead, height, width, channels = x.shape
        kernel = self.param("kernel", nn.initializers.lecun_normal(), (3, 3, channels, self.channels))
        bias = self.param("bias", nn.initializers.zeros, (self.channels,))
        padded = jnp.pad(x, [(0, 0)] * len(lead) + [(1, 1), (1, 1), (0, 0)])
        shifted = [padded[..., i : i + height, j : j + width, :] for i in range(3) for j in range(3)]
        return jnp.concatenate(shifted, axis=-1) @ kernel.reshape(9 * channels, self.channels) + bias


class GridEncoder(nn.Module):
    """Img_PreNet and State_PreNet of the paper (docs/learner.md): grid maps, pose, dialogue and S_c -> `[..., 512]`.

    Maps `[4, 48, 48]` -> 3 x (convolution 3 x 3, ReLU, 2 x 2 maximum) -> 512, beside the rest -> 512, each with ReLU.
    The maximum is one over a reshaped array: its gradient is an order of magnitude faster on a CPU than `nn.max_pool`.
    frozen: Img_PreNet, its last layer included, keeps its first, random weights, as in the authors' release.
    """

    norm: str = "layer"
    frozen: bool = False
    channels: Sequence[int] = (64, 128, 256)
    width: int = 512
    dialogue_width: int = 64

    @nn.compact
    def __call__(self, observation, heard):
        maps = jnp.concatenate([observation.sensor_map[..., None, :, :], observation.pedestrian_map], axis=-3)
        lead = maps.shape[:-3]
        x = jnp.moveaxis(maps.reshape(-1, *maps.shape[-3:]), 1, -1)
        for i, channels in enumerate(self.channels):
            x = Convolution(channels, name=f"Conv_{i}")(x)
            batch, height, width, _ = x.shape
            # ReLU after the maximum: the same numbers, a quarter of the work.
            x = nn.relu(x.reshape(batch, height // 2, 2, width // 2, 2, channels).max(axis=(2, 4)))
        image = nn.relu(nn.Dense(self.width)(x.reshape(batch, -1))).reshape(*lead, self.width)
        if self.frozen:
            image = jax.lax.stop_gradient(image)
        talk = MLP([self.dialogue_width], self.norm)(dialogue_features(observation.dialogue, heard))
        talk = (talk * known(observation)).sum(axis=-2)
        x = jnp.concatenate([image, own_features(observation), talk], axis=-1)
        return MLP([self.width], self.norm)(x)


ENCODERS = {
    "lidar": LidarEncoder,
    "lidar-approach": functools.partial(LidarEncoder, approach=True),
    "grid": GridEncoder,
    "grid-frozen": functools.partial(GridEncoder, frozen=True),
}
# What an encoder reads of an observation.
PARTS = {
    "lidar": ("scan", "pedestrians", "dialogue"),
    "lidar-approach": ("scan", "pedestrians", "dialogue"),
    "grid": ("sensor_map", "pedestrian_map", "dialogue"),
    "grid-frozen": ("sensor_map", "pedestrian_map", "dialogue"),
}
