"""The reward of a step, term by term (docs/world.md section 8)."""

import jax.numpy as jnp

from .types import RewardTerms


def closeness(distance, params):
    """Penalty for a surface distance to a pedestrian below ``safe_distance``; 0 beyond, ``distance`` not below 0."""
    return params.reward_closeness * jnp.maximum(params.safe_distance - jnp.maximum(distance, 0.0), 0.0)


def reward_terms(arrived, collided, progress, distance, min_distance, fits, follows, params, kind):
    """`RewardTerms` of one step.

    progress: metres nearer to the goal; distance: swept surface distance to the nearest pedestrian, min_distance: its
    minimum over the episode; fits: a fitting request was made; follows: the robot does what it is asked;
    kind: "code" (arrival and collision replace shaping and step cost) or "text" (all terms at every step, closeness
    charged once, at arrival, for the whole episode).
    """
    ended = arrived | collided
    charged = ~collided if kind == "code" else arrived
    counts = ~ended if kind == "code" else True
    return RewardTerms(
        goal=jnp.where(collided, params.reward_collision, jnp.where(arrived, params.reward_arrival, 0.0)),
        shaping=jnp.where(counts, params.reward_progress * progress, 0.0),
        step=jnp.where(counts, params.reward_step, 0.0),
        closeness=jnp.where(charged, closeness(distance if kind == "code" else min_distance, params), 0.0),
        request=jnp.where(fits, params.reward_request, 0.0),
        response=jnp.where(follows, params.reward_response, 0.0),
    )
