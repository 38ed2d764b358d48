"""The world as a gymnax environment, with the signature and the spaces of gymnax 1.0."""

# gymnax may be missing here, and annotates less than it takes.
# pyright: reportMissingImports=none, reportArgumentType=none

import math
from typing import Any

import jax
import jax.numpy as jnp

try:
    from gymnax.environments import environment, spaces
except ImportError as error:
    raise ImportError('jaxnav.adapters.gymnax needs gymnax: pip install "gymnax>=1.0" six') from error

from ..world import Action, World
from ..world.types import REQUESTS
from .observation import flat, shapes


class GymnaxWorld(environment.Environment):
    """The world with gymnax's interface; params are `Params`, and the state is a `State`.

    ``reset(key, params)`` -> obs, state; ``step(key, state, action, params)`` -> obs, state, reward, terminated,
    truncated, info. An observation is the vector of `jaxnav.adapters.observation.flat`, an action a pair (twist `[2]`
    in [-1, 1], request).
    gymnax's ``step`` resets an ended episode; ``info["final_observation"]`` is the last one before that. As gymnax has
    it, an episode that ends by itself in its last step is both terminated and truncated. ``info`` has the events of the
    step. ``with_transition_gradients()`` gives a copy whose observations and states keep their gradients.
    """

    _supports_transition_gradients = True

    def __init__(self, world: World | None = None) -> None:
        self.world = World() if world is None else world

    @property
    def default_params(self) -> Any:
        """The `Params` of the world's scenes."""
        return self.world.default_params

    def reset_env(self, key: jax.Array, params: Any) -> tuple[jax.Array, Any]:
        state = self.world.reset(key, params)
        return self.observe(key, state, None, params), state

    def step_env(self, key: jax.Array, state: Any, action: Any, params: Any) -> Any:
        twist, request = action
        state, outcome = self.world.step(key, state, Action(twist=twist, request=request), params)
        observation = self.observe(key, state, action, params)
        observation, state = self._apply_transition_gradient_policy(observation, state)
        info = {name: getattr(outcome, name) for name in ("arrived", "collided", "hit_pedestrian")}
        return observation, state, outcome.reward, outcome.terminated, info

    def observe(self, key: jax.Array, state: Any, action: Any, params: Any) -> jax.Array:
        del key, action  # sensor noise included, an observation is a function of the state
        return flat(self.world.observe(state, params), params)

    def is_truncated(self, state: Any, params: Any) -> jax.Array:
        return state.t >= params.max_steps

    def action_space(self, params: Any) -> spaces.Tuple:
        return spaces.Tuple((spaces.Box(-1.0, 1.0, (2,)), spaces.Discrete(len(REQUESTS))))

    def observation_space(self, params: Any) -> spaces.Box:
        return spaces.Box(-jnp.inf, jnp.inf, (sum(math.prod(shape) for shape in shapes(self.world).values()),))
