"""A reward for arriving, with costs for touching anything and for coming close to people."""

import jax.numpy as jnp


def sparse(events, params):
    close = jnp.maximum(params.comfort_distance - jnp.maximum(events.distance, 0.0), 0.0)
    return {
        "arrival": 100.0 * events.arrived,
        "collision": -100.0 * events.collided,
        "closeness": -10.0 * close,
        "progress": 10.0 * events.progress,
    }
