"""Short histories of pytrees, of a static length and newest first; None where that length is 0."""

from typing import Any

import jax
import jax.numpy as jnp


def start(now: Any, length: int) -> Any:
    """A history in which everything has been as it is ``now``."""
    if length == 0:
        return None
    return jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (length, *jnp.shape(leaf))), now)


def push(history: Any, now: Any) -> Any:
    """The history a step later: ``now`` is its newest entry, and the oldest is gone."""
    if history is None:
        return None
    return jax.tree.map(lambda past, leaf: jnp.concatenate([leaf[None], past[:-1]]), history, now)


def recall(history: Any, now: Any, latency: jax.Array | float) -> Any:
    """The entry of ``latency`` steps ago, a whole number from 0, which is ``now``, to the history's length."""
    if history is None:
        return now
    step = jnp.asarray(latency, jnp.int32)
    return jax.tree.map(lambda past, leaf: jnp.concatenate([leaf[None], past])[step], history, now)
