"""TD3: it finds a bandit's best twist, moves its actor now and then, and blurs what target critics judge a little."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxnav.agents.learner import Batch
from jaxnav.agents.losses import td3 as losses
from jaxnav.agents.td3 import TD3, TD3Config, TD3Hyperparameters

AGENT = TD3(TD3Config(actor_widths=(16,), critic_widths=(32, 32), actor_every=3))
init, update = jax.jit(AGENT.init), jax.jit(AGENT.update)


@jax.jit
def target_of(key, state, batch, hyper):
    return losses.target(key, AGENT.best_twist, AGENT.q, state.target_actor, state.target_critic, batch, hyper)


@jax.jit
def loss_of(actor, critic, batch):
    return losses.actor_loss(actor, AGENT.best_twist, AGENT.q, critic, batch)


@pytest.fixture(scope="module")
def fresh(blank_observation):
    """A learner whose targets are not what they are the targets of."""
    learner, other = (init(jax.random.key(i), blank_observation(), TD3Hyperparameters()) for i in range(2))
    return learner.replace(target_actor=other.actor, target_critic=other.critic)


@pytest.fixture(scope="module")
def batch(random_batch):
    return random_batch(np.random.default_rng(0), (32,), steps=np.arange(32) % 3 + 1)


def same(a, b):
    return all(bool((x == y).all()) for x, y in zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True))


def test_a_bandit_is_learnt_up_to_its_best_twist(blank_observation):
    best, rows = np.array([0.6, -0.4]), 128
    hyper = TD3Hyperparameters(reward_scale=1.0, actor_lr=3e-3, critic_lr=3e-3)
    observation = blank_observation(True, (rows,))

    @jax.jit
    def learnt(key):
        def step(learner, key_and_index):
            key, index = key_and_index
            twist = jax.random.uniform(key, (rows, 2), minval=-1.0)
            batch = Batch(
                observation=observation, next_observation=observation, twist=twist, request=jnp.zeros(rows, jnp.int32),
                reward=-jnp.sum((twist - best) ** 2, axis=-1), terminated=jnp.ones(rows, bool),
                ended=jnp.ones(rows, bool), steps=jnp.ones(rows, jnp.int32),
            )  # fmt: skip
            return AGENT.update(key, learner, batch, hyper, 1.0 - index / 2000, index)[0], None

        start = AGENT.init(key, blank_observation(), hyper)
        learner, _ = jax.lax.scan(step, start, (jax.random.split(key, 2000), jnp.arange(2000)))
        return AGENT.best_action(AGENT.policy(learner), blank_observation()).twist

    np.testing.assert_allclose(learnt(jax.random.key(0)), best, atol=0.12)


def test_the_actor_and_all_targets_move_at_every_third_update_only(fresh, batch):
    hyper = TD3Hyperparameters(tau=0.25)
    before = fresh
    for step in range(7):
        after, metrics = update(jax.random.key(step), before, batch, hyper, 1.0, step)
        assert not same(before.critic, after.critic)
        moves = step % 3 == 0
        for name in ("actor", "target_actor", "target_critic"):
            assert same(getattr(before, name), getattr(after, name)) != moves
        loss = loss_of(before.actor, after.critic, batch) if moves else 0.0
        assert float(metrics["actor_loss"]) == pytest.approx(3 * float(loss))  # so that the mean is one of real losses
        if moves:
            for name in ("actor", "critic"):
                expected = jax.tree.map(
                    lambda a, b: a + 0.25 * (b - a), getattr(before, f"target_{name}"), getattr(after, name)
                )
                jax.tree.map(
                    lambda a, b: np.testing.assert_allclose(a, b, atol=1e-6), getattr(after, f"target_{name}"), expected
                )
        before = after
    assert AGENT.policy(after) is after.target_actor


def test_the_noise_on_twists_that_targets_are_made_of_is_clipped(fresh, batch):
    """Of far too much noise nothing but its sign remains, and the twist stays in its range."""
    hyper = TD3Hyperparameters(target_noise=1e6, target_noise_clip=0.3, reward_scale=0.1, discount=0.9)
    twist = AGENT.best_twist(fresh.target_actor, batch.next_observation)
    signs = np.array([[-1, -1], [-1, 1], [1, -1], [1, 1]])
    tried = np.clip(twist[None] + 0.3 * signs[:, None], -1.0, 1.0)
    judge = jax.jit(jax.vmap(lambda twist: AGENT.q(fresh.target_critic, batch.next_observation, twist).min(axis=0)))
    bootstrap = 0.9**batch.steps * np.asarray(judge(tried)) * ~batch.terminated
    seen = set()
    for i in range(20):
        target = np.asarray(target_of(jax.random.key(i), fresh, batch, hyper))
        error = np.abs(target - 0.1 * batch.reward - bootstrap)
        np.testing.assert_allclose(error.min(axis=0), 0.0, atol=1e-5)
        seen |= set(error[:, ~batch.terminated].argmin(axis=0))
    assert seen == {0, 1, 2, 3}
    exact = target_of(jax.random.key(0), fresh, batch, hyper.replace(target_noise_clip=0.0))
    quiet = target_of(jax.random.key(0), fresh, batch, hyper.replace(target_noise=0.0))
    np.testing.assert_array_equal(exact, quiet)


def test_only_terminated_transitions_do_not_bootstrap(fresh, batch):
    target = target_of(jax.random.key(0), fresh, batch, TD3Hyperparameters(reward_scale=0.1))
    np.testing.assert_array_equal(np.abs(target - 0.1 * batch.reward) > 1e-6, ~batch.terminated)
    assert (batch.ended & ~batch.terminated).any()


def test_it_explores_around_its_twist_within_the_range_and_is_silent(fresh, random_observation):
    observation = random_observation(np.random.default_rng(0), (2000,))
    act, best = jax.jit(AGENT.act), jax.jit(AGENT.best_action)(fresh.actor, observation)
    action = act(jax.random.key(0), fresh, observation, TD3Hyperparameters(exploration_noise=0.1))
    inside = np.abs(best.twist) < 0.5
    np.testing.assert_allclose((action.twist - best.twist)[inside].std(), 0.1, rtol=0.1)
    wild = act(jax.random.key(0), fresh, observation, TD3Hyperparameters(exploration_noise=5.0))
    assert np.abs(wild.twist).max() == 1.0
    for each in (best, action, wild):
        assert each.request.shape == (2000,) and each.request.dtype == jnp.int32 and not each.request.any()
    assert AGENT.vocabulary("train") is None


@pytest.mark.parametrize(
    ("field", "value"), [("actor_every", 0), ("huber_delta", 0.0), ("encoder", "cnn"), ("n_step", 0), ("batch", 0.5)]
)
def test_bad_sizes_name_the_field(field, value):
    with pytest.raises(ValueError, match=f"agent.{field}.*(choose|give)"):
        TD3Config(**{field: value})
