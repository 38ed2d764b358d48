"""A population: its members are what each is alone, and one that breaks spoils nobody else."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxnav.agents.hsac import HSACHyperparameters
from jaxnav.errors import UserError
from jaxnav.training.config import make_agent, resolve
from jaxnav.training.population import Population, member

SEEDS = (0, 1, 2, 0)
MEMBERS = [{}, {"actor_lr": 3e-4}, {"critic_lr": 3e-3}, {"discount": 0.5}]


@pytest.fixture(scope="module")
def population(tiny):
    config = tiny()
    world = dataclasses.replace(config.world, scenes=("square", "hallway"))
    config = resolve(dataclasses.replace(config, world=world))
    return Population(config, make_agent(config), len(SEEDS))


def hyper(**leaves):
    """`HSACHyperparameters` `[members]`: those of `MEMBERS`, and ``leaves`` for all."""
    each = [HSACHyperparameters(**values | leaves) for values in MEMBERS]
    return jax.tree.map(lambda *values: jnp.float32(values), *each)


@pytest.fixture(scope="module")
def whole(population):
    """(`LoopState`, `Trained`) of the members after two chunks in all scenes."""
    return population.train(population.start(SEEDS, hyper()), hyper(), 10)


def assert_close(one, other):
    # A batched matrix product adds in another order than a single one: rounding, 1e-7 of a value, which Adam's
    # division can raise to a visible share of a step, and ten steps are at most 1e-2 long in all.
    for a, b in zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True):
        np.testing.assert_allclose(a, b, atol=1e-3)


def test_members_are_what_each_is_alone(population, whole):
    trainer, (loop, trained) = population.trainer, whole
    chunk, init = jax.jit(trainer.train_chunk), jax.jit(trainer.init)
    assert loop.counter.shape == () and int(loop.counter) == 10
    assert trained.env_steps == 10 * population.config.train.episodes
    assert trained.broken == (None,) * 4
    for i, values in enumerate(MEMBERS):
        floats = jax.tree.map(jnp.float32, HSACHyperparameters(**values))
        alone = init(jax.random.key(SEEDS[i]), floats)
        for _ in range(2):
            alone, _ = chunk(alone, floats)
        for name in ("actor", "critic", "target_critic", "log_temperatures"):
            assert_close(getattr(alone.learner, name), member(getattr(loop.learner, name), i))
        assert_close(trainer.agent.policy(alone.learner), member(trained.policies, i))
    leaf = np.asarray(jax.tree.leaves(loop.learner.critic)[0])
    assert all(np.abs(leaf[i] - leaf[j]).max() > 1e-4 for i in range(4) for j in range(i))


def test_one_that_breaks_is_named_and_spoils_nobody(population, whole):
    wild = hyper()
    wild = wild.replace(critic_lr=wild.critic_lr.at[1].set(1e38))
    reported = []
    loop, trained = population.train(
        population.start(SEEDS, wild), wild, 5, lambda steps, metrics: reported.append((steps, metrics["finite"]))
    )
    broken_at = 5 * population.config.train.episodes
    assert trained.broken == (None, broken_at, None, None)
    assert [(steps, finite.tolist()) for steps, finite in reported] == [(5, [True, False, True, True])]
    _, later = population.train(loop, wild, 10, before=trained.broken)
    assert later.broken == trained.broken
    for i in (0, 2, 3):
        for a, b in zip(
            jax.tree.leaves(member(later.policies, i)), jax.tree.leaves(member(whole[1].policies, i)), strict=True
        ):
            np.testing.assert_array_equal(a, b)


def test_members_play_the_scene_they_are_given(population):
    loop = population.start(SEEDS, hyper(), scene=1)
    scenes = []
    population.train(loop, hyper(), 5, lambda steps, metrics: scenes.append(metrics["episodes_ended"]))
    assert all((ended[:, 0] == 0).all() for ended in scenes)
    loop, _ = population.train(population.start(SEEDS, hyper(), scene=1), hyper(), 5)
    assert (np.asarray(loop.states.scene) == 1).all()


def test_whoever_takes_a_slot_is_what_it_is_from_the_start(population, whole):
    """Bit for bit: neither when a member begins nor what another left in its replay plays a part."""
    loop, _ = population.train(population.start(SEEDS, hyper()), hyper(), 5)
    since = np.array([0, 5, 0, 5])
    loop = population.refill(loop, since == 5, SEEDS, hyper())
    loop, middle = population.train(loop, hyper(), 10, since=since)
    for i in (0, 2):
        assert_same(member(middle.policies, i), member(whole[1].policies, i))
    _, later = population.train(loop, hyper(), 15, since=since)
    for i in (1, 3):
        assert_same(member(later.policies, i), member(whole[1].policies, i))


def assert_same(one, other):
    for a, b in zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True):
        np.testing.assert_array_equal(a, b)


def test_a_schedule_begins_with_its_member(population):
    """Rates that decay to nothing have decayed for whoever was there, and not for whoever comes."""
    rates, since = hyper(final_lr=0.0), np.array([0, 20, 0, 0])
    loop, _ = population.train(population.start(SEEDS, rates), rates, 20)
    loop = population.refill(loop, since == 20, SEEDS, rates)
    start = jax.tree.map(np.asarray, loop.learner.actor)
    after, _ = population.train(loop, rates, 25, since=since)

    def moved(i):
        pairs = zip(jax.tree.leaves(member(after.learner.actor, i)), jax.tree.leaves(member(start, i)), strict=True)
        return max(float(np.abs(a - b).max()) for a, b in pairs)

    assert moved(1) > 1e-3
    assert [moved(i) for i in (0, 2, 3)] == [0.0] * 3


def test_one_that_broke_keeps_its_last_good_policy(population):
    wild = hyper()
    wild = wild.replace(critic_lr=wild.critic_lr.at[1].set(1e38))
    loop = population.start(SEEDS, wild)
    start = jax.tree.map(np.asarray, loop.learner)
    loop, trained = population.train(loop, wild, 10)
    assert trained.broken[1] is not None
    assert_same(member(loop.learner, 1), member(start, 1))
    loop = population.refill(loop, [False, True, False, False], SEEDS, hyper())
    _, mended = population.train(loop, hyper(), 15, since=[0, 10, 0, 0])
    assert mended.broken == (None,) * 4


def test_members_have_worlds_of_their_own(tiny):
    config = tiny()
    population = Population(config, make_agent(config), 2, own=("reward_step",))
    rewards = []
    population.train(
        population.start([0, 0], config.hyper), config.hyper, 5, lambda _, m: rewards.append(m["reward"]),
        own={"reward_step": np.array([-5.0, 995.0])},
    )  # fmt: skip
    np.testing.assert_allclose(rewards[0][1] - rewards[0][0], 1000.0, rtol=1e-3)  # the first chunk's acts are alike


def test_memory_is_known_before_the_start(population, monkeypatch):
    shapes = jax.eval_shape(lambda: population.start(SEEDS, hyper()))
    state = sum(leaf.size * leaf.dtype.itemsize for leaf in jax.tree.leaves(shapes) if leaf.dtype != shapes.key.dtype)
    assert state < population.bytes_needed < 20 * state
    population.check_memory("members")
    each = population.bytes_needed / 4
    monkeypatch.setattr("jaxnav.training.population.free_memory", lambda: int(2.5 * each))
    with pytest.raises(UserError, match=r"^members is 4: 4 members need [\d.]+ GB, [\d.]+ are free: at most 2 fit$"):
        population.check_memory("members")
    monkeypatch.setattr("jaxnav.training.population.free_memory", lambda: int(0.5 * each))
    with pytest.raises(UserError, match=r"give fewer train\.episodes"):
        population.check_memory("members")
