"""The world as a brax `Env`, and the wrapper that gives every episode a beginning of its own."""

# brax may be missing here, and annotates less than it takes.
# pyright: reportMissingImports=none, reportArgumentType=none

import math
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

try:
    from brax.envs import base
    from brax.envs.wrappers import training
except ImportError as error:
    raise ImportError('jaxnav.adapters.brax needs brax: pip install "brax>=0.14"') from error

from ..world import Action, Params, World, check_params
from ..world.types import REQUESTS
from .observation import flat, shapes

State = Any  # brax's `base.State`, whose `replace` type checkers don't see


class BraxWorld(base.Env):
    """One episode; brax's wrappers batch it, end it in time (``episode_length``) and reset it.

    By default the world is ``World()``, with the params of its scenes.

    An observation is the vector of `jaxnav.adapters.observation.flat`. An action is a vector `[2 + 4]` in [-1, 1]: the
    twist and a preference for each request; the request with the greatest one is said. ``done`` is arrival or collision
    only: running out of time is ``info["truncation"]`` of brax's EpisodeWrapper. A metric is 1 in its event's step.
    ValueError: params out of range.
    """

    def __init__(self, world: World | None = None, params: Params | None = None) -> None:
        self.world = World() if world is None else world
        self.params = self.world.default_params if params is None else params
        check_params(self.params, self.world.config)
        self.episode_length = math.ceil(self.params.max_steps)

    def reset(self, rng: jax.Array) -> State:
        rng, key = jax.random.split(rng)
        state, zero = self.world.reset(key, self.params), jnp.float32(0.0)
        metrics = {"arrived": zero, "collided": zero, "hit_pedestrian": zero}
        return base.State(state, self._observe(state), zero, zero, metrics, {"rng": rng})

    def step(self, state: State, action: jax.Array) -> State:
        rng, key = jax.random.split(state.info["rng"])
        taken = Action(twist=action[:2], request=jnp.argmax(action[2:]))
        now, outcome = self.world.step(key, state.pipeline_state, taken, self.params)
        metrics = {
            name: getattr(outcome, name).astype(jnp.float32) for name in ("arrived", "collided", "hit_pedestrian")
        }
        return state.replace(
            pipeline_state=now, obs=self._observe(now), reward=outcome.reward,
            done=outcome.terminated.astype(jnp.float32), metrics={**state.metrics, **metrics},
            info={**state.info, "rng": rng},
        )  # fmt: skip

    @property
    def observation_size(self) -> int:
        return sum(math.prod(shape) for shape in shapes(self.world).values())

    @property
    def action_size(self) -> int:
        return 2 + len(REQUESTS)

    @property
    def backend(self) -> str:
        return "jaxnav"

    def _observe(self, state: Any) -> jax.Array:
        return flat(self.world.observe(state, self.params), self.params)


class FreshReset(base.Wrapper):
    """Replaces an ended episode by a new one in the same step; ``info["final_obs"]`` is its true last observation.

    It replaces brax's AutoResetWrapper, which repeats the first episode of each environment for ever.
    """

    def reset(self, rng: jax.Array) -> State:
        state: State = self.env.reset(rng)
        return state.replace(info={**state.info, "final_obs": state.obs})

    def step(self, state: State, action: jax.Array) -> State:
        steps = jnp.where(state.done, 0.0, state.info["steps"])
        state = self.env.step(
            state.replace(done=jnp.zeros_like(state.done), info={**state.info, "steps": steps}), action
        )
        rng, fresh = jnp.moveaxis(jax.vmap(jax.random.split)(state.info["rng"]), 1, 0)
        fresh = self.env.reset(fresh)

        def choose(new, old):
            return jnp.where(state.done.reshape(-1, *[1] * (old.ndim - 1)), new, old)

        now, seen = jax.tree.map(choose, (fresh.pipeline_state, fresh.obs), (state.pipeline_state, state.obs))
        return state.replace(pipeline_state=now, obs=seen, info={**state.info, "rng": rng, "final_obs": state.obs})


def wrap(
    env: base.Env, episode_length: int, action_repeat: int = 1, randomization_fn: Callable | None = None
) -> FreshReset:
    """The ``wrap_env_fn`` for brax's learners: batches, ends in time, resets afresh. ValueError: a randomization_fn."""
    if randomization_fn is not None:
        raise ValueError("randomization_fn is given: jaxnav has no brax system to randomise, leave it out")
    return FreshReset(training.EpisodeWrapper(training.VmapWrapper(env), episode_length, action_repeat))
