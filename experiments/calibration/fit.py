"""Fits a behaviour to windows by gradient descent through the rollouts, from several starts at once."""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
import optax

from .model import predict

_WIDTHS = 1.0, 0.02  # metres: blur of awareness at the first and at the last step
_HUBER = 0.02  # metres: errors far below count squared, those far above by their size, so that outliers don't rule


def loss(behaviour, windows, setting, width=None):
    """Mean pseudo-Huber distance between predicted and true positions, m, weighted as `Windows` say.

    width: blur of awareness, as in `model.predict`.
    """
    predicted = jax.vmap(lambda window: predict(behaviour, window, setting, width))(windows)
    squared = jnp.sum((predicted - windows.future) ** 2, axis=-1)
    error = jnp.sqrt(squared + _HUBER**2) - _HUBER
    return jnp.sum(windows.weight * error.mean(-1)) / jnp.sum(windows.weight)


class Descent(NamedTuple):
    """How to descend. fitted: names of the fields of `Behaviour` that change; steps; batch: windows a step;
    learning_rate: of Adam, on logarithms, so that it is relative."""

    fitted: tuple[str, ...]
    steps: int = 600
    batch: int = 32
    learning_rate: float = 0.05


def fit(key, starts, windows, setting, descent, report=lambda step, losses, behaviour: None):
    """(`Behaviour` of leaves `[starts]` after the descent, loss of each `[starts]`, m, a mean of the last batches).

    starts: `Behaviour` of leaves `[starts]`; windows: `Windows`, of which each step draws some; report: called after
    every step with its number, the losses and the behaviours. The learning rate falls to 0 as a cosine, the blur of
    awareness geometrically.
    """
    windows = jax.tree.map(jnp.asarray, windows)
    logarithms = {name: jnp.log(getattr(starts, name)) for name in descent.fitted}
    state = jax.vmap(_optimiser(descent).init)(logarithms)
    losses = jnp.full(len(starts.radius), jnp.nan)
    for step, step_key in enumerate(jax.random.split(key, descent.steps)):
        logarithms, state, losses = _advance(
            logarithms, state, losses, starts, windows, step_key, jnp.float32(step), setting, descent
        )
        report(step, losses, _with_logarithms(starts, logarithms))
    return _with_logarithms(starts, logarithms), losses


@functools.partial(jax.jit, static_argnames=("setting", "descent"))
def _advance(logarithms, state, losses, starts, windows, key, step, setting, descent):
    """One step of all starts, on the same windows."""
    rows = jax.random.randint(key, (descent.batch,), 0, len(windows.instant))
    windows = jax.tree.map(lambda leaf: leaf[rows], windows)
    first, last = _WIDTHS
    width = first * (last / first) ** (step / descent.steps)

    def one(logarithms, state, start):
        value, gradient = jax.value_and_grad(
            lambda free: loss(_with_logarithms(start, free), windows, setting, width)
        )(logarithms)  # fmt: skip
        updates, state = _optimiser(descent).update(gradient, state)
        return optax.apply_updates(logarithms, updates), state, value

    logarithms, state, values = jax.vmap(one)(logarithms, state, starts)
    return logarithms, state, jnp.where(step == 0, values, 0.95 * losses + 0.05 * values)


def _optimiser(descent):
    return optax.adam(optax.cosine_decay_schedule(descent.learning_rate, descent.steps))


def _with_logarithms(behaviour, logarithms):
    return behaviour._replace(**{name: jnp.exp(value) for name, value in logarithms.items()})
