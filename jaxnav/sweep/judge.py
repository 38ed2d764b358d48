"""How good the members of a population are: all of them play the same episodes at once."""

import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ..training.evaluation import episode_keys, make_policy
from ..training.rollout import play

SEARCH_SEED, CONFIRM_SEED = 2**31 + 1, 2**31 + 2  # of the episodes; apart, so that no winner is chosen on its own exam


class PopulationEvaluator:
    """Plays ``episodes`` of each scene of a world with every member's policy, through one compiled program.

    policies: their shapes `[members]`, as of `Population.policy_shapes`.
    """

    def __init__(self, world, params, agent, episodes, policies):
        self._world, self._agent, self._policies = world, agent, policies
        scenes = jnp.repeat(jnp.arange(len(world.scenes)), episodes)
        policy, limit = make_policy(agent), math.ceil(float(params.max_steps))

        def one(actor, spoken, seed):
            # The same episodes in every scene and for every member: differences are not luck.
            keys = jnp.tile(episode_keys(seed, jnp.arange(episodes)), len(world.scenes))
            summary = play(world, params, policy, (actor, True, spoken), keys, scenes, limit)
            return jax.tree.map(lambda leaf: leaf.reshape(len(world.scenes), episodes), summary)

        self._all = jax.jit(jax.vmap(one, in_axes=(0, None, None)))
        self._compiled: Any = None

    def compile(self):
        """Compile the program, unless that is done."""
        if self._compiled is None:
            example = self._policies, self._agent.vocabulary("validation"), np.uint32(0)
            self._compiled = self._all.lower(*example).compile()

    @property
    def bytes_needed(self):
        """Of the device's memory while it plays. Compiles it."""
        self.compile()
        found = self._compiled.memory_analysis()
        return found.output_size_in_bytes + found.temp_size_in_bytes

    def __call__(self, policies, seed, phrases):
        """Of each member its `metrics`. policies: `[members]`; phrases: the split from which people speak."""
        self.compile()
        played = jax.device_get(self._compiled(policies, self._agent.vocabulary(phrases), np.uint32(seed)))
        members = played.arrived.shape[0]
        return [metrics(self._world, jax.tree.map(lambda leaf, i=i: leaf[i], played)) for i in range(members)]


def metrics(world, played):
    """Of each scene, by name: success, collision, human_collision, timeout and comfort, as shares, steps and
    min_distance (m) of the episodes that arrived, None if none did. played: `EpisodeSummary` `[scenes, episodes]`."""
    found = {}
    for i, scene in enumerate(world.scenes):
        arrived = played.arrived[i]
        found[scene.name] = {
            "success": float(arrived.mean()),
            "collision": float(played.collided[i].mean()),
            "human_collision": float(played.hit_pedestrian[i].mean()),
            "timeout": float(played.truncated[i].mean()),
            "comfort": float(played.comfortable_steps[i].sum() / played.steps[i].sum()),
            "steps": float(played.steps[i][arrived].mean()) if arrived.any() else None,
            "min_distance": float(played.min_distance[i][arrived].mean()) if arrived.any() else None,
        }
    return found
