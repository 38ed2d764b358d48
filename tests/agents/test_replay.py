"""The ring: what goes in comes out, the oldest goes first, and samples are uniform over what is there."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxnav.agents.replay import Replay

DTYPES = ["float32", "uint8", "int32", "bool", "uint32", "uint16"]


def shapes(tree):
    return jax.tree.map(lambda leaf: jax.ShapeDtypeStruct(leaf.shape[1:], leaf.dtype), tree)


@settings(deadline=None, max_examples=15)
@given(st.lists(st.tuples(st.sampled_from(DTYPES), st.sampled_from([(), (3,), (2, 2)])), min_size=1, max_size=5))
def test_a_sample_is_one_of_the_transitions_whole(leaves):
    episodes = 3
    rng = np.random.default_rng(0)
    tree = {
        f"leaf{i}": jnp.asarray(rng.integers(0, 2 if dtype == "bool" else 200, (episodes, *shape)).astype(dtype))
        for i, (dtype, shape) in enumerate(leaves)
    }
    tree["id"] = jnp.arange(episodes)
    replay = Replay(rows=2, template=shapes(tree))
    contents = replay.add(replay.init(episodes), jnp.int32(0), tree)
    sample = replay.sample(jax.random.key(0), contents, jnp.int32(1), 16)
    for name, leaf in tree.items():
        assert sample[name].dtype == leaf.dtype
        np.testing.assert_array_equal(sample[name], leaf[sample["id"]])


@pytest.fixture
def ring():
    replay = Replay(rows=4, template={"value": jax.ShapeDtypeStruct((), jnp.int32)})

    def filled(steps, episodes=5):
        contents = replay.init(episodes)
        for step in range(steps):
            contents = replay.add(contents, jnp.int32(step), {"value": step * 10 + jnp.arange(episodes)})
        return replay, contents

    return filled


@pytest.mark.parametrize("steps", [1, 3, 4, 6, 9])
def test_samples_are_uniform_over_the_newest_rows_only(ring, steps):
    replay, contents = ring(steps)
    drawn = np.asarray(replay.sample(jax.random.key(steps), contents, jnp.int32(steps), 20_000)["value"])
    expected = [step * 10 + episode for step in range(max(0, steps - 4), steps) for episode in range(5)]
    values, counts = np.unique(drawn, return_counts=True)
    np.testing.assert_array_equal(values, expected)
    np.testing.assert_allclose(counts / drawn.size, 1 / len(expected), rtol=0.2)


def test_bytes_count_every_leaf_once():
    template = {"a": jax.ShapeDtypeStruct((3,), jnp.float32), "b": jax.ShapeDtypeStruct((), jnp.uint8)}
    replay = Replay(rows=2, template=template)
    assert replay.bytes_per_transition == 13
    assert sum(leaf.nbytes for leaf in replay.init(7).values()) == 13 * 2 * 7
