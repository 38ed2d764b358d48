"""Replay: a ring of transitions, one row a step and one column an episode, packed by data type.

Generic in what it stores: any pytree of arrays `[episodes, ...]`. The model is flashbax's trajectory buffer.
"""

import dataclasses
import functools
from collections import defaultdict
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

Contents = dict[str, jax.Array]


@dataclasses.dataclass(frozen=True)
class Replay:
    """The layout of a buffer; its contents are a dict of arrays `[rows, episodes, numbers]`, one for each data type.

    Packing turns some fifty small gathers a sample into four, and stores no padding.

    Attributes:
        rows: steps that are kept.
        template: one transition, shapes and types only.
        shards: equal parts of the episodes, each with the same share in every sample.
    """

    rows: int
    template: Any
    shards: int = 1

    @property
    def bytes_per_transition(self) -> int:
        """Bytes that a transition takes."""
        return sum(leaf.size * leaf.dtype.itemsize for leaf in jax.tree.leaves(self.template))

    def init(self, episodes: int) -> Contents:
        """Empty contents for that many parallel episodes."""
        return {
            dtype: jnp.zeros((self.rows, episodes, sum(leaf.size for leaf in leaves)), dtype)
            for dtype, leaves in self._by_type(self.template).items()
        }

    def add(self, contents: Contents, step: jax.Array | int, transitions: Any) -> Contents:
        """Write the transitions `[episodes, ...]` of env step ``step`` over the oldest ones."""
        packed = {
            dtype: jnp.concatenate([leaf.reshape(leaf.shape[0], -1) for leaf in leaves], axis=1)
            for dtype, leaves in self._by_type(transitions).items()
        }
        row = step % self.rows
        return {name: jax.lax.dynamic_update_index_in_dim(contents[name], packed[name], row, 0) for name in contents}

    def sample(
        self, key: jax.Array, contents: Contents, steps: jax.Array | int, batch: int, n: int = 1,
        discount: jax.Array | float = 1.0, since: jax.Array | int = 0,
    ) -> tuple[Any, jax.Array]:  # fmt: skip
        """``batch`` uniform transitions `[batch, ...]` of the last ``rows`` of ``steps`` steps: (transitions, steps).

        Those of a shard are in a row, and drawn from its own episodes: no shard reads the rows of another.

        With ``n`` above 1 each spans n steps, or fewer where its episode or the record ends: its reward is their
        discounted sum, its next snapshot and its end are those of the last of them, and ``steps`` says how many.

        since: the first step whose transitions count; earlier ones belong to somebody else.
        """
        episodes = next(iter(contents.values())).shape[1] // self.shards
        oldest = steps - jnp.minimum(steps - since, self.rows)
        low, high = jnp.stack([oldest, 0]), jnp.stack([steps, episodes])
        # One draw, where `randint` takes three; what it divides by is far below 2^32.
        drawn = jax.random.bits(key, (2, batch), jnp.uint32) % (high - low).astype(jnp.uint32)[:, None]
        step, column = low[:, None] + drawn.astype(jnp.int32)

        take = by_shard(lambda table, row, column: table[row, column], self.shards, axes=(1, 0, 0))

        def at(step):
            row = step % self.rows
            return self._unpack({dtype: take(table, row, column) for dtype, table in contents.items()}, batch)

        first = last = at(step)
        if n == 1:  # nothing to add
            return first, jnp.ones(batch, jnp.int32)
        reward, count, goes_on = first.reward, jnp.ones(batch, jnp.int32), ~first.ended
        for i in range(1, n):
            goes_on &= step + i < steps
            then = at(step + i)
            reward += jnp.where(goes_on, discount**i * then.reward, 0.0)
            count += goes_on
            last = jax.tree.map(functools.partial(select, goes_on), then, last)
            goes_on &= ~then.ended
        ends = {name: getattr(last, name) for name in ("next_snapshot", "terminated", "ended")}
        return first.replace(reward=reward, **ends), count

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


def by_shard(function: Callable[..., jax.Array], shards: int, axes: Sequence[int]) -> Callable[..., jax.Array]:
    """``function`` of arrays with rows, as a function that sees one shard's rows at a time.

    The rows are parted into ``shards`` of the same size; the results `[n, ...]` of all shards follow each other. Where
    arrays lie on several devices, whole shards on each, none is moved.

    axes: the axis of the rows, for each argument.
    """
    if shards == 1:
        return function

    def parted(*arrays):
        parts = [
            leaf.reshape(*leaf.shape[:axis], shards, -1, *leaf.shape[axis + 1 :])
            for leaf, axis in zip(arrays, axes, strict=True)
        ]
        out = jax.vmap(function, in_axes=axes)(*parts)
        return out.reshape(-1, *out.shape[2:])

    return parted


def select(mask: jax.Array, new: jax.Array, old: jax.Array) -> jax.Array:
    """``new`` where ``mask`` `[n]` is set and ``old`` elsewhere, `[n, ...]` both."""
    return jnp.where(mask.reshape(-1, *[1] * (old.ndim - 1)), new, old)
