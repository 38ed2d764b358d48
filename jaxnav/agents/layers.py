"""The layers that encoders, actors and critics share."""

from collections.abc import Sequence

import flax.linen as nn
import jax


class MLP(nn.Module):
    """A dense layer, LayerNorm and ReLU for each width: `[..., inputs]` -> `[..., widths[-1]]`."""

    widths: Sequence[int]

    @nn.compact
    def __call__(self, x: jax.Array) -> jax.Array:
        for width in self.widths:
            x = nn.relu(nn.LayerNorm()(nn.Dense(width)(x)))
        return x
