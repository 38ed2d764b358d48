"""Episodes played by a player: the first one of each environment, for evaluation and for pictures."""

import dataclasses
import functools
from typing import Any, NamedTuple, Protocol

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from ..world import Action, Outcome, Params, State, World
from ..world.types import AGREES, NONE


class Player(Protocol):
    """A driver of the robot, a pytree that is called with a state: a `Policy`, a scripted robot or your own."""

    def __call__(self, state: State, world: World, params: Params) -> Action:
        """The action in one state of one episode."""
        ...


@struct.dataclass
class Either:
    """Two players in one program: the first where ``choose_first``, else the second."""

    choose_first: Any
    first: Any
    second: Any

    def __call__(self, state: State, world: World, params: Params) -> Action:
        first, second = self.first(state, world, params), self.second(state, world, params)
        return jax.tree.map(lambda a, b: jnp.where(self.choose_first, a, b), first, second)


@dataclasses.dataclass(frozen=True)
class Episode:
    """One recorded episode of n steps, as numpy arrays.

    scene:    its name.
    states:   `State` with leaves `[n + 1, ...]`.
    outcomes: `Outcome` with leaves `[n, ...]`.
    speech:   for each state the lines (speaker, sentence) to show with it, where somebody spoke in their own words.
    """

    scene: str
    states: State
    outcomes: Outcome
    speech: list | None = None

    @property
    def present(self) -> np.ndarray:
        """Indices of the pedestrians who are there, or come later."""
        return np.flatnonzero(self.states.pedestrians.present.any(axis=0))

    def since(self, t: int, i: int) -> int | None:
        """Since which state pedestrian ``i`` has been there without a break at state ``t``; None where it isn't."""
        there = self.states.pedestrians.present[: t + 1, i]
        return int(len(there) - np.argmin(there[::-1])) % len(there) if there[-1] else None


class EpisodeSummary(NamedTuple):
    """The results of episodes; leaves `[episodes]`.

    arrived, collided, hit_pedestrian, truncated: how it ended, bool; a collision may be with a pedestrian.
    steps:             until it ended.
    min_distance:      smallest distance to a pedestrian's surface, m.
    comfortable_steps: steps with every pedestrian beyond ``params.comfort_distance``.
    request:           the first request that counted, 0 of none.
    replied, agreed:   whether a request got a reply, and a yes.
    """

    arrived: Any
    collided: Any
    hit_pedestrian: Any
    truncated: Any
    steps: Any
    min_distance: Any
    comfortable_steps: Any
    request: Any
    replied: Any
    agreed: Any


def play(
    world: World, params: Params, player: Player, keys: jax.Array, scenes: jax.Array, limit: int
) -> EpisodeSummary:
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
            action = player(state, world, params)
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


def record(
    world: World, params: Params, player: Player, keys: jax.Array, scenes: jax.Array, limit: int
) -> list[Episode]:
    """Play like `play` and keep everything."""
    states, outcomes = jax.device_get(_record(world, params, player, keys, scenes, limit))
    episodes = []
    for i, scene in enumerate(np.asarray(scenes)):
        ended = outcomes.terminated[i] | outcomes.truncated[i]
        n = int(np.argmax(ended)) + 1 if ended.any() else limit
        episodes.append(
            Episode(
                scene=world.scenes[int(scene)].name,
                states=jax.tree.map(lambda leaf, i=i, n=n: leaf[i, : n + 1], states),
                outcomes=jax.tree.map(lambda leaf, i=i, n=n: leaf[i, :n], outcomes),
            )
        )
    return episodes


@functools.partial(jax.jit, static_argnames=("world", "limit"))
def _record(world, params, player, keys, scenes, limit):
    """States `[E, limit + 1]` and outcomes `[E, limit]`, those after an episode's end included."""

    def one(key, scene):
        key_reset, key_steps = jax.random.split(key)
        state = world.reset(key_reset, params, scene)

        def step(state, key):
            action = player(state, world, params)
            state, outcome = world.step(key, state, action, params)
            return state, (state, outcome)

        _, (states, outcomes) = jax.lax.scan(step, state, jax.random.split(key_steps, limit))
        return jax.tree.map(lambda first, rest: jnp.concatenate([first[None], rest]), state, states), outcomes

    return jax.vmap(one)(keys, scenes)
