"""The training chunk: what it stores, what it replaces, what it compiles, and what a population of it gives."""

import dataclasses
import itertools
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxnav.agents.hsac import HSAC, HSACHyperparameters
from jaxnav.agents.learner import Batch
from jaxnav.training.config import TrainConfig
from jaxnav.training.loop import Trainer
from jaxnav.world import Action, Params, World, WorldConfig

EPISODES = 16


@dataclasses.dataclass(frozen=True)
class Wanderer:
    """An agent that acts at random and learns nothing: it leaves the loop's own work to be looked at."""

    config = SimpleNamespace(batch=1, updates_per_step=1, n_step=1)
    replays, horizon = True, 1

    def init(self, key, observation, hyper):
        return SimpleActor(actor=jnp.float32(0))

    def act(self, key, learner, observation, hyper):
        may_request = observation.may_request
        twist = jax.random.uniform(key, (*may_request.shape, 2), minval=0.0)
        return Action(twist=twist, request=2 * may_request.astype(jnp.int32))

    def update(self, key, learner, batch, hyper, lr_scale, step):
        return SimpleActor(actor=learner.actor * hyper.tau), {"lr_scale": lr_scale}


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class SimpleActor:
    actor: jax.Array


@dataclasses.dataclass(frozen=True)
class Keeper(Wanderer):
    """A `Wanderer` that learns from the steps just played, and whose parameters are these."""

    replays, horizon = False, 5

    def init(self, key, observation, hyper):
        shapes = {"twist": (2,), "request": (), "reward": (), "terminated": (), "ended": (), "steps": ()}
        types = {"request": jnp.int32, "terminated": bool, "ended": bool, "steps": jnp.int32}
        parts = {name: jnp.zeros(shape, types.get(name, jnp.float32)) for name, shape in shapes.items()}
        one = Batch(observation=observation, next_observation=observation, **parts)
        return jax.tree.map(lambda leaf: jnp.zeros((self.horizon, EPISODES, *leaf.shape), leaf.dtype), one)

    def update(self, key, learner, batch, hyper, lr_scale):
        return batch, {"lr_scale": lr_scale}


def hyperparameters(**values):
    return jax.tree.map(jnp.float32, HSACHyperparameters(**values))


@pytest.fixture(scope="module")
def walk():
    """(Trainer, `LoopState` before and after each of 12 single steps, metrics, compiled chunk).

    Replay holds one row, that of the last step.

    A third of the starts lie within the goal's reach, and nobody may walk for more than four steps.
    """
    world = World(WorldConfig(scenes=("square",), beams=2))
    params = Params(max_steps=4.0, goal_tolerance=4.4)
    config = TrainConfig(episodes=EPISODES, replay_rows=1, steps_per_chunk=1, total_steps=10)
    trainer = Trainer(world, Wanderer(), params, config)
    hyper = hyperparameters(final_lr=0.25)
    chunk = jax.jit(trainer.train_chunk)
    loops, metrics = [trainer.init(jax.random.key(1), hyper)], []
    for _ in range(12):
        loop, numbers = chunk(loops[-1], hyper)
        loops.append(loop)
        metrics.append(numbers)
    return trainer, loops, metrics, chunk


def last_row(trainer, loop):
    """The transitions of the last step in the order of the episodes: numpy, leaves `[episodes, ...]`."""
    many, _ = jax.device_get(trainer.replay.sample(jax.random.key(1), loop.replay, loop.counter, 400))
    first = {seed: i for i, seed in enumerate(many.snapshot.seed.tolist())}
    order = [first[seed] for seed in loop.states.seed.tolist()]  # the seed of its noise tells whose transition it is
    return jax.tree.map(lambda leaf: leaf[order], many)


@pytest.fixture(scope="module")
def rows(walk):
    """(loop before, loop after, transitions) of each step."""
    trainer, loops, *_ = walk
    return [(a, b, last_row(trainer, b)) for a, b in itertools.pairwise(loops)]


def test_a_transition_fits_in_256_bytes():
    for pedestrians in (1, 3):
        world = World(WorldConfig(pedestrians=pedestrians))
        trainer = Trainer(world, HSAC(), Params(), TrainConfig())
        size = trainer.replay.bytes_per_transition
        assert size <= 256 + 64 * (pedestrians - 1)
        contents = jax.eval_shape(lambda trainer=trainer: trainer.replay.init(256))
        assert sum(leaf.size * leaf.dtype.itemsize for leaf in contents.values()) == size * 256 * trainer.replay.rows


