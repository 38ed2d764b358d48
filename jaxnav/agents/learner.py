"""What all learners share: sizes, what an update learns from, and the step of an optimiser.

A learner is a bundle of pure functions of explicit state, with a static ``config`` (a `ReplayConfig` where it learns
from replay), ``horizon``: how many steps of all episodes are played between two calls of its update, and ``replays``:
whether it learns from replay or from these steps.

init(key, observation, hyper) -> state
act(key, state, observation, hyper) -> `Action`, to learn from
policy(state) -> parameters of what is evaluated
best_action(parameters, observation, voice, spoken) -> `Action`
spoken(split) -> the `Vocabulary` that it is spoken to with, None if it hears codes
update(key, state, batch, hyper, lr_scale, step) -> (state, metrics)

Hybrid SAC alone has `answer`, told what was meant, and `understand`, which `jaxnav talk` and `jaxnav understand` use.
"""

import dataclasses

import chex
import jax
import jax.numpy as jnp
import optax
from flax import struct

from ..world import Action, Snapshot
from ..world.types import NONE
from .encoders import ENCODERS


@dataclasses.dataclass(frozen=True)
class LearnerConfig:
    """Sizes of the networks: static under ``jit``.

    Attributes:
        encoder: how observations become features: lidar, lidar-approach (which is told when and how near each
            pedestrian comes), grid (the paper's CNN) or grid-frozen (its weights random).
        actor_widths: hidden layers of the actor.
        critic_widths: hidden layers of each critic, or of the value network.
    """

    encoder: str = "lidar"
    actor_widths: tuple[int, ...] = (128, 128)
    critic_widths: tuple[int, ...] = (128, 128)

    def __post_init__(self):
        if self.encoder not in ENCODERS:
            raise ValueError(f"agent.encoder {self.encoder!r} is unknown: choose from {', '.join(ENCODERS)}")
        for name in ("actor_widths", "critic_widths"):
            widths = getattr(self, name)
            if not widths or any(width < 1 for width in widths):
                raise ValueError(f"agent.{name} is {widths!r}: give at least one width, each at least 1")

    def _check_whole(self, *names):
        for name in names:
            value = getattr(self, name)
            if not isinstance(value, int) or value < 1:
                raise ValueError(f"agent.{name} is {value!r}: give a whole number of at least 1")


@dataclasses.dataclass(frozen=True)
class ReplayConfig(LearnerConfig):
    """Sizes of a learner that samples from replay.

    Attributes:
        batch: transitions an update.
        updates_per_step: updates after each step of all episodes.
        n_step: rewards that are summed before the critics are asked.
        huber_delta: error at which the critic loss turns linear.
        actor_every: updates of the critics for one of the actor.
    """

    batch: int = 512
    updates_per_step: int = 4
    n_step: int = 3
    huber_delta: float = 2.0
    actor_every: int = 1

    def __post_init__(self):
        super().__post_init__()
        self._check_whole("batch", "updates_per_step", "n_step", "actor_every")
        if not self.huber_delta > 0:
            raise ValueError(f"agent.huber_delta is {self.huber_delta!r}: give a number above 0")

    def updates(self, steps):
        """How many updates ``steps`` steps of all episodes make."""
        return steps * self.updates_per_step


@struct.dataclass
class Transition:
    """snapshot, next_snapshot: before and after, the true last state of an episode included; twist `[2]`; request;
    reward; terminated: True ends the return, a time-out does not; ended: either of the two."""

    snapshot: Snapshot
    next_snapshot: Snapshot
    twist: jax.Array
    request: jax.Array
    reward: jax.Array
    terminated: jax.Array
    ended: jax.Array


@struct.dataclass
class Batch:
    """What an update learns from, `[batch, ...]`: transitions with their snapshots rendered.

    Learners that use replay read: observation; next_observation, ``steps`` later; twist `[2]`, of its first step; request;
    reward, the discounted sum over these steps; terminated. Those that do not have `[horizon, episodes, ...]` instead,
    steps of 1, and also read ended.
    """

    observation: chex.ArrayTree
    next_observation: chex.ArrayTree
    twist: jax.Array
    request: jax.Array
    reward: jax.Array
    terminated: jax.Array
    ended: jax.Array
    steps: jax.Array


# All parameters as one vector: less to trace and compile than a dozen operations for each of many leaves.
ADAM = optax.flatten(optax.scale_by_adam())


def descend(params, change, lr):
    """Parameters after a step of that learning rate, a traced number, against ``change``."""
    return jax.tree.map(lambda leaf, slope: leaf - lr * slope, params, change)


def silent(twist):
    """The action of a learner that steers with twist `[..., 2]` and can't speak."""
    return Action(twist=twist, request=jnp.full(twist.shape[:-1], NONE, jnp.int32))
