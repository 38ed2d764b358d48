"""Observations for foreign learners: an `Observation` as named float32 arrays, or as one vector."""

from typing import Any

import jax
import jax.numpy as jnp

from ..world import Observation, Params, World
from ..world.types import MESSAGES, REPLIES, REQUESTS, ObservedDialogue

IN_UNIT = ("may_request", "scan", "seen", "dialogue", "sensor_map")  # within [0, 1]; the others have no bounds
_OLD = 10.0  # steps: older messages and requests count as this old


def parts(observation: Observation, params: Params) -> dict[str, jax.Array]:
    """The parts of an observation as float32 arrays, by name, without those that the world leaves out.

    pose:           `[3, 3]`.
    twist:          `[2]`.
    may_request:    `[1]`.
    scan:           `[B]` as shares of ``scan_range``.
    pedestrians:    `[K, 4]`.
    seen:           `[K]`.
    dialogue:       `[K, 15]`: open, pedestrian first, ages of message and request as shares of 10 steps, then one-hot
                    the message (of 4), the request (of 4) and the reply (of 3).
    sensor_map:     `[48, 48]`.
    pedestrian_map: `[3, 48, 48]`.

    Sentences are left out: reading them takes a table of phrases.
    """
    seen: dict[str, Any] = {name: part for name, part in vars(observation).items() if part is not None}
    seen["may_request"] = observation.may_request[None]
    if "scan" in seen:
        seen["scan"] = seen["scan"] / params.scan_range
    if "dialogue" in seen:
        seen["dialogue"] = _dialogue(seen["dialogue"])
    return {name: part.astype(jnp.float32) for name, part in seen.items()}


def flat(observation: Observation, params: Params) -> jax.Array:
    """The `parts` one after the other, in the order of the fields of `Observation`: a vector `[D]`."""
    return jnp.concatenate([part.ravel() for part in parts(observation, params).values()])


def shapes(world: World) -> dict[str, tuple[int, ...]]:
    """The shapes of the `parts` in a world, by name."""
    params = Params()
    first = jax.eval_shape(
        lambda key: parts(world.observe(world.reset(key, params), params), params), jax.random.key(0)
    )
    return {name: part.shape for name, part in first.items()}


def _dialogue(heard: ObservedDialogue) -> jax.Array:
    gate = [heard.is_open, heard.pedestrian_first]
    ages = [jnp.minimum(age, _OLD) / _OLD for age in (heard.message_age, heard.request_age)]
    words = [
        jax.nn.one_hot(heard.message, len(MESSAGES)),
        jax.nn.one_hot(heard.request, len(REQUESTS)),
        jax.nn.one_hot(heard.reply, len(REPLIES)),
    ]
    return jnp.concatenate([jnp.stack([*gate, *ages], axis=-1), *words], axis=-1)