def test_transitions_keep_the_true_last_state(walk, rows, assert_same):
    snapshot = jax.jit(jax.vmap(walk[0].world.snapshot))
    for _, after, row in rows:
        assert_same(jax.device_get(snapshot(after.states)), row.next_snapshot)


def test_transitions_are_steps_of_the_world(walk, rows):
    trainer = walk[0]
    step = jax.jit(jax.vmap(trainer.world.step, in_axes=(None, 0, 0, None)))
    counts = np.zeros(3, int)
    for before, after, row in rows:
        action = Action(twist=jnp.asarray(row.twist), request=jnp.asarray(row.request, jnp.int32))
        states, outcome = jax.device_get(step(jax.random.key(0), before.states, action, trainer.params))
        went_on = ~np.asarray(before.ended)
        np.testing.assert_array_equal(row.terminated[went_on], outcome.terminated[went_on])
        np.testing.assert_allclose(row.reward[went_on], outcome.reward[went_on], atol=1e-3)
        np.testing.assert_allclose(np.asarray(after.states.robot.x)[went_on], states.robot.x[went_on], atol=1e-5)
        counts += went_on.sum(), outcome.terminated[went_on].sum(), outcome.truncated[went_on].sum()
    assert (counts >= 10).all()  # steps, arrivals or collisions, time-outs: enough of each


def test_a_time_out_is_not_a_termination(rows):
    truncated = 0
    for _, after, row in rows:
        ended, out_of_time = np.asarray(after.ended), np.asarray(after.states.t) >= 4
        np.testing.assert_array_equal(ended, row.terminated | out_of_time)
        truncated += (out_of_time & ~row.terminated).sum()
    assert truncated >= 10


def test_ended_episodes_are_replaced_before_acting_and_others_go_on(walk, rows):
    snapshot = jax.jit(jax.vmap(walk[0].world.snapshot))
    assert np.asarray(rows[0][0].ended).all()
    for before, after, row in rows:
        ended, old = np.asarray(before.ended), jax.device_get(snapshot(before.states))
        np.testing.assert_array_equal(row.snapshot.t[ended], 0)
        assert not np.isin(row.snapshot.seed[ended], old.seed).any()
        for name in ("t", "seed", "x", "y", "heading"):
            np.testing.assert_array_equal(getattr(row.snapshot, name)[~ended], getattr(old, name)[~ended])
        np.testing.assert_array_equal(row.next_snapshot.t, row.snapshot.t + 1)
        np.testing.assert_array_equal(np.asarray(after.states.seed), row.snapshot.seed)
    assert {False, True} == set(np.concatenate([np.asarray(before.ended) for before, *_ in rows[1:]]).tolist())


def test_new_episodes_differ_from_each_other(rows):
    assert len(set(rows[0][2].snapshot.seed.tolist())) == EPISODES


def test_the_counter_counts_steps_and_rates_decay_to_their_end(walk):
    _, loops, metrics, _ = walk
    assert [int(loop.counter) for loop in loops] == list(range(13))
    expected = [1 - 0.75 * min(step / 10, 1) for step in range(1, 13)]
    np.testing.assert_allclose([m["lr_scale"] for m in metrics], expected, rtol=1e-6)


def test_numbers_that_break_in_the_last_update_are_noticed(walk):
    """The losses of an update are those before its step: a chunk may end with broken parameters and fine losses."""
    _, loops, metrics, chunk = walk
    assert all(m["finite"] for m in metrics)
    _, broken = chunk(loops[-1], hyperparameters(tau=np.nan))
    assert not broken["finite"]
    assert np.isfinite(broken["reward"]) and np.isfinite(broken["lr_scale"])


