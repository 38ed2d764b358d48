"""PPO and A2C: their gradients by definition, advantages against plain Python, and a bandit that they get better at."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxnav.agents.a2c import A2C, A2CConfig
from jaxnav.agents.learner import Batch
from jaxnav.agents.losses.ppo import clipped_objective, gae
from jaxnav.agents.ppo import PPO, PPOConfig, PPOHyperparameters

SIZES = {"actor_widths": (16,), "critic_widths": (16,)}
HORIZON, EPISODES = 4, 6
AGENTS = {
    "ppo": PPO(PPOConfig(horizon=HORIZON, epochs=2, minibatches=3, **SIZES)),
    "a2c": A2C(A2CConfig(horizon=HORIZON, **SIZES)),
}
HYPER = PPOHyperparameters(reward_scale=1.0, discount=0.9, gae_lambda=0.8)


class Learner:
    """An agent, its first parameters, and its compiled functions."""

    def __init__(self, name, blank_observation):
        self.agent = AGENTS[name]
        self.start = jax.jit(self.agent.init)(jax.random.key(0), blank_observation(), HYPER)
        self.update, self.act = jax.jit(self.agent.update), jax.jit(self.agent.act)
        self.best_action = jax.jit(self.agent.best_action)


@pytest.fixture(scope="module", params=AGENTS)
def learner(request, blank_observation):
    return Learner(request.param, blank_observation)


@pytest.fixture(scope="module")
def batch(learner, random_batch):
    """Random steps, of twists that the learner has tried."""
    batch = random_batch(np.random.default_rng(0), (HORIZON, EPISODES))
    return batch.replace(twist=learner.act(jax.random.key(1), learner.start, batch.observation, HYPER).twist)


def same(a, b):
    return all(bool((x == y).all()) for x, y in zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True))


# What an episode's step is followed by.
GOES_ON, TIMES_OUT, ARRIVES = range(3)


@functools.partial(jax.jit, static_argnums=0)
def advantages(scale, endings, rewards, values, next_values):
    nothing = dict.fromkeys(("observation", "next_observation", "twist", "request"), jnp.zeros(0))
    batch = Batch(
        reward=rewards / scale,
        terminated=endings == ARRIVES,
        ended=endings != GOES_ON,
        steps=jnp.ones(endings.shape),
        **nothing,
    )
    return gae(batch, values, next_values, HYPER.replace(reward_scale=scale))


def plain_advantage(endings, rewards, values, next_values, first):
    """Of one episode's step ``first``: the sum of discounted errors until it ends, or the record does."""
    total, share = 0.0, 1.0
    for t in range(first, len(endings)):
        after = 0.0 if endings[t] == ARRIVES else 0.9 * next_values[t]
        total += share * (rewards[t] + after - values[t])
        if endings[t] != GOES_ON:
            break
        share *= 0.9 * 0.8
    return total


@settings(max_examples=60)
@given(
    endings=st.lists(st.sampled_from([GOES_ON, GOES_ON, TIMES_OUT, ARRIVES]), min_size=15, max_size=15),
    seed=st.integers(0, 2**31 - 1),
)
def test_advantages_are_those_of_plain_python(endings, seed):
    endings = np.array(endings).reshape(5, 3)
    rewards, values, next_values = np.random.default_rng(seed).normal(size=(3, 5, 3)).astype(np.float32)
    expected = [
        [plain_advantage(*(table[:, i] for table in (endings, rewards, values, next_values)), t) for i in range(3)]
        for t in range(5)
    ]
    np.testing.assert_allclose(advantages(0.5, endings, rewards, values, next_values), expected, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize(("endings", "matters"), [(GOES_ON, True), (TIMES_OUT, True), (ARRIVES, False)])
def test_a_time_out_learns_from_where_it_ended_and_an_arrival_does_not(
    learner, batch, random_observation, endings, matters
):
    """Another next observation at one step of one episode changes what is learnt, or nothing at all."""
    step, episode = 1, 2
    terminated, ended = batch.terminated.copy(), batch.ended.copy()
    terminated[step, episode], ended[step, episode] = endings == ARRIVES, endings != GOES_ON
    one = batch.replace(terminated=terminated, ended=ended)
    other = jax.tree.map(np.array, one.next_observation)
    jax.tree.map(
        lambda leaf, new: leaf.__setitem__((step, episode), new), other, random_observation(np.random.default_rng(1))
    )
    first, second = (
        learner.update(jax.random.key(0), learner.start, each, HYPER)[0]
        for each in (one, one.replace(next_observation=other))
    )
    assert same(first, second) != matters
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(first))


