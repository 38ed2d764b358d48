"""Options of the critics that experiments/tricks.py compares: each does what it says."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxnav.agents.distributions import BINS, histogram
from jaxnav.agents.hsac import HSAC, HSACConfig, HSACHyperparameters
from jaxnav.agents.layers import BatchNorm

HYPER = HSACHyperparameters()


@given(st.lists(st.floats(-40.0, 40.0, width=32), min_size=1, max_size=5))
def test_a_histogram_has_the_mean_of_its_value(values):
    mass = np.asarray(histogram(jnp.float32(values)))
    np.testing.assert_allclose(mass.sum(axis=-1), 1.0, rtol=1e-5)
    assert (mass >= 0).all()
    inside = np.clip(values, BINS[0], BINS[-1])
    # Near the ends half of a histogram is cut off.
    near_end = (inside < BINS[0] + 2) | (inside > BINS[-1] - 2)
    assert (np.abs(mass @ BINS - inside) < np.where(near_end, 0.5, 0.01)).all()


def test_batch_statistics_normalise_a_batch():
    x = 3.0 + 2.0 * jax.random.normal(jax.random.key(0), (64, 2, 5))
    y = BatchNorm().apply({"params": {"scale": jnp.full(5, 2.0), "bias": jnp.full(5, 1.0)}}, x)
    np.testing.assert_allclose(y.mean(axis=(0, 1)), 1.0, atol=1e-5)
    np.testing.assert_allclose(y.std(axis=(0, 1)), 2.0, atol=1e-4)


def learner(blank_observation, **options):
    agent = HSAC(HSACConfig(actor_widths=(8,), critic_widths=(8,), language="codes", **options))
    return agent, jax.jit(agent.init)(jax.random.key(1), blank_observation(True), HYPER)


def critic_loss(agent, state, batch, hyper=HYPER):
    temperatures = jax.tree.map(jnp.exp, state.log_temperatures)
    return jax.jit(agent._critic_loss)(state.critic, jax.random.key(2), state, batch, temperatures, hyper)[0]


def doubled(tree):
    return jax.tree.map(lambda leaf: 2.0 * leaf, tree)


@pytest.mark.parametrize("options", [{"critic_norm": "batch"}, {}])
def test_only_batch_statistics_do_without_target_critics(options, blank_observation, random_batch):
    agent, state = learner(blank_observation, **options)
    batch = random_batch(np.random.default_rng(0), (16,))
    same = critic_loss(agent, state.replace(target_critic=doubled(state.target_critic)), batch)
    assert (critic_loss(agent, state, batch) == same) == ("critic_norm" in options)


def test_the_twins_are_judged_by_their_lesser_or_their_mean():
    q = jnp.array([[[1.0, 5.0]], [[3.0, 2.0]]])
    assert HSAC(HSACConfig(language="codes", requests=2))._judge(q).tolist() == [[1.0, 2.0]]
    assert HSAC(HSACConfig(language="codes", requests=2, twins="mean"))._judge(q).tolist() == [[2.0, 3.5]]


@pytest.mark.parametrize("critic", ["scalar", "histogram"])
def test_every_request_is_judged_with_its_own_twist(critic, blank_observation, random_batch):
    agent, state = learner(blank_observation, heads="per-request", critic=critic)
    observation = random_batch(np.random.default_rng(0), (16,)).observation
    twist = jax.random.uniform(jax.random.key(3), (16, 4, 2), minval=-1.0)
    own = agent._q(state.critic, observation, twist)
    for request in range(4):
        alone = agent._q(state.critic, observation, twist[:, request])
        np.testing.assert_allclose(own[:, :, request], alone[:, :, request], atol=1e-5)
    assert np.abs(own - agent._q(state.critic, observation, twist[:, ::-1])).max() > 1e-3


def test_per_request_heads_learn_from_batch_statistics(blank_observation, random_batch):
    agent, state = learner(blank_observation, heads="per-request", critic_norm="batch")
    batch = random_batch(np.random.default_rng(0), (16,))
    first = critic_loss(agent, state, batch)
    update = jax.jit(agent.update)
    for step in range(30):
        state, _ = update(jax.random.key(step), state, batch, HYPER)
    assert critic_loss(agent, state, batch) < 0.7 * first


def test_entropy_enters_the_backup_as_far_as_it_is_asked(blank_observation, random_batch):
    agent, state = learner(blank_observation)
    batch = random_batch(np.random.default_rng(0), (16,))
    warm = state.replace(log_temperatures=jax.tree.map(lambda leaf: leaf + 2.0, state.log_temperatures))
    without = HYPER.replace(backup_entropy=0.0)
    assert critic_loss(agent, state, batch, without) == critic_loss(agent, warm, batch, without)
    assert critic_loss(agent, state, batch) != critic_loss(agent, warm, batch)


def test_a_delayed_actor_moves_with_every_second_update(blank_observation, random_batch):
    agent, state = learner(blank_observation, actor_every=2, critic="histogram")
    update = jax.jit(agent.update)
    batch = random_batch(np.random.default_rng(0), (16,))
    for step, moves in enumerate((True, False, True)):
        new, metrics = update(jax.random.key(step), state, batch, HYPER, 1.0, step)
        for name, moved in (("actor", moves), ("averaged", moves), ("log_temperatures", moves), ("critic", True)):
            pairs = zip(jax.tree.leaves(getattr(state, name)), jax.tree.leaves(getattr(new, name)), strict=True)
            assert any((a != b).any() for a, b in pairs) == moved, (name, step)
        assert (metrics["actor_loss"] != 0) == moves
        assert np.isfinite(metrics["critic_loss"])
        state = new
