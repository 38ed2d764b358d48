"""The training loop on the device: one jitted chunk of many world steps and updates.

A population is a ``vmap`` of `Trainer.train_chunk` over `LoopState` and `HSACHyperparameters` with
``in_axes=(member_axes(), 0)``: the counter stays unbatched, so that replay rows and schedules need no second branch.
"""

from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
from flax import struct

from ..agents.learner import Batch, Learner, Transition
from ..agents.replay import Replay, by_shard, select
from ..world import Params, World
from .config import TrainConfig
from .randomise import draw


class LoopState(struct.PyTreeNode):
    """Everything that training goes on from. As ``vmap`` axes or shardings it has these in place of arrays.

    counter: steps of all episodes so far.
    key:     of this member.
    scene:   index of the scene it plays, -1 for all of the world's.
    learner: its state.
    replay:  its contents, `{}` of a learner without replay.
    states:  `State` `[episodes]`.
    ended:   `[episodes]` whether that state is an episode's last, to be replaced before acting.
    """

    counter: Any
    key: Any
    scene: Any
    learner: Any
    replay: Any
    states: Any
    ended: Any


def member_axes() -> LoopState:
    """The ``vmap`` axes of a `LoopState`: members everywhere but in the counter, which they share."""
    return LoopState(counter=None, key=0, scene=0, learner=0, replay=0, states=0, ended=0)


