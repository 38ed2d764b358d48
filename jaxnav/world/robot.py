"""The unicycle: a twist held for a time is an exact arc."""

import jax
import jax.numpy as jnp

from .params import Params


def twist_from_action(twist: jax.Array, params: Params) -> tuple[jax.Array, jax.Array]:
    """Network action `[2]` in [-1, 1] -> v in [0, max_v], w in [-max_w, max_w] (docs/world.md section 1)."""
    return 0.5 * params.max_v * (jnp.clip(twist[0], -1.0, 1.0) + 1.0), params.max_w * jnp.clip(twist[1], -1.0, 1.0)


def arc(
    x: jax.Array, y: jax.Array, heading: jax.Array, v: jax.Array, w: jax.Array, time: jax.Array | float
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Pose after driving v, w for ``time`` seconds: chord v t sinc(w t / 2) along the mean heading, exact for any w."""
    half = 0.5 * w * time
    chord = v * time * jnp.sinc(half / jnp.pi)
    return x + chord * jnp.cos(heading + half), y + chord * jnp.sin(heading + half), heading + 2.0 * half
