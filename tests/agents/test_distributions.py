"""Densities and entropies against integration, a change of variables, and the definition."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxnav.agents.distributions import entropy, request_log_probabilities, sample_twist, twist_log_density


@pytest.mark.parametrize(("mean", "log_std"), [((0.0, 0.0), (-1.0, -0.5)), ((0.8, -1.2), (-0.5, -1.5))])
def test_twist_density_integrates_to_one(mean, log_std):
    edge = np.linspace(-1, 1, 2001)
    centre = 0.5 * (edge[1:] + edge[:-1])
    grid = jnp.stack(jnp.meshgrid(centre, centre, indexing="ij"), axis=-1)
    density = jnp.exp(twist_log_density(grid, jnp.array(mean), jnp.array(log_std)))
    assert float(jnp.sum(density)) * (centre[1] - centre[0]) ** 2 == pytest.approx(1.0, abs=2e-3)


def test_sample_reports_its_own_density():
    mean, log_std = jnp.array([0.3, -0.7]), jnp.array([-1.0, -0.3])
    twist, log_density = sample_twist(jax.random.key(0), jnp.tile(mean, (1000, 1)), log_std)
    np.testing.assert_allclose(log_density, twist_log_density(twist, mean, log_std), atol=2e-3)
    raw = np.arctanh(np.asarray(twist, np.float64))
    np.testing.assert_allclose(raw.mean(0), mean, atol=0.07)
    np.testing.assert_allclose(raw.std(0), np.exp(log_std), rtol=0.08)


def test_density_is_finite_far_out_on_the_tanh():
    twist, log_density = sample_twist(jax.random.key(1), jnp.full((64, 2), 30.0), jnp.zeros(2))
    assert np.isfinite(log_density).all() and (np.abs(twist) <= 1).all()


def test_a_request_that_does_not_count_is_none_without_entropy_or_nan_gradient():
    logits = jnp.array([[0.1, 3.0, -1.0, 2.0], [0.1, 3.0, -1.0, 2.0]])
    counts = jnp.array([False, True])
    log_p = request_log_probabilities(logits, counts)
    np.testing.assert_allclose(jnp.exp(log_p[0]), [1, 0, 0, 0], atol=1e-12)
    np.testing.assert_allclose(log_p[1], jax.nn.log_softmax(logits[1]), rtol=1e-6)
    np.testing.assert_allclose(entropy(log_p)[0], 0.0, atol=1e-6)
    gradient = jax.grad(lambda z: entropy(request_log_probabilities(z, counts)).sum())(logits)
    assert np.isfinite(gradient).all() and (gradient[0] == 0).all()


def test_entropy_of_uniform_requests_is_log_four():
    assert float(entropy(request_log_probabilities(jnp.zeros(4), jnp.bool_(True)))) == pytest.approx(
        np.log(4), rel=1e-6
    )
