"""Learners trained at once by ``vmap``, in one process and one compilation: members that differ in seed and floats.

A member is whatever stands in a slot of the population: it can be replaced by a new one at any time, and what has
turned non-finite is frozen. Neither needs another compilation.
"""

import dataclasses
import functools
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ..agents.learner import Learner
from ..agents.replay import select
from ..errors import UserError
from .config import RunConfig
from .loop import LoopState, Trainer, member_axes
from .memory import free_memory


@dataclasses.dataclass(frozen=True)
class Trained:
    """A population after some of its training.

    env_steps: of each member; policies: parameters of what is evaluated `[members]`; broken: by member the env step by
    which its numbers were no longer finite, None of one that is well. One that broke is never well again.
    """

    env_steps: int
    policies: Any
    broken: tuple[int | None, ...]


class Population:
    """Trains members of one configuration; ``config.seed`` and ``config.hyper`` are those of nobody.

    Its program is compiled once, whatever seeds, scene and hyperparameters its members then have.

    own: names of fields of ``config.world.params`` of which each member has a value of its own while it trains.
    """

    def __init__(self, config: RunConfig, agent: Learner, members: int, own: tuple[str, ...] = ()) -> None:
        self.config, self.members, self.own = config, members, own
        self.world = config.world.world()
        self._agent = agent
        self.trainer = self._trainer({}, 0)
        # Without replay, and for those who begin together as for those who follow: the same program, the same bits.
        self._begin = jax.jit(
            jax.vmap(lambda *given: self.trainer.init(*given).replace(replay={}), out_axes=member_axes())
        )
        self._refill = jax.jit(_replaced, donate_argnums=0)

    def _trainer(self, own, since):
        config = self.config
        params = config.world.params.replace(**own)
        return Trainer(self.world, self._agent, params, config.train, config.world.randomise, since)

    def start(self, seeds: Iterable[int], hyper: Any, scene: int = -1) -> LoopState:
        """Members before their first step. hyper: leaves of one number, or of one for each member."""
        loop = self._begin(_keys(seeds), self._spread(hyper), jnp.full(self.members, scene, jnp.int32))
        if not self._agent.replays:
            return loop
        shapes = jax.eval_shape(lambda: self.trainer.replay.init(self.config.train.episodes))
        return loop.replace(
            replay=jax.tree.map(lambda leaf: jnp.zeros((self.members, *leaf.shape), leaf.dtype), shapes)
        )  # fmt: skip

    def refill(self, loop: LoopState, slots: Any, seeds: Iterable[int], hyper: Any) -> LoopState:
        """``loop``, which is donated, with members before their first step in ``slots``, a mask `[members]`.

        seeds, hyper: of all members, as for `start`; those outside of ``slots`` don't count. Whoever trains on tells
        `train` since when they are there: the present ``loop.counter``.
        """
        return self._refill(loop, self._begin(_keys(seeds), self._spread(hyper), loop.scene), jnp.asarray(slots))

    def train(
        self,
        loop: LoopState,
        hyper: Any,
        steps: int,
        report: Callable[[int, dict[str, np.ndarray]], object] = lambda steps, metrics: None,
        before: Sequence[int | None] = (),
        own: Mapping[str, Any] | None = None,
        since: Any = 0,
    ) -> tuple[LoopState, Trained]:
        """(loop, `Trained`) after training until ``steps`` steps of all episodes have been played.

        report: called after each chunk with the steps so far and its metrics, `[members]` each; before: ``broken`` of
        an earlier call, whose broken members stay frozen; own: the members' own values, one number or `[members]`,
        by the names given to `Population`; since: the counter at which each member began.
        """
        hyper, own = self._spread(hyper), self._spread({name: (own or {})[name] for name in self.own})
        since = jnp.broadcast_to(jnp.int32(since), self.members)
        broken: list[int | None] = list(before or [None] * self.members)
        while int(loop.counter) < steps:
            learning = jnp.array([step is None for step in broken])
            loop, metrics = self._chunk(loop, hyper, own, since, learning)
            metrics, done = jax.device_get((metrics, loop.counter))
            for member in np.flatnonzero(~metrics["finite"]):
                if broken[member] is None:
                    broken[member] = int(done) * self.config.train.episodes
            report(int(done), metrics)
        env_steps = int(loop.counter) * self.config.train.episodes
        return loop, Trained(env_steps=env_steps, policies=self.policies(loop), broken=tuple(broken))

    def policies(self, loop: LoopState) -> Any:
        """A copy of the parameters of what is evaluated `[members]`."""
        return jax.tree.map(jnp.copy, self._agent.policy(loop.learner))

    @functools.cached_property
    def _chunk(self):
        """The program, compiled ahead of its first use, so that it can be asked what memory it needs."""

        def chunk(loop, hyper, own, since, learning):
            new, metrics = self._trainer(own, since).train_chunk(loop, hyper)
            # Whoever broke keeps what it had before: its numbers slow nobody down, and its last good policy is there.
            learner = jax.tree.map(
                lambda new, old: jnp.where(learning & metrics["finite"], new, old), new.learner, loop.learner
            )
            return new.replace(learner=learner), metrics

        axes = member_axes()
        program = jax.vmap(chunk, in_axes=(axes, 0, 0, 0, 0), out_axes=(axes, 0))
        return jax.jit(program, donate_argnums=0).lower(*self._shapes()).compile()

    def compile(self) -> None:
        """Compile the program, unless that is done: `train` would do it at its first chunk."""
        _ = self._chunk

    def policy_shapes(self) -> Any:
        """Shapes of what `policies` gives."""
        return jax.eval_shape(lambda loop: self._agent.policy(loop.learner), self._shapes()[0])

    def _shapes(self):
        def floats(tree):
            return jax.tree.map(lambda _: jax.ShapeDtypeStruct((self.members,), jnp.float32), tree)

        hyper = floats(self.config.hyper)
        loop = jax.eval_shape(lambda hyper: self.start(range(self.members), hyper), hyper)
        since, learning = (jax.ShapeDtypeStruct((self.members,), dtype) for dtype in (jnp.int32, bool))
        return loop, hyper, floats(dict.fromkeys(self.own, 0.0)), since, learning

    @property
    def bytes_held(self) -> int:
        """Bytes of the device's memory that the members take between two chunks."""
        return self._memory.argument_size_in_bytes

    @property
    def bytes_needed(self) -> int:
        """Bytes of the device's memory while it trains: the members and their program's own. Compiles the program."""
        found = self._memory
        return (
            found.argument_size_in_bytes + found.output_size_in_bytes - found.alias_size_in_bytes
            + found.temp_size_in_bytes
        )  # fmt: skip

    @functools.cached_property
    def _memory(self) -> Any:
        return self._chunk.memory_analysis()

    def check_memory(self, name: str, beside: int = 0, populations: int = 1) -> None:
        """UserError, before anything is allocated, if too little memory is free.

        name: of the number of members; beside: bytes that others, about to be allocated, need; populations: how many
        there are with those.
        """
        need, free = self.bytes_needed + beside, free_memory()
        if need <= free:
            return
        fits = int(self.members * free // need)
        remedy = f"at most {fits} fit" if fits else "give fewer train.episodes or train.replay_rows"
        who = f"{self.members} members" if populations == 1 else f"{populations} populations of {self.members} members"
        raise UserError(
            f"{name} is {self.members}: {who} need {need / 1e9:.1f} GB, {free / 1e9:.1f} are free: {remedy}"
        )

    def _spread(self, values):
        return jax.tree.map(lambda leaf: jnp.broadcast_to(jnp.float32(leaf), self.members), values)


def member(policies: Any, i: int) -> Any:
    """Parameters of one member."""
    return jax.tree.map(lambda leaf: leaf[i], policies)


def _keys(seeds):
    return jax.vmap(jax.random.key)(jnp.asarray(np.array(list(seeds), np.uint32)))


def _replaced(loop, fresh, slots):
    """``loop`` with those who are ``fresh`` in these slots. Replay needs no emptying: `train` is told since when."""
    names = ("key", "learner", "states", "ended")
    return loop.replace(
        **{
            name: jax.tree.map(lambda new, old: _select(slots, new, old), getattr(fresh, name), getattr(loop, name))
            for name in names
        }
    )


def _select(slots, new, old):
    """`select`, for typed keys as well."""
    if jnp.issubdtype(new.dtype, jax.dtypes.prng_key):
        return jax.random.wrap_key_data(select(slots, jax.random.key_data(new), jax.random.key_data(old)))
    return select(slots, new, old)
