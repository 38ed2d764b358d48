"""The losses of PPO (Schulman et al. 2017, arXiv 1707.06347) and A2C (Mnih et al. 2016, arXiv 1602.01783)."""

from typing import Any

import jax
import jax.numpy as jnp

from ..learner import Batch


def clipped_objective(log_density: jax.Array, old: jax.Array, advantage: jax.Array, hyper: Any) -> jax.Array:
    """-mean min(ratio A, clip(ratio, 1 - clip, 1 + clip) A), advantages normalised: equation 7 of PPO.

    log_density, old: of the twists that were tried, now and when they were.
    """
    advantage = normalised(advantage)
    # Bounded where the clip decides anyway: exp of more would be infinite, and its gradient not a number.
    ratio = jnp.exp(jnp.clip(log_density - old, -20.0, 20.0))
    clipped = jnp.clip(ratio, 1.0 - hyper.clip, 1.0 + hyper.clip)
    return -jnp.mean(jnp.minimum(ratio * advantage, clipped * advantage))


def policy_gradient(log_density: jax.Array, old: jax.Array, advantage: jax.Array, hyper: Any) -> jax.Array:
    """-mean A log pi: the update of A2C (algorithm S3 of its paper), equation 2 of PPO's."""
    del old, hyper
    return -jnp.mean(log_density * advantage)


def value_loss(value: jax.Array, wanted: jax.Array) -> jax.Array:
    """Half the mean of (V(s) - return)^2: equation 9 of PPO."""
    error = value - wanted
    return 0.5 * jnp.mean(error * error)


def normalised(advantage: jax.Array) -> jax.Array:
    """Advantages with mean 0 and standard deviation 1."""
    return (advantage - jnp.mean(advantage)) / (jnp.std(advantage) + 1e-8)


def gae(batch: Batch, values: jax.Array, next_values: jax.Array, hyper: Any) -> jax.Array:
    """Generalised advantages `[horizon, episodes]`: equation 16 of Schulman et al. 2016, arXiv 1506.02438.

    A time-out bootstraps from its true last state, an arrival or a collision from nothing; neither looks further.
    """
    bootstrap = hyper.discount * (1.0 - batch.terminated) * next_values
    errors = hyper.reward_scale * batch.reward + bootstrap - values
    keep = hyper.discount * hyper.gae_lambda * (1.0 - batch.ended)

    def back(advantage, step):
        error, kept = step
        advantage = error + kept * advantage
        return advantage, advantage

    return jax.lax.scan(back, jnp.zeros_like(errors[0]), (errors, keep), reverse=True)[1]