@pytest.fixture(scope="module")
def slope_of_clipped():
    """Slope of PPO's loss in the log density of each twist that was tried, given (ratio, advantage) of each."""

    @jax.jit
    def slope(ratio, advantage):
        return jax.grad(clipped_objective)(jnp.log(ratio), jnp.zeros(ratio.shape), advantage, HYPER.replace(clip=0.2))

    return slope


def test_beyond_the_clip_nothing_is_gained(slope_of_clipped):
    """Where the ratio has gone far enough in the direction that pays, the gradient is zero; nowhere else."""
    ratio = np.tile(np.float32([0.5, 0.79, 0.81, 1.0, 1.19, 1.21, 3.0]), 2)
    advantage = np.repeat(np.float32([1.0, -1.0]), 7)  # mean 0 and standard deviation 1, as they will be
    far = np.where(advantage > 0, ratio > 1.2, ratio < 0.8)
    expected = np.where(far, 0.0, -ratio * advantage / 14)
    np.testing.assert_allclose(slope_of_clipped(ratio, advantage), expected, rtol=1e-5)


def test_advantages_are_normalised_first(slope_of_clipped):
    advantage = np.random.default_rng(0).normal(3.0, 7.0, 14).astype(np.float32)
    one, other = (slope_of_clipped(np.ones(14, np.float32), each) for each in (advantage, 5 * advantage - 40))
    np.testing.assert_allclose(one, -(advantage - advantage.mean()) / advantage.std() / 14, rtol=1e-4)
    np.testing.assert_allclose(one, other, rtol=1e-3, atol=1e-6)


def test_the_gradient_of_a2c_is_the_plain_policy_gradient(blank_observation, random_observation):
    """-mean of advantage times slope of the log density, here jax.scipy's."""
    agent = AGENTS["a2c"]
    state = jax.jit(agent.init)(jax.random.key(0), blank_observation(), HYPER)
    rng = np.random.default_rng(0)
    part = {
        "observation": random_observation(rng, (24,)), "twist": np.float32(rng.normal(size=(24, 2))),
        "advantage": np.float32(rng.normal(2.0, 1.0, 24)), "log_density": np.full(24, np.nan, np.float32),
        "return": np.zeros(24, np.float32),
    }  # fmt: skip

    def definition(actor):
        mean, log_std = agent.gaussian(actor, part["observation"])
        density = jax.scipy.stats.norm.logpdf(part["twist"], mean, jnp.exp(log_std))
        return -jnp.mean(part["advantage"] * jnp.sum(density, axis=-1))

    hyper = HYPER.replace(entropy_weight=0.0)
    gradient = jax.jit(jax.grad(lambda actor: agent.loss((actor, state.value), part, hyper)[0]))(state.actor)
    expected = jax.jit(jax.grad(definition))(state.actor)
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-4, atol=1e-6), gradient, expected)
    assert max(np.abs(leaf).max() for leaf in jax.tree.leaves(gradient)) > 0.1


