"""Learners trained at once by ``vmap``, in one process and one compilation: members that differ in seed and floats."""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from .config import RunConfig
from .loop import LoopState, Trainer, member_axes


@dataclasses.dataclass(frozen=True)
class Trained:
    """What a population came to after some of its training.

    env_steps: of each member; policies: parameters of what is evaluated `[members]`; broken: by member the env step by
    which its numbers were no longer finite, None of one that is well. One that broke is never well again.
    """

    env_steps: int
    policies: Any
    broken: tuple[int | None, ...]


class Population:
    """Trains members of one configuration; ``config.seed`` and ``config.hyper`` are those of nobody.

    Its program is compiled once, whatever seeds, scene and hyperparameters its members then have.
    """

    def __init__(self, config: RunConfig, agent, members: int):
        self.config, self.members = config, members
        self.world = config.world.world()
        self.trainer = Trainer(self.world, agent, config.world.params, config.train, config.world.randomise)
        axes = member_axes()
        self._init = jax.jit(jax.vmap(self.trainer.init, in_axes=(0, 0, None), out_axes=axes))
        self._chunk = jax.jit(
            jax.vmap(self.trainer.train_chunk, in_axes=(axes, 0), out_axes=(axes, 0)), donate_argnums=0
        )

    def start(self, seeds, hyper, scene=-1) -> LoopState:
        """Members before their first step. hyper: leaves of one number, or of one for each member."""
        hyper = self._spread(hyper)
        return self._init(jnp.stack([jax.random.key(seed) for seed in seeds]), hyper, scene)

    def train(self, loop: LoopState, hyper, steps, report=lambda steps, metrics: None, before=()):
        """(loop, `Trained`) after training until ``steps`` steps of all episodes have been played.

        report: called after each chunk with the steps so far and its metrics, `[members]` each; before: ``broken`` of
        an earlier call.
        """
        hyper = self._spread(hyper)
        broken: list[int | None] = list(before or [None] * self.members)
        while int(loop.counter) < steps:
            loop, metrics = self._chunk(loop, hyper)
            metrics, done = jax.device_get((metrics, loop.counter))
            for member in np.flatnonzero(~metrics["finite"]):
                if broken[member] is None:
                    broken[member] = int(done) * self.config.train.episodes
            report(int(done), metrics)
        env_steps = int(loop.counter) * self.config.train.episodes
        policies = jax.tree.map(jnp.copy, self.trainer.agent.policy(loop.learner))
        return loop, Trained(env_steps=env_steps, policies=policies, broken=tuple(broken))

    def _spread(self, hyper):
        return jax.tree.map(lambda leaf: jnp.broadcast_to(jnp.float32(leaf), self.members), hyper)


def member(policies, i):
    """Parameters of one member."""
    return jax.tree.map(lambda leaf: leaf[i], policies)
