"""The two halves of a hybrid action: a tanh-Gaussian twist and a masked categorical request; and values as histograms."""

import jax
import jax.numpy as jnp
import numpy as np

_HALF_LOG_2PI = 0.9189385
_LOG_2 = 0.6931472
BINS = np.linspace(-12.0, 20.0, 51).astype(np.float32)  # of values, where critics predict histograms


def sample_twist(key, mean, log_std):
    """Reparameterised tanh-Gaussian sample `[..., 2]` and its log density `[...]`."""
    noise = jax.random.normal(key, mean.shape)
    raw = mean + noise * jnp.exp(log_std)
    return jnp.tanh(raw), _log_density(noise, raw, log_std)


def twist_log_density(twist, mean, log_std):
    """Log density `[...]` of a given ``twist`` `[..., 2]` in (-1, 1)."""
    raw = jnp.arctanh(twist)
    return _log_density((raw - mean) * jnp.exp(-log_std), raw, log_std)


def _log_density(noise, raw, log_std):
    # log(1 - tanh(u)^2) = 2 (log 2 - u - softplus(-2 u)): stable for large |u|.
    squash = 2.0 * (_LOG_2 - raw - jax.nn.softplus(-2.0 * raw))
    return jnp.sum(-0.5 * noise * noise - log_std - _HALF_LOG_2PI - squash, axis=-1)


def request_log_probabilities(logits, counts):
    """Log-probabilities `[..., requests]`; where a request does not count (``counts`` `[...]` False) all mass is on none.

    Masked requests get a large negative number, not -inf, so that p log p stays 0 and gradients stay finite.
    """
    requests = jnp.arange(logits.shape[-1])
    return jax.nn.log_softmax(jnp.where(counts[..., None] | (requests == 0), logits, -1e9), axis=-1)


def entropy(log_probabilities):
    """Entropy `[...]` of a categorical, nats."""
    return -jnp.sum(jnp.exp(log_probabilities) * log_probabilities, axis=-1)


def histogram(values):
    """Values `[...]` as distributions over the bins `[..., bins]` (HL-Gauss, Farebrother et al. 2024)."""
    width = BINS[1] - BINS[0]
    edges = np.append(BINS - width / 2, BINS[-1] + width / 2)
    inside = jnp.clip(values, BINS[0], BINS[-1])[..., None]
    below = jax.scipy.special.erf((edges - inside) / (np.sqrt(2.0) * 0.75 * width))
    mass = below[..., 1:] - below[..., :-1]
    return mass / mass.sum(axis=-1, keepdims=True)
