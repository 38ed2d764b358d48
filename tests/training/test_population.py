"""A population: its members are what each is alone, and one that breaks spoils nobody else."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxnav.agents.hsac import Hyperparameters
from jaxnav.training.config import make_agent, resolve
from jaxnav.training.population import Population, member

SEEDS = (0, 1, 2, 0)
MEMBERS = [{}, {"actor_lr": 3e-4}, {"critic_lr": 3e-3}, {"discount": 0.5}]


@pytest.fixture(scope="module")
def population(tiny):
    config = tiny()
    world = dataclasses.replace(config.world, scenes=("square", "hallway"))
    config = resolve(dataclasses.replace(config, scene="all", world=world))
    return Population(config, make_agent(config), len(SEEDS))


def hyper(**leaves):
    """`Hyperparameters` `[members]`: those of `MEMBERS`, and ``leaves`` for all."""
    each = [Hyperparameters(**values | leaves) for values in MEMBERS]
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
        floats = jax.tree.map(jnp.float32, Hyperparameters(**values))
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
