"""Replay: a ring of transitions, one row a step and one column an episode, packed by data type.

Generic in what it stores: any pytree of arrays `[episodes, ...]`. The model is flashbax's trajectory buffer.
"""

import dataclasses
from collections import defaultdict

import jax
import jax.numpy as jnp
import numpy as np


@dataclasses.dataclass(frozen=True)
class Replay:
    """The layout of a buffer; its contents are a dict of arrays `[rows, episodes, numbers]`, one for each data type.

    Packing turns some fifty small gathers a sample into four, and stores no padding.

    rows:      steps that are kept.
    template:  one transition, shapes and types only.
    """

    rows: int
    template: object

    @property
    def bytes_per_transition(self):
        return sum(leaf.size * leaf.dtype.itemsize for leaf in jax.tree.leaves(self.template))

    def init(self, episodes):
        """Empty contents for that many parallel episodes."""
        return {
            dtype: jnp.zeros((self.rows, episodes, sum(leaf.size for leaf in leaves)), dtype)
            for dtype, leaves in self._by_type(self.template).items()
        }

    def add(self, contents, step, transitions):
        """Write the transitions `[episodes, ...]` of env step ``step`` over the oldest ones."""
        packed = {
            dtype: jnp.concatenate([leaf.reshape(leaf.shape[0], -1) for leaf in leaves], axis=1)
            for dtype, leaves in self._by_type(transitions).items()
        }
        row = step % self.rows
        return {name: jax.lax.dynamic_update_index_in_dim(contents[name], packed[name], row, 0) for name in contents}

    def sample(self, key, contents, steps, batch):
        """``batch`` uniform transitions `[batch, ...]` of the last ``rows`` of ``steps`` steps."""
        episodes = next(iter(contents.values())).shape[1]
        filled = jnp.minimum(steps, self.rows)
        row, column = jax.random.randint(key, (2, batch), 0, jnp.stack([filled, episodes])[:, None])
        return self._unpack({dtype: table[row, column] for dtype, table in contents.items()}, batch)

    def _by_type(self, tree):
        groups = defaultdict(list)
        for leaf in jax.tree.leaves(tree):
            groups[str(leaf.dtype)].append(leaf)
        return dict(groups)

    def _unpack(self, packed, batch):
        leaves, treedef = jax.tree.flatten(self.template)
        offsets, out = defaultdict(int), []
        for leaf in leaves:
            name, size = str(leaf.dtype), int(np.prod(leaf.shape))
            start = offsets[name]
            out.append(packed[name][:, start : start + size].reshape(batch, *leaf.shape))
            offsets[name] += size
        return jax.tree.unflatten(treedef, out)
