"""Worlds driven from outside, by what a bundle exports: its policy in PyTorch, or its `Navigator` with all that it has
to work out for itself - scans resampled, pose history, dialogues, words."""

import collections
import dataclasses
import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxnav import Action
from jaxnav.agents.networks import message_words
from jaxnav.export.contract import RAW_PARTS
from jaxnav.language.table import default_table
from jaxnav.training import episode_keys
from jaxnav.world.types import REPLIES


class Ends(NamedTuple):
    """The ends of episodes, `[episodes]` each."""

    arrived: np.ndarray
    collided: np.ndarray
    hit_pedestrian: np.ndarray
    steps: np.ndarray

    @property
    def hit_wall(self):
        return self.collided & ~self.hit_pedestrian


class Worlds:
    """The evaluation episodes with indices 0, 1, ... of a seed in every scene of a run, all of them at once."""

    def __init__(self, run, seed, episodes):
        self.run, self.params = run, run.params
        scenes = jnp.repeat(jnp.arange(len(run.world.scenes)), episodes)
        keys = jnp.tile(episode_keys(seed, jnp.arange(episodes)), len(run.world.scenes))
        key_reset, key_steps = jnp.moveaxis(jax.vmap(jax.random.split)(keys), 1, 0)
        self.limit = math.ceil(float(run.params.max_steps))
        # As in `jaxnav.training.rollout.play`: the same episodes.
        self._keys = jnp.moveaxis(jax.vmap(lambda key: jax.random.split(key, self.limit))(key_steps), 1, 0)
        world = run.world.with_config(dataclasses.replace(run.world.config, observation=RAW_PARTS))
        self.state = jax.jit(jax.vmap(run.world.reset, in_axes=(0, None, 0)))(key_reset, run.params, scenes)
        self._vocabulary = run.agent.vocabulary("test")

        def look(state, vocabulary):
            seen = jax.vmap(world.observe, in_axes=(0, None))(state, run.params)
            return seen, () if vocabulary is None else message_words(seen.dialogue, vocabulary)

        self._look = jax.jit(look)
        self._step = jax.jit(jax.vmap(run.world.step, in_axes=(0, 0, 0, None)))
        self.count = len(scenes)

    def observe(self):
        """(observations without maps, words that are heard), numpy."""
        return jax.device_get(self._look(self.state, self._vocabulary))

    def play(self, drive):
        """`Ends` of the episodes. drive: a function (step, who still drives `[n]`) -> v, w and request, `[n]` each."""
        ended, steps = np.zeros(self.count, bool), np.zeros(self.count, int)
        ends = {name: np.zeros(self.count, bool) for name in ("arrived", "collided", "hit_pedestrian")}
        for step in range(self.limit):
            v, w, request = drive(step, ~ended)
            twist = np.stack([2 * v / float(self.params.max_v) - 1, w / float(self.params.max_w)], axis=-1)
            action = Action(twist=jnp.asarray(twist, jnp.float32), request=jnp.asarray(request, jnp.int32))
            self.state, outcome = self._step(self._keys[step], self.state, action, self.params)
            outcome = jax.device_get(outcome)
            steps += ~ended
            for name, found in ends.items():
                found |= ~ended & getattr(outcome, name)
            ended |= outcome.terminated | outcome.truncated
            if ended.all():
                break
        return Ends(**ends, steps=steps)


def by_policy(worlds, policy, inputs):
    """`Ends` of worlds driven by an exported `Policy`. inputs: a function (state) -> its inputs `[n, ...]` by name."""
    import torch

    def drive(step, drives):
        with torch.no_grad():
            v, w, request, *_ = policy.actor(*policy.tensors(inputs(worlds.state)))
        return v.numpy(), w.numpy(), request.numpy()

    return worlds.play(drive)


def by_navigators(worlds, make, scan_of, act=None):
    """(`Ends`, share of commands that the safety layer changed) of worlds, each driven by a `Navigator` of its own.

    make: a function () -> navigator; scan_of: a function (ranges) -> scan; act: replaces what its policy decides.
    """
    navigators = [make() for _ in range(worlds.count)]
    robot = jax.device_get(worlds.state.robot)
    for navigator, *goal in zip(navigators, robot.goal_x, robot.goal_y, strict=True):
        navigator.reset(goal)
        if act is not None:
            navigator.policy.act = act
    voices = [_Voices(worlds.run, np.random.default_rng(i)) for i in range(worlds.count)]

    def drive(step, drives):
        (seen, words), state = worlds.observe(), jax.device_get(worlds.state)
        commands = np.zeros((worlds.count, 3))
        for i in np.flatnonzero(drives):
            robot = state.robot
            message = voices[i].next(jax.tree.map(lambda leaf, i=i: leaf[i], (state.encounters, seen.dialogue, words)))
            v, w, request, _ = navigators[i].step(
                scan_of(seen.scan[i]), seen.pedestrians[i][seen.seen[i]], (robot.x[i], robot.y[i], robot.heading[i]),
                message, now=step * float(worlds.params.dt),
            )  # fmt: skip
            commands[i] = v, w, request
        return commands.T

    ends = worlds.play(drive)
    return ends, sum(n.interventions for n in navigators) / max(sum(n.steps for n in navigators), 1)


def adversary(policy, run):
    """A decision for every observation: full speed, turning toward the nearest obstacle."""
    angles = np.linspace(-np.pi / 2, np.pi / 2, run.world.config.beams)
    turn, fast = float(run.params.max_w), float(run.params.max_v)

    def act(observation):
        toward = angles[np.argmin(observation["scan"])] / float(run.params.dt)
        return policy.Decision(fast, float(np.clip(toward, -turn, turn)), 0, None, None, None)

    return act


def laser(scans, run):
    """A function (ranges) -> the scan that a laser driver reports: nothing comes back from where nothing is."""
    longest, beams = float(run.params.scan_range), run.world.config.beams

    def report(ranges):
        return scans.Scan(np.where(ranges >= longest, np.inf, ranges), -np.pi / 2, np.pi / (beams - 1))

    return report


class _Voices:
    """The people of one world as a `Navigator` hears them: every message and answer once, when it is given."""

    def __init__(self, run, rng):
        self._phrases, self._rng = run.agent.can_hear, rng
        self._queue, self._replies = collections.deque(), 0

    def next(self, heard):
        """The message that is heard now, None for none. heard: (encounters, observed dialogues, words) of the world."""
        encounters, dialogue, words = heard
        for k in np.flatnonzero((dialogue.message != 0) & (dialogue.message_age == 0)):
            self._queue.append(words[k] if self._phrases else MESSAGE_NAMES[dialogue.message[k]])
        for reply in encounters.reply[(encounters.reply != 0) & (self._replies == 0)]:
            self._queue.append(self._answer(reply) if self._phrases else REPLIES[reply])
        self._replies = encounters.reply
        if self._queue:
            return self._queue.popleft()
        chats = np.flatnonzero((dialogue.message == 0) & (dialogue.utterance != 0))
        return words[chats[0]] if self._phrases and len(chats) else None

    def _answer(self, reply):
        table = default_table()
        rows = [i for i, p in enumerate(table.phrases) if p.split == "test" and p.reply == reply and p.message == 0]
        return table.vectors(np.array([self._rng.choice(rows)]))[0]


MESSAGE_NAMES = ("silence", "robot stop", "robot right", "robot left")
