"""Rewards: functions of the events of a step (docs/world.md section 8)."""

import inspect
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from flax import struct

from .params import Params


class StepEvents(struct.PyTreeNode):
    """The events of one step.

    arrived:       bool, it reached the goal.
    collided:      bool, it touched a wall or a pedestrian.
    hit_pedestrian: bool, it touched a pedestrian; implies ``collided``.
    progress:      metres nearer to the goal than before the step.
    goal_distance: to the goal at the end of the step, m.
    distance:      smallest surface distance to a pedestrian within the step, m; inf where nobody is there.
    min_distance:  the same over the episode so far.
    requested:     int, an index into `REQUESTS`: the request that counted in this step.
    fits:          bool, that request suits the geometry.
    follows:       bool, the robot does what a pedestrian asked of it.
    v, w:          the robot's twist in this step, m/s and rad/s.
    """

    arrived: jax.Array
    collided: jax.Array
    hit_pedestrian: jax.Array
    progress: jax.Array
    goal_distance: jax.Array
    distance: jax.Array
    min_distance: jax.Array
    requested: jax.Array
    fits: jax.Array
    follows: jax.Array
    v: jax.Array
    w: jax.Array


# The terms of a step's reward by name, scalars that add up to it.
RewardFunction = Callable[[StepEvents, Params], dict[str, jax.Array]]

REWARDS: dict[str, RewardFunction] = {}


_REMEDY = "give a function (StepEvents, Params) -> dict of scalar terms"


def _check_call(function, name):
    """ValueError: ``function`` can't be called with two arguments."""
    if not callable(function):
        raise ValueError(f"world.reward is {name}, a {type(function).__name__}: {_REMEDY}")
    try:
        inspect.signature(function).bind(None, None)
    except TypeError as error:
        raise ValueError(f"world.reward is {name}, which doesn't take two arguments ({error}): {_REMEDY}") from None


def register_reward(name: str, function: RewardFunction) -> RewardFunction:
    """Make a reward known by a name, for ``WorldConfig.reward``. ValueError: it is none, or another has that name."""
    _check_call(function, name)
    if REWARDS.get(name, function) is not function:
        raise ValueError(f"reward {name!r} is registered twice: give the second one a name of its own")
    REWARDS[name] = function
    return function


def closeness(distance: jax.Array, params: Params) -> jax.Array:
    """Penalty for a surface distance to a pedestrian below ``safe_distance``; 0 beyond, ``distance`` not below 0."""
    return params.reward_closeness * jnp.maximum(params.safe_distance - jnp.maximum(distance, 0.0), 0.0)


def authors_code(events: StepEvents, params: Params) -> dict[str, jax.Array]:
    """The reward of the paper's code: arrival and collision replace progress and the cost of the step."""
    goes_on = ~(events.arrived | events.collided)
    return {
        "goal": _goal(events, params),
        "shaping": jnp.where(goes_on, params.reward_progress * events.progress, 0.0),
        "step": jnp.where(goes_on, params.reward_step, 0.0),
        "closeness": jnp.where(events.collided, 0.0, closeness(events.distance, params)),
        **_dialogue(events, params),
    }


def paper_text(events: StepEvents, params: Params) -> dict[str, jax.Array]:
    """The reward of the paper's text: all terms at every step; closeness once, at arrival, for the whole episode."""
    return {
        "goal": _goal(events, params),
        "shaping": jnp.asarray(params.reward_progress * events.progress),
        "step": jnp.asarray(params.reward_step),
        "closeness": jnp.where(events.arrived, closeness(events.min_distance, params), 0.0),
        **_dialogue(events, params),
    }


register_reward("authors-code", authors_code)
register_reward("paper-text", paper_text)


def _goal(events, params):
    return jnp.where(events.collided, params.reward_collision, jnp.where(events.arrived, params.reward_arrival, 0.0))


def _dialogue(events, params):
    return {
        "request": jnp.where(events.fits, params.reward_request, 0.0),
        "response": jnp.where(events.follows, params.reward_response, 0.0),
    }


def find_reward(name: str) -> RewardFunction:
    """The registered reward of that name. ValueError: there is none."""
    if name not in REWARDS:
        raise ValueError(f"world.reward is {name!r}: choose {', '.join(REWARDS)}, or register_reward({name!r}, ...)")
    return REWARDS[name]


def check_reward(function: RewardFunction, name: str) -> None:
    """ValueError: ``function`` is no function of (`StepEvents`, `Params`) that returns a dict of scalars."""
    _check_call(function, name)
    flags: dict[str, Any] = dict.fromkeys(
        ("arrived", "collided", "hit_pedestrian", "fits", "follows"), jax.ShapeDtypeStruct((), bool)
    )
    floats: dict[str, Any] = dict.fromkeys(
        ("progress", "goal_distance", "distance", "min_distance", "v", "w"), jax.ShapeDtypeStruct((), jnp.float32)
    )
    flags["requested"] = jax.ShapeDtypeStruct((), jnp.int32)
    events = StepEvents(**flags, **floats)
    try:
        terms = jax.eval_shape(function, events, Params())
    except Exception as error:
        text = str(error).partition("\n")[0]
        raise ValueError(f"world.reward is {name}, which raises {type(error).__name__} ({text}): {_REMEDY}") from error
    if not isinstance(terms, dict) or not terms:
        raise ValueError(f"world.reward is {name}, which returns a {type(terms).__name__}: {_REMEDY}")
    for term, value in terms.items():
        shape = getattr(value, "shape", None)
        if not isinstance(term, str) or shape != () or not jnp.issubdtype(value.dtype, jnp.number):
            given = f"{value.dtype} {list(shape)}" if shape is not None else type(value).__name__
            raise ValueError(f"world.reward is {name}, whose term {term!r} is {given}: {_REMEDY}")
