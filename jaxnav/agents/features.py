"""Features of an `Observation`, of order 1: pedestrians, dialogue, and the robot itself."""

from typing import Any

import jax
import jax.numpy as jnp

from ..world.geometry import Vec2, closest_approach, norm, unit
from ..world.types import REPLIES, REQUESTS, Observation, ObservedDialogue

_TOP_SPEED = 0.6  # that of the default `Params`, m/s
_HORIZON = 6.0  # s


def part(observation: Observation, name: str) -> Any:
    """A part of an observation by name. ValueError: the world leaves it out."""
    value = getattr(observation, name)
    if value is None:
        raise ValueError(f"world.observation lacks {name}, which the encoder reads: name it there")
    return value


def pedestrian_features(observation: Observation, heard: jax.Array) -> jax.Array:
    """`[..., K, 22]`: each observed pedestrian's place and velocity, and the dialogue with it; heard: S_c."""
    x, y, vx, vy = jnp.moveaxis(part(observation, "pedestrians"), -1, 0)
    distance = jnp.sqrt(x * x + y * y + 1e-12)
    seen = part(observation, "seen")
    motion = [
        seen, x / 4, y / 4, x / distance, y / distance, jnp.minimum(distance, 2.0) / 2, vx * 2, vy * 2,
    ]  # fmt: skip
    talk = dialogue_features(part(observation, "dialogue"), heard)
    return jnp.concatenate([jnp.stack(motion, axis=-1), talk], axis=-1)


def approach_features(observation: Observation) -> jax.Array:
    """`[..., K, 12]`: when and how near each pedestrian comes to the robot; 0 for those out of sight.

    The robot may go on straight in four ways: as now, at 0.6 m/s ahead, at 0.6 m/s to the goal, or not at all. Each way
    has three features: the time of the closest approach within 6 s, the distance of the centres then, and
    exp(-time / 2 - 3 max(distance - 0.3, 0)), since at 0.3 m they nearly touch. One that recedes is nearest now.
    """
    x, y, vx, vy = jnp.moveaxis(part(observation, "pedestrians"), -1, 0)
    speed, goal = observation.twist[..., :1], observation.pose[..., 2, :]
    goal_x, goal_y = unit(goal[..., :1], goal[..., 1:2])
    features = []
    for own_x, own_y in ((speed, 0.0), (_TOP_SPEED, 0.0), (_TOP_SPEED * goal_x, _TOP_SPEED * goal_y), (0.0, 0.0)):
        relative_x, relative_y = vx - own_x, vy - own_y
        time = closest_approach(Vec2(x, y), Vec2(relative_x, relative_y), _HORIZON)
        distance = norm(x + time * relative_x, y + time * relative_y)
        danger = jnp.exp(-0.5 * time - 3.0 * jnp.maximum(distance - 0.3, 0.0))
        features += [time / 4, jnp.minimum(distance, 2.0) / 2, danger]
    return jnp.stack(features, axis=-1) * part(observation, "seen")[..., None]


def dialogue_features(dialogue: ObservedDialogue, heard: jax.Array) -> jax.Array:
    """`[..., K, 14]`: the dialogue with each observed pedestrian. heard: S_c `[..., K, 3]`."""
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


def own_features(observation: Observation) -> jax.Array:
    """`[..., 15]`: the robot's goal now and before, whether it may ask, and its twist."""
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


def known(observation: Observation) -> jax.Array:
    """`[..., K, 1]`: 1 for pedestrians who are seen or in dialogue, 0 for empty rows, which must not count."""
    dialogue = part(observation, "dialogue")
    there = (dialogue.is_open != 0) | (dialogue.utterance != 0) | (dialogue.message != 0) | (dialogue.request != 0)
    if observation.seen is not None:  # None where the world observes no list of pedestrians
        there |= observation.seen
    return there[..., None].astype(jnp.float32)
