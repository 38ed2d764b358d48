"""Learners: their protocol, the batches that they learn from, and their registry.

A learner is a bundle of pure functions of explicit state. `register_learner` makes one known by a name.
"""

import dataclasses
import inspect
from collections.abc import Callable
from typing import Any, Protocol

import jax
import jax.numpy as jnp
import optax
from flax import struct

from .. import plugins
from ..errors import UserError
from ..language.vocabulary import Vocabulary
from ..world import Action, Observation, Snapshot
from ..world.types import NONE
from .configs import LearnerConfig

Parameters = Any  # a pytree of arrays


@struct.dataclass
class Transition:
    """A step as replay keeps it.

    Attributes:
        snapshot: before the step.
        next_snapshot: after it, the true last state of an episode included.
        twist: `[2]`.
        request: what was asked.
        reward: of the step.
        terminated: ends the return; a time-out does not.
        ended: terminated, or a time-out.
    """

    snapshot: Snapshot
    next_snapshot: Snapshot
    twist: jax.Array
    request: jax.Array
    reward: jax.Array
    terminated: jax.Array
    ended: jax.Array


@struct.dataclass
class Batch:
    """The transitions of an update: `[batch, ...]` from replay, or `[horizon, episodes, ...]` of steps in a row.

    Attributes:
        observation: before the step.
        next_observation: ``steps`` later.
        twist: `[..., 2]` of the first step.
        request: of the first step.
        reward: the discounted sum over these steps.
        terminated: whether the return ends with them; not by a time-out.
        ended: terminated, or a time-out.
        steps: how many rewards are summed; 1 of steps in a row.
    """

    observation: Observation
    next_observation: Observation
    twist: jax.Array
    request: jax.Array
    reward: jax.Array
    terminated: jax.Array
    ended: jax.Array
    steps: jax.Array


class Learner(Protocol):
    """A bundle of pure functions of explicit state, and what others need to know of it.

    Attributes:
        config: its sizes.
        replays: whether it learns from replay (its config is then a `ReplayConfig`) or from the steps just played.
        horizon: steps of all episodes between two updates; 1 with replay.
        requests: how many requests it chooses from; 1: it is silent.
        can_ask: whether it may ask for something.
        can_hear: whether it understands sentences; then it is a `HearingLearner`. Others hear the messages themselves.
    """

    config: Any
    replays: bool
    horizon: int
    requests: int
    can_ask: bool
    can_hear: bool

    def init(self, key: jax.Array, observation: Observation, hyper: Any) -> Any:
        """The state before training, for observations shaped like ``observation`` (one, without a batch axis)."""
        ...

    def act(self, key: jax.Array, state: Any, observation: Observation, hyper: Any) -> Action:
        """An action to learn from, for each observation `[..., ...]`."""
        ...

    def policy(self, state: Any) -> Parameters:
        """The parameters that are evaluated."""
        ...

    def best_action(
        self,
        parameters: Parameters,
        observation: Observation,
        voice: jax.Array | bool = True,
        vocabulary: Vocabulary | None = None,
    ) -> Action:
        """The action of these parameters; without ``voice`` the request is none.

        vocabulary: from which the sentences of pedestrians are drawn; None: the learner's own, or none.
        """
        ...

    def vocabulary(self, split: str) -> Vocabulary | None:
        """The `Vocabulary` of a split of phrases; None if the learner can't hear sentences."""
        ...

    def update(
        self, key: jax.Array, state: Any, batch: Batch, hyper: Any, lr_scale: jax.Array | float = 1.0,
        step: jax.Array | int = 0,
    ) -> tuple[Any, dict[str, jax.Array]]:  # fmt: skip
        """(state, metrics) after learning from a batch.

        lr_scale: multiplies every learning rate; step: how many updates came before. Of the metrics critic_loss,
        actor_loss, q, and the entropies and temperatures that `HSAC` has, are drawn, where there are any.
        """
        ...


