"""Episodes played with a policy: the first one of each environment, for evaluation and for pictures."""

import dataclasses
import functools
from collections.abc import Callable
from typing import NamedTuple

import chex
import jax
import jax.numpy as jnp
import numpy as np

from ..world import Outcome, State
from ..world.types import AGREES, NONE

# A policy is a function (policy parameters, State, World, Params) -> Action of one episode.
Policy = Callable


@dataclasses.dataclass(frozen=True)
class Episode:
    """One recorded episode of n steps, as numpy arrays: states has leaves `[n + 1, ...]`, outcomes `[n, ...]`.

    speech: for each state the lines (speaker, sentence) to show with it, where somebody spoke in words of their own.
    """

    scene: str
    states: State
    outcomes: Outcome
    speech: list | None = None

    @property
    def present(self):
        """Indices of the pedestrians who are there."""
        return np.flatnonzero(self.states.pedestrians.present[0])


class EpisodeSummary(NamedTuple):
    """What an episode came to; leaves `[episodes]`."""

    arrived: chex.Array
    collided: chex.Array
    hit_pedestrian: chex.Array
    truncated: chex.Array
    steps: chex.Array
    min_distance: chex.Array
    comfortable_steps: chex.Array
    request: chex.Array  # the first request that counted
    replied: chex.Array
    agreed: chex.Array


def play(world, params, policy, policy_params, keys, scenes, limit):
    """Play one episode for each key and scene index `[E]` and return its `EpisodeSummary` `[E]`.

    limit: the number of steps to run, at least ``params.max_steps``.
    """

    def one(key, scene):
        key_reset, key_steps = jax.random.split(key)
        state = world.reset(key_reset, params, scene)
        no, zero = jnp.bool_(False), jnp.int32(0)
        start = EpisodeSummary(no, no, no, no, zero, state.min_distance, zero, zero, no, no)

        def step(carry, key):
            state, summary, done = carry
            action = policy(policy_params, state, world, params)
            state, outcome = world.step(key, state, action, params)
            now = EpisodeSummary(
                arrived=outcome.arrived,
                collided=outcome.collided,
                hit_pedestrian=outcome.hit_pedestrian,
                truncated=outcome.truncated,
                steps=state.t,
                min_distance=state.min_distance,
                comfortable_steps=summary.comfortable_steps + (outcome.pedestrian_distance >= params.comfort_distance),
                request=jnp.where(summary.request == NONE, outcome.requested, summary.request),
                replied=summary.replied | (outcome.reply != NONE),
                agreed=summary.agreed | (outcome.reply == AGREES),
            )
            summary = jax.tree.map(lambda new, old: jnp.where(done, old, new), now, summary)
            return (state, summary, done | outcome.terminated | outcome.truncated), None

        (_, summary, _), _ = jax.lax.scan(step, (state, start, no), jax.random.split(key_steps, limit))
        return summary

    return jax.vmap(one)(keys, scenes)


def record(world, params, policy, policy_params, keys, scenes, limit):
    """Play like `play` and keep everything: a list of `Episode`."""
    states, outcomes = jax.device_get(_record(world, params, policy, policy_params, keys, scenes, limit))
    episodes = []
    for i, scene in enumerate(np.asarray(scenes)):
        ended = outcomes.terminated[i] | outcomes.truncated[i]
        n = int(np.argmax(ended)) + 1 if ended.any() else limit
        episodes.append(
            Episode(
                scene=world.config.scenes[int(scene)],
                states=jax.tree.map(lambda leaf, i=i, n=n: leaf[i, : n + 1], states),
                outcomes=jax.tree.map(lambda leaf, i=i, n=n: leaf[i, :n], outcomes),
            )
        )
    return episodes


@functools.partial(jax.jit, static_argnames=("world", "policy", "limit"))
def _record(world, params, policy, policy_params, keys, scenes, limit):
    """States `[E, limit + 1]` and outcomes `[E, limit]`, those after an episode's end included."""

    def one(key, scene):
        key_reset, key_steps = jax.random.split(key)
        state = world.reset(key_reset, params, scene)

        def step(state, key):
            action = policy(policy_params, state, world, params)
            state, outcome = world.step(key, state, action, params)
            return state, (state, outcome)

        _, (states, outcomes) = jax.lax.scan(step, state, jax.random.split(key_steps, limit))
        return jax.tree.map(lambda first, rest: jnp.concatenate([first[None], rest]), state, states), outcomes

    return jax.vmap(one)(keys, scenes)
