"""Displacement errors of predictions, a person at a time, and their bootstrap intervals."""

import functools

import jax
import numpy as np

from .model import predict

_CHUNK = 32  # windows predicted at once: bounds memory


def displacement(behaviour, windows, setting):
    """`[M, P, T]` distances between predicted and true positions, m; where ``weight`` is 0 they mean nothing."""
    return np.linalg.norm(positions(behaviour, windows, setting) - windows.future, axis=-1)


def positions(behaviour, windows, setting):
    """`[M, P, T, 2]` predicted positions, m."""
    return np.asarray(_positions(behaviour, windows, setting))


@functools.partial(jax.jit, static_argnames="setting")
def _positions(behaviour, windows, setting):
    return jax.lax.map(lambda window: predict(behaviour, window, setting), windows, batch_size=_CHUNK)


def by_person(distance, windows):
    """`[N, T]` mean distance of each of the N people who count, over its windows, in the order of their indices."""
    counts = windows.weight > 0
    person, distance = windows.person[counts], distance[counts]
    return np.stack([distance[person == one].mean(axis=0) for one in np.unique(person)])


def errors(curves):
    """`[N, 2]` average (ADE) and final displacement error (FDE) of curves `[N, T]`, m."""
    return np.stack([curves.mean(axis=1), curves[:, -1]], axis=1)


def bootstrap(values, seed, draws=10_000):
    """(mean, lower, upper) of values `[N, ...]` over people: the 95 % percentile interval, N redrawn each time."""
    values = np.asarray(values)
    generator = np.random.default_rng(seed)
    # A chunk at a time: draws x N x ... would fill memory.
    means = [values[generator.integers(0, len(values), (100, len(values)))].mean(axis=1) for _ in range(draws // 100)]
    low, high = np.percentile(np.concatenate(means), (2.5, 97.5), axis=0)
    return values.mean(axis=0), low, high