class Trainer:
    """The bundle of pure functions `init` and `train_chunk` for a world, an agent and the sizes in ``TrainConfig``.

    ranges: from which each episode draws fields of ``params``, (name, lowest, highest); since: the counter at which
    this learner began, a number or, for a member of a population that took another's place, traced; shards: equal parts
    of the episodes, a divisor of their number and of the batch. Each begins its episodes from a pool of its own and has
    its share in each batch, so that devices that hold whole shards need none of each other's states and replay; vmap:
    makes a function of one episode one of all, that of a `Layout` where they lie on several devices.
    """

    def __init__(
        self,
        world: World,
        agent: Learner,
        params: Params,
        config: TrainConfig,
        ranges: Sequence[tuple[str, float, float]] = (),
        since: Any = 0,
        shards: int = 1,
        vmap: Callable[..., Callable[..., Any]] = jax.vmap,
    ) -> None:
        self.world, self.agent, self.params, self.config = world, agent, params, config
        self.ranges, self.since, self.shards, self._vmap = ranges, since, shards, vmap
        self._state = jax.eval_shape(lambda key: world.reset(key, params), jax.random.key(0))
        snapshot = jax.eval_shape(world.snapshot, self._state)
        self._observation = jax.eval_shape(lambda s: world.observe_snapshot(s, params), snapshot)
        shapes: dict[str, Any] = {
            "snapshot": snapshot,
            "next_snapshot": snapshot,
            "twist": jax.ShapeDtypeStruct((2,), jnp.float32),
            "request": jax.ShapeDtypeStruct((), jnp.uint8),
            "reward": jax.ShapeDtypeStruct((), jnp.float32),
            "terminated": jax.ShapeDtypeStruct((), bool),
            "ended": jax.ShapeDtypeStruct((), bool),
        }
        self.replay = Replay(
            rows=config.replay_rows,
            shards=shards,
            template=Transition(**shapes),
        )

    @property
    def bytes_per_transition(self) -> int:
        """Bytes of replay for one transition; 0 for a learner without replay."""
        return self.replay.bytes_per_transition if self.agent.replays else 0

    def init(self, key: jax.Array, hyper: Any, scene: Any = -1) -> LoopState:
        """The state before the first step; ``scene``: index of the only one to play, -1 for all."""
        key_learner, key = jax.random.split(key)
        episodes = self.config.episodes

        def zeros(shapes, *batch):
            return jax.tree.map(lambda leaf: jnp.zeros((*batch, *leaf.shape), leaf.dtype), shapes)

        return LoopState(
            counter=jnp.int32(0),
            key=key,
            scene=jnp.int32(scene),
            learner=self.agent.init(key_learner, zeros(self._observation), hyper),
            replay=self.replay.init(episodes) if self.agent.replays else {},
            # Ended before they began: the first step replaces them all, and `init` need not compile a reset.
            states=zeros(self._state, episodes),
            ended=jnp.ones(episodes, bool),
        )

    def train_chunk(self, loop: LoopState, hyper: Any) -> tuple[LoopState, dict[str, jax.Array]]:
        """``steps_per_chunk`` steps of all episodes with their updates. Metrics are means over the chunk, and sums
        `[scenes]` of episodes that ended and that arrived; finite says whether all the learner's numbers still are."""
        key, key_pool, key_steps = jax.random.split(loop.key, 3)
        episodes = self.config.episodes
        pool = self._resets(key_pool, episodes, loop.scene)
        # Twice in a row: any window of as many entries as a shard has is a set of different fresh episodes.
        twice = by_shard(lambda leaf: jnp.concatenate([leaf, leaf]), self.shards, axes=(0,))
        pool = jax.tree.map(twice, pool)
        start = loop.replace(key=key)
        iterations = self.config.steps_per_chunk // self.agent.horizon
        loop, metrics = jax.lax.scan(
            lambda carry, keys: self._iterate(carry, keys, pool, hyper), start, self._keys(key_steps, iterations)
        )
        # The metrics of an update are those before its own step: look at what the last one left behind, too.
        # In one piece, since a reduction for each of the many leaves takes as long to compile as the world's step.
        numbers = jnp.concatenate([jnp.ravel(leaf) for leaf in jax.tree.leaves(loop.learner)])
        sums = {name: jnp.sum(metrics.pop(name), axis=0) for name in ("episodes_ended", "episodes_arrived")}
        return loop, jax.tree.map(jnp.mean, metrics) | sums | {"finite": jnp.all(jnp.isfinite(numbers))}

    def _keys(self, key, iterations):
        """The keys of all iterations: `[iterations, horizon, 3]` to play, `[iterations, updates, 2]` to learn.

        In one go: on a CPU every draw of a shape of its own, such as a split, takes half a second to compile.
        """
        key_play, key_learn = jax.random.split(key)
        updates = self.agent.config.updates_per_step if self.agent.replays else 1
        play = jax.random.split(key_play, (iterations, self.agent.horizon, 3))
        return play, jax.random.split(key_learn, (iterations, updates, 2))

    def _resets(self, key, count, scene):
        def reset(key, scene):
            key, key_draw = jax.random.split(key)
            drawn, seed = jax.random.bits(key_draw, (2,), jnp.uint32)
            drawn = (drawn % len(self.world.scenes)).astype(jnp.int32)
            params = draw(seed, self.params, self.ranges) if self.ranges else self.params
            return self.world.reset(key, params, jnp.where(scene < 0, drawn, scene), seed)

        return self._vmap(reset, in_axes=(0, None))(jax.random.split(key, count), scene)

    def _params(self, seeds):
        """`Params` of the episodes with these seeds, and their ``vmap`` axis."""
        if not self.ranges:
            return self.params, None
        return jax.vmap(lambda seed: draw(seed, self.params, self.ranges))(seeds), 0

    def _iterate(self, loop, keys, pool, hyper):
        """``horizon`` steps of all episodes, and what is learnt after them."""
        play, learn = keys
        if self.agent.replays:
            loop, (transitions, metrics) = self._step(loop, play[0], pool, hyper)
            loop, losses = self._learn_from_replay(loop, learn, transitions, hyper)
        else:
            loop, (transitions, metrics) = jax.lax.scan(
                lambda loop, keys: self._step(loop, keys, pool, hyper), loop, play
            )
            sums = {name: jnp.sum(metrics.pop(name), axis=0) for name in ("episodes_ended", "episodes_arrived")}
            metrics = {"reward": jnp.mean(metrics["reward"])} | sums
            batch = jax.vmap(self._render)(transitions)
            learner, losses = self.agent.update(learn[0, 0], loop.learner, batch, hyper, self._lr_scale(loop, hyper))
            loop = loop.replace(learner=learner)
        return loop, metrics | losses

    def _step(self, loop, keys, pool, hyper):
        """A step of all episodes: (loop, (transitions `[episodes]`, metrics))."""
        key_pool, key_act, key_world = keys
        world, episodes = self.world, self.config.episodes

        # Ended episodes are replaced here, not after the step: `ended` is then an input of this program instead of
        # the end of a long chain, which XLA would compute anew for each of the fifty leaves it selects.
        size = episodes // self.shards
        offsets = (jax.random.bits(key_pool, (self.shards,), jnp.uint32) % size).astype(jnp.int32)
        window = by_shard(
            lambda leaf, offset: jax.lax.dynamic_slice_in_dim(leaf, offset[0], size), self.shards, axes=(0, 0)
        )
        states = jax.tree.map(lambda pool, old: select(loop.ended, window(pool, offsets), old), pool, loop.states)

        params, axis = self._params(states.seed)
        snapshots = jax.vmap(world.snapshot)(states)
        observations = self._vmap(world.observe_snapshot, in_axes=(0, axis))(snapshots, params)
        action = self.agent.act(key_act, loop.learner, observations, hyper)
        keys = jax.random.split(key_world, episodes)
        states, outcome = self._vmap(world.step, in_axes=(0, 0, 0, axis))(keys, states, action, params)
        ended = outcome.terminated | outcome.truncated

        transitions = Transition(
            snapshot=snapshots,
            next_snapshot=jax.vmap(world.snapshot)(states),
            twist=action.twist,
            request=action.request.astype(jnp.uint8),
            reward=outcome.reward,
            terminated=outcome.terminated,
            ended=ended,
        )
        in_scene = states.scene[:, None] == jnp.arange(len(world.scenes))
        metrics = {
            "episodes_ended": jnp.sum(in_scene & ended[:, None], axis=0),
            "episodes_arrived": jnp.sum(in_scene & outcome.arrived[:, None], axis=0),
            "reward": jnp.mean(outcome.reward),
        }
        return loop.replace(counter=loop.counter + 1, states=states, ended=ended), (transitions, metrics)

    def _learn_from_replay(self, loop, keys, transitions, hyper):
        """``updates_per_step`` updates from replay, the new transitions in it."""
        config = self.agent.config
        replay = self.replay.add(loop.replay, loop.counter - 1, transitions)
        lr_scale = self._lr_scale(loop, hyper)

        def learn(learner, keys_and_step):
            (key_sample, key_update), step = keys_and_step
            sampled, steps = self.replay.sample(
                key_sample, replay, loop.counter, config.batch, config.n_step, hyper.discount, self.since
            )
            batch = self._render(sampled, steps)
            return self.agent.update(key_update, learner, batch, hyper, lr_scale, step)

        # Counted by what members of a population share: their delayed updates stay one branch.
        steps = loop.counter * config.updates_per_step + jnp.arange(config.updates_per_step)
        learner, metrics = jax.lax.scan(learn, loop.learner, (keys, steps))
        return loop.replace(learner=learner, replay=replay), jax.tree.map(jnp.mean, metrics)

    def _lr_scale(self, loop, hyper):
        progress = jnp.clip((loop.counter - self.since) / self.config.total_steps, 0.0, 1.0)
        return 1.0 - (1.0 - hyper.final_lr) * progress

    def _render(self, transitions, steps: Any = 1):
        def render(snapshots):
            params, axis = self._params(snapshots.seed)
            return jax.vmap(self.world.observe_snapshot, in_axes=(0, axis))(snapshots, params)

        # Both ends of the transitions in one go: half as much to compile.
        pair = jax.tree.map(lambda *leaves: jnp.stack(leaves), transitions.snapshot, transitions.next_snapshot)
        rendered = jax.vmap(render)(pair)
        return Batch(
            observation=jax.tree.map(lambda leaf: leaf[0], rendered),
            next_observation=jax.tree.map(lambda leaf: leaf[1], rendered),
            twist=transitions.twist,
            request=transitions.request.astype(jnp.int32),
            reward=transitions.reward,
            terminated=transitions.terminated,
            ended=transitions.ended,
            steps=jnp.broadcast_to(steps, transitions.reward.shape),
        )