class HearingLearner(Learner, Protocol):
    """A learner that understands sentences."""

    def answer(self, parameters: Parameters, observation: Observation, heard: jax.Array) -> Action:
        """The best action of a robot that understands S_c ``heard`` `[K, 3]`, whatever the observation says."""
        ...

    def understand(self, parameters: Parameters, words: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Log-probabilities of message `[..., 4]` and reply `[..., 3]` of words `[..., D]`."""
        ...


class SilentLearner:
    """The part that all learners share that only steer: they hear messages as codes, and ask for nothing."""

    requests, can_ask, can_hear = 1, False, False

    def best_twist(self, parameters: Parameters, observation: Observation) -> jax.Array:
        """The twist `[..., 2]` of these parameters, in [-1, 1]."""
        raise NotImplementedError

    def best_action(
        self,
        parameters: Parameters,
        observation: Observation,
        voice: jax.Array | bool = True,
        vocabulary: Vocabulary | None = None,
    ) -> Action:
        """See `Learner`."""
        del voice, vocabulary
        return silent(self.best_twist(parameters, observation))

    def vocabulary(self, split: str) -> Vocabulary | None:
        """See `Learner`."""
        del split


@dataclasses.dataclass(frozen=True)
class RegisteredLearner:
    """A learner by its name.

    Attributes:
        name: by which ``algo`` chooses it.
        learner: config -> `Learner`.
        config: the dataclass of its sizes, a `LearnerConfig`; its defaults are the learner's.
        hyper: the flax.struct dataclass of its floats, with ``discount`` and ``final_lr`` among them.
    """

    name: str
    learner: Callable[[Any], Learner]
    config: type[LearnerConfig]
    hyper: type

    def make(self, config: LearnerConfig) -> Learner:
        """The learner of these sizes. UserError: it lacks something that every learner has."""
        learner = self.learner(config)
        lacking = [name for name in _ATTRIBUTES if not hasattr(learner, name)]
        if lacking:
            raise UserError(
                f"algo {self.name!r}: the learner has no {', '.join(lacking)}: see Learner in jaxnav.agents"
            )
        _check_methods(self.name, learner, 0)
        return learner


LEARNERS: dict[str, RegisteredLearner] = {}
plugins.recognise("learner", lambda value: isinstance(value, RegisteredLearner))
_ATTRIBUTES = ("config", "replays", "horizon", "requests", "can_ask", "can_hear")
# Methods with the number of arguments that they are called with.
_METHODS = {"init": 3, "act": 4, "policy": 1, "best_action": 4, "vocabulary": 1, "update": 6}


def register_learner(
    name: str, learner: Callable[[Any], Learner], config: type[LearnerConfig], hyper: type
) -> RegisteredLearner:
    """Make a learner known by a name.

    UserError: the name is taken, a method is missing or takes other arguments, ``config`` is no `LearnerConfig`, or
    ``hyper`` lacks ``discount`` or ``final_lr``, which the training loop reads.
    """
    if name in LEARNERS and LEARNERS[name].learner is not learner:
        raise UserError(f"the learner {name!r} is registered already: choose another name")
    LEARNERS[name] = _checked(RegisteredLearner(name, learner, config, hyper))
    return LEARNERS[name]


def find_learner(name: str) -> RegisteredLearner:
    """The learner of that name, registered or file.py:NAME. UserError: there is none, or it can't be used."""
    if plugins.is_file(name):
        return _checked(plugins.load_part(name, "learner"))
    if name not in LEARNERS:
        raise UserError(f"algo {name!r} is unknown: choose from {', '.join(LEARNERS)}, or give file.py:NAME")
    return LEARNERS[name]


def _checked(entry):
    name, config, hyper = entry.name, entry.config, entry.hyper
    if not (isinstance(config, type) and issubclass(config, LearnerConfig)):
        raise UserError(f"the learner {name!r} has the config {config!r}: give a dataclass that extends LearnerConfig")
    fields = {field.name for field in dataclasses.fields(hyper)} if dataclasses.is_dataclass(hyper) else set()
    lacking = sorted({"discount", "final_lr"} - fields)
    if lacking:
        raise UserError(f"the hyperparameters of the learner {name!r} lack {', '.join(lacking)}: add these fields")
    if isinstance(entry.learner, type):
        _check_methods(name, entry.learner, 1)
    return entry


def _check_methods(name, learner, own):
    """UserError: a method is missing, or takes other arguments. own: 1 where ``self`` is one of them."""
    for method, count in _METHODS.items():
        function = getattr(learner, method, None)
        if not callable(function):
            raise UserError(f"the learner {name!r} has no method {method}: see Learner in jaxnav.agents")
        try:
            inspect.signature(function).bind(*(own + count) * [None])
        except TypeError:
            wanted = ", ".join(list(inspect.signature(getattr(Learner, method)).parameters)[1:])
            raise UserError(f"the learner {name!r}: {method} has to take ({wanted})") from None


# All parameters as one vector: less to trace and compile than a dozen operations for each of many leaves.
ADAM = optax.flatten(optax.scale_by_adam())


def descend(params: Parameters, change: Parameters, lr: jax.Array | float) -> Parameters:
    """Parameters after a step of that learning rate, a traced number, against ``change``."""
    return jax.tree.map(lambda leaf, slope: leaf - lr * slope, params, change)


def silent(twist: jax.Array) -> Action:
    """The action of a robot that steers with twist `[..., 2]` and asks for nothing."""
    return Action(twist=twist, request=jnp.full(twist.shape[:-1], NONE, jnp.int32))
