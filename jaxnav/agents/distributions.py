"""The two halves of a hybrid action: a tanh-Gaussian twist and a masked categorical request."""

import jax
import jax.numpy as jnp

_HALF_LOG_2PI = 0.9189385
_LOG_2 = 0.6931472


def sample_twist(key: jax.Array, mean: jax.Array, log_std: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Reparameterised tanh-Gaussian sample `[..., 2]` and its log density `[...]`."""
    noise = jax.random.normal(key, mean.shape)
    raw = mean + noise * jnp.exp(log_std)
    return jnp.tanh(raw), _log_density(noise, raw, log_std)


def twist_log_density(twist: jax.Array, mean: jax.Array, log_std: jax.Array) -> jax.Array:
    """Log density `[...]` of a given ``twist`` `[..., 2]` in (-1, 1)."""
    raw = jnp.arctanh(twist)
    return _log_density((raw - mean) * jnp.exp(-log_std), raw, log_std)


def _log_density(noise, raw, log_std):
    # log(1 - tanh(u)^2) = 2 (log 2 - u - softplus(-2 u)): stable for large |u|.
    squash = 2.0 * (_LOG_2 - raw - jax.nn.softplus(-2.0 * raw))
    return jnp.sum(-0.5 * noise * noise - log_std - _HALF_LOG_2PI - squash, axis=-1)


def request_log_probabilities(logits: jax.Array, counts: jax.Array) -> jax.Array:
    """Log-probabilities `[..., requests]`; all mass is on none where a request doesn't count (``counts`` `[...]`).

    Masked requests get a large negative number, not -inf, so that p log p stays 0 and gradients stay finite.
    """
    requests = jnp.arange(logits.shape[-1])
    return jax.nn.log_softmax(jnp.where(counts[..., None] | (requests == 0), logits, -1e9), axis=-1)


def entropy(log_probabilities: jax.Array) -> jax.Array:
    """Entropy `[...]` of a categorical, nats."""
    return -jnp.sum(jnp.exp(log_probabilities) * log_probabilities, axis=-1)
