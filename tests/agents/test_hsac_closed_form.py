"""Hybrid soft actor-critic where the optimum is known: a bandit, in closed form, and two states, as a fixed point."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.optimize
import scipy.special

from jaxnav.agents.distributions import twist_log_density
from jaxnav.agents.hsac import HEADS, HSAC, HSACConfig, HSACHyperparameters
from jaxnav.agents.learner import Batch
from jaxnav.agents.losses.hsac import soft_value

ALPHA = {"twist": 0.1, "request": 0.2}
HYPER = HSACHyperparameters(
    actor_lr=3e-3, critic_lr=3e-3, temperature_lr=0.0, discount=0.8, tau=0.05, average=0.05, reward_scale=1.0
)
ROWS, UPDATES, BATCH = 20_000, 2500, 128


class Learning:
    """An agent, and its training on transitions between two states that differ in the speed the robot has.

    In state 1 no request counts. Transitions: dict of `[ROWS]` state, twist `[2]`, request, reward, after, terminated.
    """

    def __init__(self, heads, blank_observation):
        self.agent = HSAC(HSACConfig(heads=heads, language="codes", actor_widths=(32,), critic_widths=(64, 64)))
        self.blank = blank_observation
        self.train = jax.jit(self._train)

    def at(self, state):
        """Observations of states `[...]`."""
        twist = jnp.stack([state, jnp.zeros_like(state)], axis=-1).astype(jnp.float32)
        return self.blank(True, state.shape).replace(twist=twist, may_request=state == 0)

    def start(self):
        """A learner whose temperatures are known, and stay."""
        learner = self.agent.init(jax.random.key(0), self.blank(), HYPER)
        return learner.replace(log_temperatures=jax.tree.map(lambda alpha: jnp.float32(np.log(alpha)), ALPHA))

    def batch(self, transitions):
        """The same transitions as a `Batch`."""
        return Batch(
            observation=self.at(transitions["state"]), next_observation=self.at(transitions["after"]),
            twist=transitions["twist"], request=transitions["request"], reward=transitions["reward"],
            terminated=transitions["terminated"], ended=transitions["terminated"],
            steps=jnp.ones_like(transitions["request"]),
        )  # fmt: skip

    def _train(self, transitions):
        def step(learner, key_and_index):
            key, index = key_and_index
            key_rows, key_update = jax.random.split(key)
            rows = jax.random.randint(key_rows, (BATCH,), 0, ROWS)
            batch = self.batch(jax.tree.map(lambda leaf: leaf[rows], transitions))
            return self.agent.update(key_update, learner, batch, HYPER, 1.0 - index / UPDATES)[0], None

        keys = jax.random.split(jax.random.key(1), UPDATES)
        return jax.lax.scan(step, self.start(), (keys, jnp.arange(UPDATES)))[0]

    def policy(self, learner, observation):
        """Mean, log_std and logits of what is evaluated."""
        silence = jnp.zeros((*observation.seen.shape, 3))
        return self.agent.actor_network.apply(self.agent.policy(learner), observation, silence)


@pytest.fixture(scope="module", params=HEADS)
def learning(request, blank_observation):
    return Learning(request.param, blank_observation)


def transitions(rng, states, mean, log_std, gains, after=None):
    """Any twist and request in any of the states: the reward is alpha log p(twist) + gain[state, request].

    mean, log_std: of p, for each state and request `[states, requests, 2]`; after: the next state of each, or the end.
    """
    state = rng.integers(0, states, ROWS)
    request = np.where(state == 0, rng.integers(0, 4, ROWS), 0)
    twist = np.tanh(rng.normal(size=(ROWS, 2)))
    wanted = twist_log_density(jnp.asarray(twist), mean[state, request], log_std[state, request])
    return {
        "state": state, "twist": np.float32(twist), "request": request,
        "reward": ALPHA["twist"] * wanted + np.float32(gains[state, request]),
        "after": state if after is None else after[state, request], "terminated": np.full(ROWS, after is None),
    }  # fmt: skip


def test_a_bandit_is_learnt_up_to_its_closed_form(learning):
    """One step, Q(a, d) = alpha log p_d(a) + g(d), is best under pi_d = p_d and softmax(g / alpha of the request)."""
    mean = np.array([[0.5, -0.3], [-0.6, 0.2], [0.1, 0.7], [-0.2, -0.5]])
    log_std = np.array([[-0.8, -0.4], [-1.0, -0.6], [-0.5, -1.0], [-0.7, -0.9]])
    if learning.agent.config.heads == "shared":
        mean, log_std = mean[:1], log_std[:1]
    gains = np.array([[0.0, 0.3, -0.2, 0.1]])
    every_request = (np.broadcast_to(table, (1, 4, 2)) for table in (mean, log_std))
    learner = learning.train(transitions(np.random.default_rng(0), 1, *every_request, gains))
    learnt_mean, learnt_log_std, logits = learning.policy(learner, learning.at(jnp.int32(0)))
    p = scipy.special.softmax(gains[0] / ALPHA["request"])
    np.testing.assert_allclose(jnp.atleast_2d(learnt_mean), mean, atol=0.1)
    np.testing.assert_allclose(jnp.exp(jnp.atleast_2d(learnt_log_std)), np.exp(log_std), rtol=0.2)
    np.testing.assert_allclose(jax.nn.softmax(logits), p, atol=0.05)


def test_two_states_have_their_exact_soft_values(learning):
    """Nothing ends here: the values are those of the bootstrap alone. A twist that can be as it is wanted adds nothing
    to them."""
    mean = np.array([[0.5, -0.3], [-0.4, 0.2]])[:, None].repeat(4, axis=1)
    log_std = np.broadcast_to([-0.6, -0.4], mean.shape)
    gains = np.array([[0.9, 0.5, 1.3, 0.8], [0.3, 0.0, 0.0, 0.0]])
    after = np.array([[0, 0, 1, 1], [0, 0, 0, 0]])

    def improved(value):
        q = gains + HYPER.discount * value[after]
        of_requests = ALPHA["request"] * (scipy.special.logsumexp(q[0] / ALPHA["request"]) - np.log(4))
        return np.array([of_requests, q[1, 0]])

    exact = scipy.optimize.fixed_point(improved, np.zeros(2), method="iteration", maxiter=1000)
    learner = learning.train(transitions(np.random.default_rng(0), 2, mean, log_std, gains, after))
    networks = learning.agent.networks
    states = learning.at(jnp.repeat(jnp.arange(2), 4000))
    twist, log_density, log_p = networks.sample(jax.random.key(2), learning.policy(learner, states), states.may_request)
    q = networks.q(learner.critic, states, twist).min(axis=0)
    value = soft_value(q, log_density, log_p, states.may_request, ALPHA)
    np.testing.assert_allclose(value.reshape(2, -1).mean(axis=1), exact, rtol=0.02)
