"""The legs of a walking pedestrian: on the ground in stance, then swung past each other; together at rest.

Source: docs/world.md section 7.
"""

import jax
import jax.numpy as jnp

from .geometry import norm
from .params import Params

LEG_RADIUS = 0.1  # of a leg, and its distance to the side of the middle, m
_SLOW = 0.1  # speed below which the legs close up, m/s
# Step length over cadence: 0.0065 m for a step a minute, nearly the same at all speeds (Nagasaki et al. 1996), in m s.
_WALK_RATIO = 0.39
_STANCE = 0.6  # share of a stride, two steps, for which a foot stays on the ground


def leg_radius(params: Params) -> jax.Array:
    """Radius of a leg: that of a body of up to 0.1 m; half of one of 0.2 m, where both legs fit beside each other."""
    return jnp.minimum(params.body_radius, LEG_RADIUS)


def legs(
    x: jax.Array, y: jax.Array, vx: jax.Array, vy: jax.Array, t: jax.Array, seed: jax.Array, params: Params
) -> tuple[jax.Array, jax.Array]:
    """(x, y) of all legs' middles, `[2 P]` each, right legs first, for pedestrians at x, y with vx, vy, `[P]` each.

    A pure function of how they move and the step ``t``: for an episode everybody keeps the cadence of
    ``preferred_speed``, steps as wide as the velocity asks, and is out of step with the others by ``seed``. So no leg
    jumps when a pedestrian turns, and at constant velocity a foot in stance stays where it is.
    """
    strides_per_second = 0.5 * jnp.sqrt(jnp.maximum(params.preferred_speed, _SLOW) / _WALK_RATIO)
    # Golden-ratio steps spread the walkers of an episode evenly over the stride.
    spread = seed.astype(jnp.float32) / 2.0**32 + 0.618034 * jnp.arange(x.shape[0])
    phase = t * params.dt * strides_per_second + spread
    aside = leg_radius(params) / jnp.maximum(norm(vx, vy), _SLOW)

    def leg(phase, side):
        ahead = _ahead(phase % 1.0) / strides_per_second
        return x + ahead * vx - side * aside * vy, y + ahead * vy + side * aside * vx

    (right_x, right_y), (left_x, left_y) = leg(phase, -1.0), leg(phase + 0.5, 1.0)
    return jnp.concatenate([right_x, left_x]), jnp.concatenate([right_y, left_y])


def _ahead(phase):
    """How far a foot is ahead of the body, in strides: falls back with the ground in stance, then swings forward."""
    swing = jnp.clip((phase - _STANCE) / (1.0 - _STANCE), 0.0, 1.0)
    return 0.5 * _STANCE - phase + 0.5 * (1.0 - jnp.cos(jnp.pi * swing))
