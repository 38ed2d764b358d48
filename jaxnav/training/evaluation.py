"""Evaluation: the metrics of docs/world.md section 9, beside the straight-line robot and the muted policy.

The first episode of each environment only, most probable request and mean twist.
"""

import functools
import math
import time
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ..agents.scripted import StraightLine
from ..statistics import mean_or_none, wilson_interval
from ..world import Params, World
from ..world.types import REQUESTS
from .policy import Policy
from .rollout import Either, Episode, EpisodeSummary, Player, play, record

BLOCK = 500  # episodes of each scene that are played at once: one compiled program whatever the number asked for

# The seed of evaluations during training; those that count use the seed of the run or of the command.
VALIDATION_SEED = 2**31

_EVALUATION = 0x4556414C  # what sets the keys of evaluation apart from those of training


def episode_keys(seed: Any, indices: Any) -> jax.Array:
    """Keys `[E]` of the evaluation episodes with these indices `[E]`; no key of training, whatever the seeds."""
    base = jax.random.fold_in(jax.random.key(seed), _EVALUATION)
    return jax.vmap(lambda i: jax.random.fold_in(base, i))(jnp.asarray(indices))


def play_block(
    world: World, params: Params, player: Player, seed: Any, first: Any, count: int, scenes: Any = None,
    limit: int | None = None,
) -> EpisodeSummary:  # fmt: skip
    """Play the ``count`` evaluation episodes from index ``first`` on in each scene: leaves `[scenes, count]`.

    scenes: indices `[scenes]`, None for all of the world. The keys are the same in every scene and for every player:
    differences between players are not luck. limit: steps to run, ``params.max_steps`` if not given.
    """
    scenes = jnp.arange(len(world.scenes)) if scenes is None else scenes
    keys = jnp.tile(episode_keys(seed, first + jnp.arange(count)), scenes.size)
    limit = math.ceil(float(np.max(params.max_steps))) if limit is None else limit
    summary = play(world, params, player, keys, jnp.repeat(scenes, count), limit)
    return jax.tree.map(lambda leaf: leaf.reshape(scenes.size, count), summary)


def metrics(played: EpisodeSummary) -> dict[str, Any]:
    """Metrics of the episodes `[episodes]` of one scene, under the keys of evaluation.json.

    success, collision, human_collision, timeout: shares of the episodes.
    success_ci95:        Wilson's interval of success, [low, high].
    steps, min_distance: means over the episodes that arrived (m), None if none did; of distances where somebody was.
    comfort:             share of all steps with every pedestrian beyond ``params.comfort_distance``.
    requests:            share of episodes by their first request.
    complied:            share of a yes among requests that got a reply, None if none did.
    """
    arrived = played.arrived
    return {
        "success": float(arrived.mean()),
        "success_ci95": wilson_interval(int(arrived.sum()), arrived.size),
        "collision": float(played.collided.mean()),
        "human_collision": float(played.hit_pedestrian.mean()),
        "timeout": float(played.truncated.mean()),
        "steps": mean_or_none(played.steps[arrived]),
        "min_distance": mean_or_none(played.min_distance[arrived & np.isfinite(played.min_distance)]),
        "comfort": float(played.comfortable_steps.sum() / played.steps.sum()),
        "requests": {name: float((played.request == request).mean()) for request, name in enumerate(REQUESTS)},
        "complied": mean_or_none(played.agreed[played.replied]),
    }


def scene_metrics(world: World, played: EpisodeSummary) -> dict[str, dict[str, Any]]:
    """`metrics` by the names of a world's scenes. played: `[scenes, episodes]`."""
    return {scene.name: metrics(_row(played, i)) for i, scene in enumerate(world.scenes)}


