"""Domain randomisation: an episode's `Params`, drawn anew from the seed that its states and snapshots carry.

So replay stores no `Params`: whoever has a snapshot can draw them again.
"""

import jax
import jax.numpy as jnp

from ..world import check_params

_RANDOMISE = 0x52414E44  # sets these draws apart from the sensor noise, which has the same seed
_WHOLE = ("crowd_size", "control_latency", "scan_latency")


def check_ranges(ranges, params, config):
    """ValueError names the range that is unknown, upside down, or leaves what `check_params` allows."""
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


def draw(seed, params, ranges):
    """``params`` with each field of ``ranges``, (name, lowest, highest), drawn uniformly by the uint32 ``seed``.

    Latencies and crowds are whole numbers, both ends included; nobody's walking speed exceeds their top speed.
    """
    uniform = jax.random.uniform(jax.random.fold_in(jax.random.key(seed), _RANDOMISE), (len(ranges),))
    values = {
        name: jnp.floor(low + u * (high - low + 1)) if name in _WHOLE else low + u * (high - low)
        for u, (name, low, high) in zip(uniform, ranges, strict=True)
    }
    return _consistent(params.replace(**values))


def _consistent(params):
    return params.replace(max_speed=jnp.maximum(params.max_speed, params.preferred_speed))
