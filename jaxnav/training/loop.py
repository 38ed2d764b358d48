"""The training loop on the device: one jitted chunk of many world steps and updates.

A population is a ``vmap`` of `Trainer.train_chunk` over `LoopState` and `Hyperparameters` with
``in_axes=(member_axes(), 0)``: the counter stays unbatched, so that replay rows and schedules need no second branch.
"""

import chex
import jax
import jax.numpy as jnp

from ..agents.hsac import Batch, Transition
from ..agents.replay import Replay
from ..world import State


@chex.dataclass(frozen=True)
class LoopState:
    """Everything that training goes on from.

    counter: steps of all episodes so far; key: of this member; learner: `LearnerState`; replay: contents; states:
    `State` `[episodes]`; ended: `[episodes]` whether that state is an episode's last, to be replaced before acting.
    """

    counter: jax.Array
    key: jax.Array
    learner: chex.ArrayTree
    replay: chex.ArrayTree
    states: State
    ended: jax.Array


def member_axes():
    """The ``vmap`` axes of a `LoopState`: members everywhere but in the counter, which they share."""
    return LoopState(counter=None, key=0, learner=0, replay=0, states=0, ended=0)


class Trainer:
    """The bundle of pure functions `init` and `train_chunk` for a world, an agent and the sizes in ``TrainConfig``."""

    def __init__(self, world, agent, params, config):
        self.world, self.agent, self.params, self.config = world, agent, params, config
        self._state = jax.eval_shape(lambda key: world.reset(key, params), jax.random.key(0))
        snapshot = jax.eval_shape(world.snapshot, self._state)
        self._observation = jax.eval_shape(lambda s: world.render(s, params), snapshot)
        scalar = jax.ShapeDtypeStruct((), jnp.float32)
        self.replay = Replay(
            rows=config.replay_rows,
            template=Transition(
                snapshot=snapshot,
                next_snapshot=snapshot,
                twist=jax.ShapeDtypeStruct((2,), jnp.float32),
                code=jax.ShapeDtypeStruct((), jnp.uint8),
                reward=scalar,
                terminated=jax.ShapeDtypeStruct((), bool),
            ),
        )

    def init(self, key, hyper) -> LoopState:
        """The state before the first step."""
        key_learner, key = jax.random.split(key)
        episodes = self.config.episodes

        def zeros(shapes, *batch):
            return jax.tree.map(lambda leaf: jnp.zeros((*batch, *leaf.shape), leaf.dtype), shapes)

        return LoopState(
            counter=jnp.int32(0),
            key=key,
            learner=self.agent.init(key_learner, zeros(self._observation), hyper),
            replay=self.replay.init(episodes),
            # Ended before they began: the first step replaces them all, and `init` need not compile a reset.
            states=zeros(self._state, episodes),
            ended=jnp.ones(episodes, bool),
        )

    def train_chunk(self, loop: LoopState, hyper) -> tuple[LoopState, dict]:
        """``steps_per_chunk`` steps of all episodes with their updates. Metrics are means over the chunk, and sums
        `[scenes]` of episodes that ended and that arrived; finite says whether all the learner's numbers still are."""
        key, key_pool, key_steps = jax.random.split(loop.key, 3)
        episodes = self.config.episodes
        pool = self._resets(key_pool, episodes)
        # Twice in a row: any window of `episodes` entries is a set of different fresh episodes.
        pool = jax.tree.map(lambda leaf: jnp.concatenate([leaf, leaf]), pool)
        start = loop.replace(key=key)
        loop, metrics = jax.lax.scan(
            lambda carry, key: self._step(carry, key, pool, hyper),
            start,
            jax.random.split(key_steps, self.config.steps_per_chunk),
        )
        # The metrics of an update are those before its own step: look at what the last one left behind, too.
        # In one piece, since a reduction for each of the many leaves takes as long to compile as the world's step.
        numbers = jnp.concatenate([jnp.ravel(leaf) for leaf in jax.tree.leaves(loop.learner)])
        sums = {name: jnp.sum(metrics.pop(name), axis=0) for name in ("episodes_ended", "episodes_arrived")}
        return loop, jax.tree.map(jnp.mean, metrics) | sums | {"finite": jnp.all(jnp.isfinite(numbers))}

    def _resets(self, key, count):
        return jax.vmap(lambda key: self.world.reset(key, self.params))(jax.random.split(key, count))

    def _step(self, loop, key, pool, hyper):
        key_pool, key_act, key_world, key_updates = jax.random.split(key, 4)
        world, params, episodes = self.world, self.params, self.config.episodes

        # Ended episodes are replaced here, not after the step: `ended` is then an input of this program instead of
        # the end of a long chain, which XLA would compute anew for each of the fifty leaves it selects.
        offset = jax.random.randint(key_pool, (), 0, episodes)
        fresh = jax.tree.map(lambda leaf: jax.lax.dynamic_slice_in_dim(leaf, offset, episodes), pool)
        states = jax.tree.map(lambda new, old: _select(loop.ended, new, old), fresh, loop.states)

        snapshots = jax.vmap(world.snapshot)(states)
        observations = jax.vmap(world.render, in_axes=(0, None))(snapshots, params)
        action = self.agent.act(key_act, loop.learner.actor, observations, hyper)
        keys = jax.random.split(key_world, episodes)
        states, outcome = jax.vmap(world.step, in_axes=(0, 0, 0, None))(keys, states, action, params)

        transitions = Transition(
            snapshot=snapshots,
            next_snapshot=jax.vmap(world.snapshot)(states),
            twist=action.twist,
            code=action.code.astype(jnp.uint8),
            reward=outcome.reward,
            terminated=outcome.terminated,
        )
        replay = self.replay.add(loop.replay, loop.counter, transitions)
        counter = loop.counter + 1
        progress = counter / self.config.total_steps
        lr_scale = 1.0 - (1.0 - hyper.final_lr) * jnp.clip(progress, 0.0, 1.0)

        def learn(learner, key):
            key_sample, key_update = jax.random.split(key)
            batch = self._render(self.replay.sample(key_sample, replay, counter, self.agent.config.batch))
            return self.agent.update(key_update, learner, batch, hyper, lr_scale)

        keys = jax.random.split(key_updates, self.agent.config.updates_per_step)
        learner, metrics = jax.lax.scan(learn, loop.learner, keys)

        ended = outcome.terminated | outcome.truncated
        in_scene = states.scene[:, None] == jnp.arange(len(world.scenes))
        metrics["episodes_ended"] = jnp.sum(in_scene & ended[:, None], axis=0)
        metrics["episodes_arrived"] = jnp.sum(in_scene & outcome.arrived[:, None], axis=0)
        metrics["reward"] = jnp.mean(outcome.reward)
        new = LoopState(counter=counter, key=loop.key, learner=learner, replay=replay, states=states, ended=ended)
        return new, metrics

    def _render(self, transitions):
        # Both ends of the transitions in one go: half as much to compile.
        pair = jax.tree.map(lambda *leaves: jnp.concatenate(leaves), transitions.snapshot, transitions.next_snapshot)
        rendered = jax.vmap(self.world.render, in_axes=(0, None))(pair, self.params)
        batch = transitions.reward.shape[0]
        return Batch(
            observation=jax.tree.map(lambda leaf: leaf[:batch], rendered),
            next_observation=jax.tree.map(lambda leaf: leaf[batch:], rendered),
            twist=transitions.twist,
            code=transitions.code.astype(jnp.int32),
            reward=transitions.reward,
            terminated=transitions.terminated,
        )


def _select(mask, new, old):
    return jnp.where(mask.reshape(mask.shape + (1,) * (old.ndim - 1)), new, old)
