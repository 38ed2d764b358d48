"""Error measures against closed forms."""

import numpy as np
import pytest
from scipy import stats

from experiments.calibration import measures
from experiments.calibration.model import Behaviour, Setting

SETTING = Setting()


def test_constant_velocity_errs_by_the_acceleration_it_ignores(walkers):
    """x = v t + a t^2 / 2: the error is a t^2 / 2."""
    t = 0.4 * np.arange(1, 13)
    future = np.stack([np.stack([1.2 * t, 0.3 * t**2 / 2], axis=1), np.stack([9 - 1.0 * t, 0 * t], axis=1)])
    window = walkers([[0, 0], [9, 0]], [[1.2, 0], [-1, 0]], future)
    constant = Behaviour(1.0, 0.0, 1.0, 0.1, memory=1e-3, relaxation=1e6)
    distance = measures.displacement(constant, window, SETTING)
    np.testing.assert_allclose(distance[0], [0.3 * t**2 / 2, 0 * t], atol=2e-5)
    curves = measures.by_person(distance, window)
    expected = [[np.mean(0.15 * t**2), 0.15 * 4.8**2], [0, 0]]
    np.testing.assert_allclose(measures.errors(curves), expected, atol=2e-5)


def test_people_count_alike_however_many_windows_they_have(walkers):
    distance = np.array([1.0, 3.0, 10.0, 99.0]).reshape(2, 2, 1)
    person = np.array([[4, 7], [4, 8]])
    window = walkers([[0, 0]], [[0, 0]], np.zeros((1, 1, 2)))._replace(
        person=person, weight=np.array([[1.0, 1.0], [1.0, 0.0]])
    )
    np.testing.assert_allclose(measures.by_person(distance, window), [[5.5], [3.0]])


def test_bootstrap_interval_of_a_mean_is_the_normal_one_of_many_people():
    values = np.random.default_rng(3).normal(2.0, 0.5, (400, 2))
    mean, low, high = measures.bootstrap(values, seed=1)
    half = stats.norm.ppf(0.975) * values.std(axis=0) / np.sqrt(400)
    np.testing.assert_allclose(mean, values.mean(axis=0))
    np.testing.assert_allclose(high - mean, half, rtol=0.05)
    np.testing.assert_allclose(mean - low, half, rtol=0.05)


def test_bootstrap_of_equals_has_no_width():
    assert measures.bootstrap(np.full(7, 0.25), seed=0) == pytest.approx((0.25, 0.25, 0.25))