def test_metrics_count_the_episodes_that_ended(rows, walk):
    for (_, after, row), metrics in zip(rows, walk[2], strict=True):
        assert metrics["episodes_ended"].tolist() == [int(np.asarray(after.ended).sum())]
        arrived = np.hypot(
            row.next_snapshot.goal_x - row.next_snapshot.x, row.next_snapshot.goal_y - row.next_snapshot.y
        )
        assert metrics["episodes_arrived"][0] <= (row.terminated).sum()
        assert metrics["episodes_arrived"][0] >= (row.terminated & (arrived < 4.0)).sum()
        assert metrics["reward"] == pytest.approx(row.reward.mean(), rel=1e-4)


def test_rollouts_are_steps_in_a_row_with_their_true_next_observations(walk):
    """What a learner without replay is given: `[horizon, episodes]`, each step's end the next one's start."""
    config = TrainConfig(episodes=EPISODES, replay_rows=1, steps_per_chunk=10, total_steps=20)
    trainer = Trainer(walk[0].world, Keeper(), walk[0].params, config)
    loop, metrics = jax.jit(trainer.train_chunk)(trainer.init(jax.random.key(1), hyperparameters()), hyperparameters())
    batch = jax.device_get(loop.learner)
    ended, goal = batch.ended, batch.observation.pose[..., 2, :2]
    assert ended.shape == (5, EPISODES) and int(loop.counter) == 10
    assert (batch.steps == 1).all() and (ended >= batch.terminated).all()
    for after, now in zip(jax.tree.leaves(batch.next_observation), jax.tree.leaves(batch.observation), strict=True):
        np.testing.assert_array_equal(after[:-1][~ended[:-1]], now[1:][~ended[:-1]])
    # An episode that ended has its own last observation, not the first of the next one, which starts elsewhere.
    apart = np.hypot(*np.moveaxis(batch.next_observation.pose[:-1, :, 2, :2] - goal[1:], -1, 0))
    assert (apart[ended[:-1]] > 0.05).all() and ended[:-1].sum() >= 10 <= (~ended[:-1]).sum()
    # After a step a robot turns as its twist of that step asks.
    turns = float(trainer.params.max_w) * batch.twist[..., 1]
    np.testing.assert_allclose(batch.next_observation.twist[..., 1], turns, atol=1e-6)
    in_scene = metrics["episodes_ended"]
    assert in_scene.shape == (1,) and ended.sum() <= in_scene[0] <= 10 * EPISODES


@pytest.fixture(scope="module")
def learning(tiny):
    """(Trainer, its compiled chunk, list of what was traced) of the smallest learner."""
    config = tiny()
    trainer = Trainer(config.world.world(), HSAC(config.agent), config.world.params, config.train)
    traces = []

    def train_chunk(loop, hyper):
        traces.append(None)
        return trainer.train_chunk(loop, hyper)

    return trainer, jax.jit(train_chunk, donate_argnums=0), jax.jit(trainer.init), traces


def test_a_chunk_is_traced_once_and_determined_by_its_seed(learning, assert_same):
    _, chunk, init, traces = learning
    ends = []
    for seed in (0, 0, 1):
        loop = init(jax.random.key(seed), hyperparameters())
        for _ in range(3):
            loop, metrics = chunk(loop, hyperparameters(critic_lr=1e-3 + 1e-4 * seed))
        ends.append((loop, metrics))
    assert len(traces) == 1
    assert_same(ends[0], ends[1])
    assert ends[0][1]["critic_loss"] != ends[2][1]["critic_loss"]
    assert int(ends[0][0].counter) == 15


def test_a_chunk_learns(learning):
    _, chunk, init, _ = learning
    start = jax.device_get(init(jax.random.key(0), hyperparameters()).learner)
    end, metrics = chunk(init(jax.random.key(0), hyperparameters()), hyperparameters())
    for name in ("actor", "critic", "target_critic", "log_temperatures"):
        before, after = (jax.tree.leaves(getattr(learner, name)) for learner in (start, end.learner))
        assert any((a != b).any() for a, b in zip(before, after, strict=True)), name
    assert all(np.isfinite(value).all() for value in metrics.values())
    still, _ = chunk(
        init(jax.random.key(0), hyperparameters()),
        hyperparameters(actor_lr=0.0, critic_lr=0.0, temperature_lr=0.0, tau=0.0),
    )
    for name in ("actor", "critic", "target_critic"):
        before, after = (jax.tree.leaves(getattr(learner, name)) for learner in (start, still.learner))
        assert all((a == b).all() for a, b in zip(before, after, strict=True)), name
