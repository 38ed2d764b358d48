"""Evaluation: the seven metrics with Wilson intervals, beside the straight-line robot and the muted policy.

docs/world.md section 9. The first episode of each environment only, most probable request and mean twist.
"""

import math
import time

import jax
import jax.numpy as jnp
import numpy as np

from ..agents.scripted import straight_line
from ..world.types import REQUESTS
from .rollout import EpisodeSummary, play

BLOCK = 500  # episodes of each scene that are played at once: one compiled program whatever the number asked for

_EVALUATION = 0x4556414C  # what sets the keys of evaluation apart from those of training


def wilson_interval(successes, trials, z=1.959964):
    """95 % confidence interval of a proportion (Wilson 1927)."""
    if trials == 0:
        return [0.0, 1.0]
    p, z2 = successes / trials, z * z
    centre = (p + z2 / (2 * trials)) / (1 + z2 / trials)
    half = z / (1 + z2 / trials) * math.sqrt(p * (1 - p) / trials + z2 / (4 * trials * trials))
    # At both ends the interval closes there exactly, without an error of rounding.
    return [0.0 if successes == 0 else centre - half, 1.0 if successes == trials else centre + half]


def make_policy(agent):
    """A `Policy` whose parameters are (actor parameters, voice, spoken): without voice every request is none; spoken: the
    `Vocabulary` that people use, None for an agent that hears codes."""

    def policy(policy_params, state, world, params):
        actor, voice, spoken = policy_params
        return agent.best_action(actor, world.observe(state, params), voice, spoken)

    return policy


def episode_keys(seed, indices):
    """Keys of the evaluation episodes with these indices; no key of training, whatever the seeds."""
    base = jax.random.fold_in(jax.random.key(seed), _EVALUATION)
    return jax.vmap(lambda i: jax.random.fold_in(base, i))(indices)


class Evaluator:
    """Plays the policy, its muted twin and the straight line through one compiled program."""

    def __init__(self, world, agent, params):
        self.world, self.params, self.agent = world, params, agent
        scenes = jnp.repeat(jnp.arange(len(world.scenes)), BLOCK)
        limit = math.ceil(float(params.max_steps))
        policy = make_policy(agent)

        def either(policy_params, state, world, params):
            actor, voice, spoken, straight = policy_params
            learnt = policy((actor, voice, spoken), state, world, params)
            ruled = straight_line(None, state, world, params)
            return jax.tree.map(lambda a, b: jnp.where(straight, a, b), ruled, learnt)

        def block(actor, voice, spoken, straight, seed, first):
            # The same keys in every scene and for every robot: differences between robots are not luck.
            keys = jnp.tile(episode_keys(seed, first + jnp.arange(BLOCK)), len(world.scenes))
            summary = play(world, params, either, (actor, voice, spoken, straight), keys, scenes, limit)
            return jax.tree.map(lambda leaf: leaf.reshape(len(world.scenes), BLOCK), summary)

        self._block = jax.jit(block)

    def summaries(self, actor, episodes, seed, voice=True, straight=False, phrases="test") -> EpisodeSummary:
        """Numpy summaries `[scenes, episodes]`; the first n of more episodes are the same n.

        phrases: the split from which people speak.
        """
        spoken = self.agent.vocabulary(phrases)
        blocks = [
            jax.device_get(self._block(actor, voice, spoken, straight, np.uint32(seed), first))
            for first in range(0, episodes, BLOCK)
        ]
        return EpisodeSummary(*(np.concatenate(leaves, axis=1)[:, :episodes] for leaves in zip(*blocks, strict=True)))

    def success(self, actor, seed):
        """Success in each scene over `BLOCK` episodes, with validation phrases: what training logs."""
        arrived = self.summaries(actor, BLOCK, seed, phrases="validation").arrived
        return {scene.name: float(rate) for scene, rate in zip(self.world.scenes, arrived.mean(axis=1), strict=True)}

    def evaluate(self, actor, policy_name, episodes, seed, phrases="test"):
        """The contents of evaluation.json; ``complied`` is a share of the requests that got a reply."""
        start = time.monotonic()
        played = self.summaries(actor, episodes, seed, phrases=phrases)
        muted = self.summaries(actor, episodes, seed, voice=False, phrases=phrases)
        straight = self.summaries(actor, episodes, seed, straight=True, phrases=phrases)
        scenes = {
            scene.name: _scene_metrics(*(EpisodeSummary(*(leaf[i] for leaf in s)) for s in (played, muted, straight)))
            for i, scene in enumerate(self.world.scenes)
        }
        return {
            "policy": policy_name,
            "episodes": episodes,
            "seed": seed,
            "wall_seconds": round(time.monotonic() - start, 3),
            "scenes": scenes,
        }


def _scene_metrics(played, muted, straight):
    episodes = played.arrived.size
    return {
        "success": float(played.arrived.mean()),
        "success_ci95": wilson_interval(int(played.arrived.sum()), episodes),
        "collision": float(played.collided.mean()),
        "human_collision": float(played.hit_pedestrian.mean()),
        "timeout": float(played.truncated.mean()),
        "steps": _mean(played.steps[played.arrived]),
        "min_distance": _mean(played.min_distance[played.arrived]),
        "comfort": float(played.comfortable_steps.sum() / played.steps.sum()),
        "straight_line_success": float(straight.arrived.mean()),
        "muted_success": float(muted.arrived.mean()),
        "muted_min_distance": _mean(muted.min_distance[muted.arrived]),
        "requests": {name: float((played.request == request).mean()) for request, name in enumerate(REQUESTS)},
        "complied": _mean(played.agreed[played.replied]),
    }


def _mean(values):
    """Mean as a float, None of nothing."""
    return float(np.mean(values)) if values.size else None