def test_they_start_as_wide_as_they_are_told_and_are_silent(learner, random_observation):
    observation = random_observation(np.random.default_rng(0), (4000,))
    best = learner.best_action(learner.start.actor, observation)
    tried = learner.act(jax.random.key(0), learner.start, observation, HYPER)
    # The mean is clipped in the best action only.
    inside = (np.abs(best.twist) < 1).all(axis=-1)
    assert inside.mean() > 0.5
    np.testing.assert_allclose((tried.twist - best.twist)[inside].std(), HYPER.initial_std, rtol=0.2)
    assert np.abs(tried.twist).max() > 1 >= np.abs(best.twist).max()
    for action in (best, tried):
        assert action.request.shape == (4000,) and action.request.dtype == jnp.int32 and not action.request.any()
    assert learner.agent.vocabulary("train") is None


def test_what_is_evaluated_is_the_average_of_the_actor(learner, batch):
    """After so many steps of the actor as an update makes, which are all alike if each goes nowhere."""
    after, _ = learner.update(jax.random.key(0), learner.start, batch, HYPER.replace(average=1.0))
    jax.tree.map(np.testing.assert_array_equal, learner.agent.policy(after), after.actor)
    apart = after.replace(averaged=learner.start.actor)
    still = HYPER.replace(actor_lr=0.0, average=0.125)
    after, _ = learner.update(jax.random.key(0), apart, batch, still)
    share = 1.0 - 0.875 ** learner.agent.config.updates(HORIZON)
    jax.tree.map(
        lambda new, old, actor: np.testing.assert_allclose(new, old + share * (actor - old), atol=1e-6),
        learner.agent.policy(after), apart.averaged, apart.actor,
    )  # fmt: skip


def test_a_bandit_is_learnt(learner, blank_observation):
    """One step an episode; what is paid for is the twist as the world clips it."""
    best, shape = np.array([0.6, -0.4]), (HORIZON, EPISODES)
    observation = blank_observation(True, shape)
    ones = np.ones(shape, bool)

    def reward(twist):
        return -jnp.sum((jnp.clip(twist, -1.0, 1.0) - best) ** 2, axis=-1)

    @jax.jit
    def learnt(state):
        def step(state, key):
            twist = learner.agent.act(key, state, observation, HYPER).twist
            batch = Batch(
                observation=observation, next_observation=observation, twist=twist, request=jnp.zeros(shape, jnp.int32),
                reward=reward(twist), terminated=ones, ended=ones, steps=jnp.ones(shape, jnp.int32),
            )  # fmt: skip
            return learner.agent.update(key, state, batch, HYPER)[0], jnp.mean(batch.reward)

        return jax.lax.scan(step, state, jax.random.split(jax.random.key(1), 1000))

    state, rewards = learnt(learner.start)
    learnt_twist = learner.best_action(learner.agent.policy(state), blank_observation()).twist
    assert float(reward(learnt_twist)) > -0.02
    assert rewards[-20:].mean() > 0.3 * rewards[:20].mean()


@pytest.mark.parametrize(("field", "value"), [("horizon", 0), ("epochs", 1.5), ("minibatches", -1), ("encoder", "cnn")])
def test_bad_sizes_name_the_field(field, value):
    with pytest.raises(ValueError, match=f"agent.{field}.*(choose|give)"):
        PPOConfig(**{field: value})


def test_steps_that_cannot_be_parted_evenly_are_refused(batch):
    agent, odd = PPO(PPOConfig(minibatches=3)), batch.replace(reward=np.zeros((2, 5)))
    with pytest.raises(ValueError, match=r"agent.minibatches is 3: give a divisor of the batch's 10 steps"):
        agent.update(jax.random.key(0), None, odd, HYPER)


def test_twists_that_have_become_impossible_leave_numbers_finite():
    advantage, old = jnp.array([1.0, -1.0, 2.0]), jnp.array([-800.0, 800.0, 0.0])
    loss, slope = jax.value_and_grad(clipped_objective)(jnp.zeros(3), old, advantage, PPOHyperparameters())
    assert np.isfinite(loss) and np.isfinite(slope).all()
