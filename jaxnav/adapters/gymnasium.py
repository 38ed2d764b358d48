"""The world as a `gymnasium.vector.VectorEnv`: jax inside, numpy outside."""

# gymnasium may be missing here, and annotates less than it takes.
# pyright: reportMissingImports=none, reportArgumentType=none

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

try:
    from gymnasium import error, spaces
    from gymnasium.vector import AutoresetMode, VectorEnv
    from gymnasium.vector.utils import batch_space
except ImportError as missing:
    raise ImportError('jaxnav.adapters.gymnasium needs gymnasium: pip install "gymnasium>=1.1"') from missing

from ..world import Action, Params, World, check_params
from ..world.types import REQUESTS
from .observation import IN_UNIT, parts, shapes


class VectorWorld(VectorEnv):
    """``num_envs`` (N) episodes of ``world`` side by side; the same seed gives the same episodes.

    By default the world is ``World()``, with the params of its scenes.

    Observations are dicts of `jaxnav.adapters.observation.parts`, actions dicts of twist `[N, 2]` in [-1, 1] and
    request `[N]`, an index into ``REQUESTS``. An ended episode is replaced in the same step; its true last observation
    is then in ``infos["final_obs"]`` and its events (arrived, collided, hit_pedestrian) in ``infos["final_info"]``.
    Steps without an end have no infos. ValueError: params out of range, or no environment.
    """

    metadata = {"render_modes": [], "autoreset_mode": AutoresetMode.SAME_STEP}  # noqa: RUF012

    def __init__(self, num_envs: int = 1, world: World | None = None, params: Params | None = None) -> None:
        if not isinstance(num_envs, int) or num_envs < 1:
            raise ValueError(f"num_envs is {num_envs!r}: give a whole number of at least 1")
        world = World() if world is None else world
        params = world.default_params if params is None else params
        check_params(params, world.config)
        self.num_envs, self.params, self._states = num_envs, params, None
        unbounded = -np.inf, np.inf
        boxes = {
            name: spaces.Box(*((0.0, 1.0) if name in IN_UNIT else unbounded), shape, np.float32)
            for name, shape in shapes(world).items()
        }
        twist = spaces.Box(-1.0, 1.0, (2,), np.float32)
        self.single_observation_space = spaces.Dict(boxes)
        self.single_action_space = spaces.Dict({"twist": twist, "request": spaces.Discrete(len(REQUESTS))})
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)

        def keys(seed):
            return jax.random.split(jax.random.key(seed), num_envs)

        def observe(states):
            return jax.vmap(lambda state: parts(world.observe(state, params), params))(states)

        @jax.jit
        def begin(seed):
            states = jax.vmap(lambda key: world.reset(key, params))(keys(seed))
            return states, observe(states)

        @jax.jit
        def advance(seed, states, action):
            states, outcome = jax.vmap(world.step, in_axes=(0, 0, 0, None))(keys(seed), states, action, params)
            return states, observe(states), outcome

        @jax.jit
        def replace(seed, ended, states_and_observations):
            def choose(fresh, old):
                return jnp.where(ended.reshape(num_envs, *[1] * (old.ndim - 1)), fresh, old)

            return jax.tree.map(choose, begin(seed), states_and_observations)

        self._begin, self._advance, self._replace = begin, advance, replace

    def reset(self, *, seed: Any = None, options: dict[str, Any] | None = None) -> tuple[dict[str, np.ndarray], dict]:
        super().reset(seed=seed)
        self._states, observations = self._begin(self._seed())
        return _numpy(observations), {}

    def step(self, actions: Any) -> Any:
        if self._states is None:
            raise error.ResetNeeded("call reset before step")
        action = Action(twist=actions["twist"], request=actions["request"])
        self._states, observations, outcome = self._advance(self._seed(), self._states, action)
        outcome, infos = _numpy(outcome), {}
        ended = outcome.terminated | outcome.truncated
        if ended.any():
            last = _numpy(observations)
            self._states, observations = self._replace(self._seed(), ended, (self._states, observations))
            for i in np.flatnonzero(ended):
                final_info = {
                    name: bool(getattr(outcome, name)[i]) for name in ("arrived", "collided", "hit_pedestrian")
                }
                final_obs = {name: part[i] for name, part in last.items()}
                infos = self._add_info(infos, {"final_obs": final_obs, "final_info": final_info}, i)
        return _numpy(observations), outcome.reward, outcome.terminated, outcome.truncated, infos

    def _seed(self) -> Any:
        return self.np_random.integers(2**32, dtype=np.uint32)


def _numpy(tree: Any) -> Any:
    """Writable copies."""
    return jax.tree.map(np.array, tree)
