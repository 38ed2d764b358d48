"""What a foreign learner sees: an `Observation` as named float32 arrays, or as one vector."""

import jax
import jax.numpy as jnp

from ..world import Params
from ..world.types import MESSAGES, REPLIES, REQUESTS

IN_UNIT = (
    "may_request",
    "scan",
    "seen",
    "dialogue",
    "sensor_map",
)  # parts within [0, 1]; the others have no bounds
_OLD = 10.0  # steps after which what was said counts as no older


def parts(observation, params):
    """The parts of an observation as float32 arrays, by name; those that the world leaves out are missing.

    pose `[3, 3]`, twist `[2]`, may_request `[1]`, scan `[B]` as shares of ``scan_range``, pedestrians `[K, 4]`,
    seen `[K]`, dialogue `[K, 15]`, sensor_map `[48, 48]`, pedestrian_map `[3, 48, 48]`. A row of dialogue is: gate
    open, pedestrian first, age of the message, age of the request (both as shares of 10 steps), then one-hot the
    message (of 4), the request (of 4) and the reply (of 3). The wording of what was said is left out: reading it takes
    a table of phrases.
    """
    seen = {name: part for name, part in vars(observation).items() if part is not None}
    seen["may_request"] = observation.may_request[None]
    if "scan" in seen:
        seen["scan"] = observation.scan / params.scan_range
    if "dialogue" in seen:
        seen["dialogue"] = _dialogue(observation.dialogue)
    return {name: part.astype(jnp.float32) for name, part in seen.items()}


def flat(observation, params):
    """The `parts` one after the other, in the order of the fields of `Observation`: a vector `[D]`."""
    return jnp.concatenate([part.ravel() for part in parts(observation, params).values()])


def shapes(world):
    """The shape of each of the `parts` in that world, by name."""
    params = Params()
    first = jax.eval_shape(
        lambda key: parts(world.observe(world.reset(key, params), params), params), jax.random.key(0)
    )
    return {name: part.shape for name, part in first.items()}


def _dialogue(heard):
    gate = [heard.is_open, heard.pedestrian_first]
    ages = [jnp.minimum(age, _OLD) / _OLD for age in (heard.message_age, heard.request_age)]
    words = [
        jax.nn.one_hot(heard.message, len(MESSAGES)),
        jax.nn.one_hot(heard.request, len(REQUESTS)),
        jax.nn.one_hot(heard.reply, len(REPLIES)),
    ]
    return jnp.concatenate([jnp.stack([*gate, *ages], axis=-1), *words], axis=-1)
