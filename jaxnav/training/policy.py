"""A trained policy as one object: what it has learnt, whether it speaks, and how people speak to it."""

import dataclasses
from collections.abc import Iterable
from typing import Any

import jax

from ..agents.learner import Learner
from ..language.vocabulary import Vocabulary
from ..world import Action, Observation, Params, State, World
from .config import RunConfig


@jax.tree_util.register_pytree_with_keys_class
@dataclasses.dataclass(frozen=True)
class Policy:
    """A trained robot: observation in, action out. A pytree: give it to ``jit`` and ``vmap`` as an argument.

    parameters: of the learner's networks that act; a population's have a leading axis `[members]`.
    voice:      whether it may make requests, bool; without voice every request is none.
    vocabulary: with which people speak to it, None of a learner that hears codes.
    learner:    what the parameters are of; static.
    world:      in which it was trained; static.
    config:     of the run that it comes from, None of none; static, and no reason to compile anything again.

    Two policies of equal learners in equal worlds are of one structure, whatever run they come from: what was compiled
    for one serves the other.
    """

    parameters: Any
    voice: Any = True
    vocabulary: Vocabulary | None = None
    learner: Learner = dataclasses.field(kw_only=True)
    world: World = dataclasses.field(kw_only=True)
    config: RunConfig | None = dataclasses.field(default=None, kw_only=True)

    def reset(self) -> "Policy":
        """The policy at an episode's start: itself, since it remembers nothing."""
        return self

    def act(self, observation: Observation) -> Action:
        """The most probable request and the mean twist, for one observation."""
        return self.learner.best_action(self.parameters, observation, self.voice, self.vocabulary)

    def __call__(self, state: State, world: World, params: Params) -> Action:
        """The action in a state of a world: a policy is a player."""
        return self.act(world.observe(state, params))

    @property
    def params(self) -> Params:
        """The floats of the world in which it was trained."""
        return Params() if self.config is None else self.config.world.params

    def replace(self, **changes: Any) -> "Policy":
        """The same with other fields."""
        return dataclasses.replace(self, **changes)

    def hearing(self, phrases: str) -> "Policy":
        """The same among people who speak phrases of that split: train, validation or test."""
        return self.replace(vocabulary=self.learner.vocabulary(phrases))

    def muted(self) -> "Policy":
        """The same without its voice."""
        return self.replace(voice=False)

    def tree_flatten_with_keys(self) -> tuple[list[tuple[Any, Any]], "_Static"]:
        """The leaves with their keys, and the static part."""
        leaves = [(jax.tree_util.GetAttrKey(name), getattr(self, name)) for name in _LEAVES]
        return leaves, _Static(self.learner, self.world, self.config)

    @classmethod
    def tree_unflatten(cls, static: "_Static", leaves: Iterable[Any]) -> "Policy":
        """The inverse of flattening."""
        return cls(*leaves, learner=static.learner, world=static.world, config=static.config)


_LEAVES = ("parameters", "voice", "vocabulary")


class _Static:
    """The static part of a `Policy`, equal where the same program computes the same."""

    def __init__(self, learner, world, config):
        self.learner, self.world, self.config = learner, world, config

    def _key(self):
        return type(self.learner), self.learner.config, self.world

    def __eq__(self, other):
        return isinstance(other, _Static) and self._key() == other._key()

    def __hash__(self):
        return hash(self._key())
