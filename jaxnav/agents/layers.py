"""Layers that encoders, actors and critics share."""

from collections.abc import Sequence

import flax.linen as nn
import jax


class BatchNorm(nn.Module):
    """Normalises by the batch's own statistics, and keeps none: for critics, which only ever see batches.

    CrossQ (Bhatt et al. 2024): both ends of the transitions go through in one batch, and there are no target critics.
    """

    @nn.compact
    def __call__(self, x):
        axes = tuple(range(x.ndim - 1))
        mean, variance = x.mean(axes), x.var(axes)
        scale = self.param("scale", nn.initializers.ones_init(), (x.shape[-1],))
        bias = self.param("bias", nn.initializers.zeros_init(), (x.shape[-1],))
        return (x - mean) * jax.lax.rsqrt(variance + 1e-5) * scale + bias


NORMS = {"layer": nn.LayerNorm, "batch": BatchNorm, "none": None}


class MLP(nn.Module):
    """Dense, normalisation, ReLU for each width."""

    widths: Sequence[int]
    norm: str = "layer"

    @nn.compact
    def __call__(self, x):
        for width in self.widths:
            x = nn.Dense(width)(x)
            x = nn.relu(x if self.norm == "none" else NORMS[self.norm]()(x))
        return x
