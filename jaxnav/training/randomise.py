"""Domain randomisation: an episode's `Params`, drawn anew from the seed that its states and snapshots carry.

So replay stores no `Params`: they are drawn again from a snapshot.
"""

import dataclasses
from collections.abc import Sequence

import jax
import jax.numpy as jnp

from ..fields import rule_of
from ..world import Params, WorldConfig, check_params

_RANDOMISE = 0x52414E44  # sets these draws apart from the sensor noise, which has the same seed
_WHOLE = frozenset(field.name for field in dataclasses.fields(Params) if (rule := rule_of(field)) and rule.whole)

Ranges = Sequence[tuple[str, float, float]]  # name, lowest and highest of each field that is drawn


def check_ranges(ranges: Ranges, params: Params, config: WorldConfig) -> None:
    """ValueError names the range that is unknown, upside down, or outside what `check_params` allows."""
    for name, low, high in ranges:
        if not hasattr(params, name):
            raise ValueError(f"world.randomise names {name!r}: give fields of world.params")
        if not low <= high:
            raise ValueError(f"world.randomise has {low} to {high} for {name}: give the lower end first")
        if name == "crowd_size" and low < 1:
            raise ValueError(f"world.randomise has {low} to {high} for crowd_size: give at least 1, since 0 means all")
        for value in (low, high):
            try:
                check_params(_consistent(params.replace(**{name: value})), config)
            except ValueError as error:
                raise ValueError(f"world.randomise, {error}") from None
    if len({name for name, _, _ in ranges}) < len(ranges):
        raise ValueError("world.randomise names a field twice: give one range for each")


def draw(seed: jax.Array, params: Params, ranges: Ranges) -> Params:
    """``params`` with each field of ``ranges``, (name, lowest, highest), drawn uniformly by the uint32 ``seed``.

    Latencies and crowds are whole numbers, both ends included; no walking speed exceeds the top speed.
    """
    uniform = jax.random.uniform(jax.random.fold_in(jax.random.key(seed), _RANDOMISE), (len(ranges),))
    values = {
        name: jnp.floor(low + u * (high - low + 1)) if name in _WHOLE else low + u * (high - low)
        for u, (name, low, high) in zip(uniform, ranges, strict=True)
    }
    return _consistent(params.replace(**values))


def _consistent(params):
    return params.replace(max_speed=jnp.maximum(params.max_speed, params.preferred_speed))
