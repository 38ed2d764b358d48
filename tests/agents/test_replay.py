"""The ring: what goes in comes out, the oldest goes first, samples are uniform over what is there, and several steps in
a row are what plain Python makes of them."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxnav.agents.learner import Transition
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
    sample, steps = replay.sample(jax.random.key(0), contents, jnp.int32(1), 16)
    assert (np.asarray(steps) == 1).all()
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
    sample, _ = replay.sample(jax.random.key(steps), contents, jnp.int32(steps), 20_000)
    drawn = np.asarray(sample["value"])
    expected = [step * 10 + episode for step in range(max(0, steps - 4), steps) for episode in range(5)]
    values, counts = np.unique(drawn, return_counts=True)
    np.testing.assert_array_equal(values, expected)
    np.testing.assert_allclose(counts / drawn.size, 1 / len(expected), rtol=0.2)


def test_bytes_count_every_leaf_once():
    template = {"a": jax.ShapeDtypeStruct((3,), jnp.float32), "b": jax.ShapeDtypeStruct((), jnp.uint8)}
    replay = Replay(rows=2, template=template)
    assert replay.bytes_per_transition == 13
    assert sum(leaf.nbytes for leaf in replay.init(7).values()) == 13 * 2 * 7


ROWS, EPISODES, DRAWN, DISCOUNT = 6, 3, 400, 0.8
STEPS = (4, 6, 11, 17)  # before the ring is full, when it is, and after it has wrapped around
LONG = Replay(
    rows=ROWS,
    template=Transition(
        snapshot=jax.ShapeDtypeStruct((), jnp.int32), next_snapshot=jax.ShapeDtypeStruct((2,), jnp.int32),
        twist=jax.ShapeDtypeStruct((2,), jnp.float32), request=jax.ShapeDtypeStruct((), jnp.uint8),
        reward=jax.ShapeDtypeStruct((), jnp.float32), terminated=jax.ShapeDtypeStruct((), bool),
        ended=jax.ShapeDtypeStruct((), bool),
    ),
)  # fmt: skip


@functools.partial(jax.jit, static_argnums=3)
def recorded(key, history, steps, n):
    """A sample of ``n`` steps from what is kept of the first ``steps`` of a history `[steps, episodes]`."""

    def add(contents, step_and_row):
        step, row = step_and_row
        return jax.lax.cond(step < steps, lambda: LONG.add(contents, step, row), lambda: contents), None

    contents, _ = jax.lax.scan(add, LONG.init(EPISODES), (jnp.arange(max(STEPS)), history))
    return LONG.sample(key, contents, steps, DRAWN, n, DISCOUNT)


def in_a_row(history, steps, step, episode, n):
    """Plain Python: (reward, how many steps, the last of them) from there on."""
    reward, count = 0.0, 0
    while True:
        reward += DISCOUNT**count * float(history.reward[step, episode])
        count += 1
        if count == n or history.ended[step, episode] or step + 1 == steps:
            return reward, count, step
        step += 1


@settings(max_examples=40)
@given(
    seed=st.integers(0, 2**31 - 1),
    ends=st.floats(0.0, 0.7),
    steps=st.sampled_from(STEPS),
    n=st.sampled_from([1, 3, 9]),  # 9 is longer than all that is kept
)
def test_several_steps_are_those_of_plain_python(seed, ends, steps, n):
    """They never go on past an end or past the newest step, and never from the newest to the oldest."""
    rng = np.random.default_rng(seed)
    shape = (max(STEPS), EPISODES)
    ids = np.arange(np.prod(shape), dtype=np.int32).reshape(shape)
    ended = rng.random(shape) < ends
    history = Transition(
        snapshot=ids, next_snapshot=np.stack([ids + 1000, ids + 2000], axis=-1), request=np.uint8(ids),
        twist=np.float32(rng.normal(size=(*shape, 2))), reward=np.float32(rng.normal(size=shape)),
        terminated=ended & (rng.random(shape) < 0.5), ended=ended,
    )  # fmt: skip
    sample, counts = jax.device_get(recorded(jax.random.key(seed), history, jnp.int32(steps), n))
    kept = range(max(0, steps - ROWS), steps)
    assert set(sample.snapshot) <= {int(ids[step, episode]) for step in kept for episode in range(EPISODES)}
    assert set(sample.snapshot // EPISODES) == set(kept)  # the newest, from which one step is all, among them
    for i, (step, episode) in enumerate(zip(*np.divmod(sample.snapshot, EPISODES), strict=True)):
        reward, count, last = in_a_row(history, steps, step, episode, n)
        assert counts[i] == count
        np.testing.assert_allclose(sample.reward[i], reward, rtol=1e-5, atol=1e-6)
        for name in ("next_snapshot", "terminated", "ended"):
            np.testing.assert_array_equal(getattr(sample, name)[i], getattr(history, name)[last, episode])
        for name in ("snapshot", "twist", "request"):
            np.testing.assert_array_equal(getattr(sample, name)[i], getattr(history, name)[step, episode])