class Evaluator:
    """Plays any player, and in the same compiled program the straight-line robot, in the scenes of a world.

    block: episodes of each scene that are played at once, `BLOCK` if not given.
    members: whether players are policies of a population, with parameters `[members, ...]`; summaries are then
        `[members, scenes, episodes]`.
    """

    def __init__(self, world: World, params: Params, block: int | None = None, members: bool = False):
        self.world, self.params, self.block, self.members = world, params, block or BLOCK, members
        self._program = jax.jit(self._play)
        self._compiled: Any = None

    def _play(self, player, straight, seed, first, scenes):
        def one(player):
            both = Either(straight, StraightLine(), player)
            return play_block(self.world, self.params, both, seed, first, self.block, scenes)

        if not self.members:
            return one(player)
        return jax.vmap(one, in_axes=(player.replace(parameters=0, voice=None, vocabulary=None),))(player)

    def compile(self, player: Any) -> None:
        """Compile the program for players of these shapes, unless that is done: it then serves all scenes alone."""
        if self._compiled is None:
            self._compiled = self._program.lower(player, False, np.uint32(0), 0, None).compile()

    @property
    def bytes_needed(self) -> int:
        """Bytes of the device's memory that the compiled program needs; call `compile` first."""
        found = self._compiled.memory_analysis()
        return found.output_size_in_bytes + found.temp_size_in_bytes

    def summaries(
        self, player: Any, episodes: int, seed: int, straight: bool = False, scenes: Any = None
    ) -> EpisodeSummary:
        """Numpy summaries `[scenes, episodes]`; the first n of more episodes are the same n.

        straight: play the straight-line robot instead of the player; scenes: indices, None for all.
        """
        program = self._compiled or self._program
        where = None if scenes is None else jnp.asarray(scenes, jnp.int32)
        blocks = [
            jax.device_get(program(player, straight, np.uint32(seed), first, where))
            for first in range(0, episodes, self.block)
        ]
        return EpisodeSummary(
            *(np.concatenate(leaves, axis=-1)[..., :episodes] for leaves in zip(*blocks, strict=True))
        )

    def record(self, player: Any, seed: int, scenes: Any, episodes: Any) -> list[Episode]:
        """Whole evaluation episodes: those with indices ``episodes`` `[E]`, in the scenes ``scenes`` `[E]`."""
        limit = math.ceil(float(np.max(self.params.max_steps)))
        keys = episode_keys(seed, jnp.asarray(episodes))
        return record(self.world, self.params, player, keys, jnp.asarray(scenes), limit)

    def success(self, policy: Policy, seed: int) -> dict[str, float]:
        """Success in each scene over one block, with validation phrases: what training logs."""
        arrived = self.summaries(policy.hearing("validation"), self.block, seed).arrived
        return {scene.name: float(rate) for scene, rate in zip(self.world.scenes, arrived.mean(axis=1), strict=True)}

    def evaluate(
        self, policy: Policy, policy_name: str, episodes: int, seed: int, phrases: str = "test"
    ) -> dict[str, Any]:
        """The contents of evaluation.json: `metrics` of each scene, beside the straight line and the muted policy."""
        start, policy = time.monotonic(), policy.hearing(phrases)
        played = self.summaries(policy, episodes, seed)
        muted = self.summaries(policy.muted(), episodes, seed)
        straight = self.summaries(policy, episodes, seed, straight=True)
        scenes = scene_metrics(self.world, played)
        for i, found in enumerate(scenes.values()):
            found["straight_line_success"] = float(straight.arrived[i].mean())
            found["muted_success"] = float(muted.arrived[i].mean())
            found["muted_min_distance"] = metrics(_row(muted, i))["min_distance"]
        return {
            "policy": policy_name,
            "episodes": episodes,
            "seed": seed,
            "wall_seconds": round(time.monotonic() - start, 3),
            "scenes": scenes,
        }


@functools.lru_cache(maxsize=8)
def _kept(world: World, params: Any, block: int) -> Evaluator:
    return Evaluator(world, params, block)


def evaluator_of(world: World, params: Params) -> Evaluator:
    """An `Evaluator` for a world; what it has compiled serves the next call with the same world and params."""
    try:
        found: Any = params  # of Python floats hashable
        return _kept(world, found, BLOCK)
    except TypeError:  # params that are arrays can't be looked up
        return Evaluator(world, params)


def _row(summary: EpisodeSummary, i: int) -> EpisodeSummary:
    return EpisodeSummary(*(leaf[i] for leaf in summary))
