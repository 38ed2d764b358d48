"""Each request has its own twist and its own values: no gradient leaks from one request to another."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxnav.agents.hsac import HEADS, HSAC, HSACConfig, HSACHyperparameters
from jaxnav.agents.losses.hsac import actor_loss, critic_loss

SIZES = {"language": "codes", "actor_widths": (16,), "critic_widths": (16,)}
HYPER = HSACHyperparameters()
CHOICES = 4


@pytest.fixture(scope="module", params=HEADS)
def agent(request):
    return HSAC(HSACConfig(heads=request.param, **SIZES))


@pytest.fixture(scope="module")
def learner(agent, blank_observation):
    return jax.jit(agent.init)(jax.random.key(0), blank_observation(), HYPER)


@pytest.fixture(scope="module")
def temperatures():
    return {"twist": jnp.float32(0.3), "request": jnp.float32(0.2)}


@pytest.fixture(scope="module")
def batch(random_batch):
    return random_batch(np.random.default_rng(0), (16,))


def biased(actor, **biases):
    """An actor whose ``biases`` of heads are what they say, whatever it sees."""
    params = dict(actor["params"])
    for head, bias in biases.items():
        kernel = params[head]["kernel"]
        params[head] = {"kernel": jnp.zeros_like(kernel), "bias": jnp.broadcast_to(jnp.ravel(bias), kernel.shape[1:])}
    return {"params": params}


def of_requests(head):
    """Largest slope of each request `[CHOICES]` in the gradient of a head."""
    slopes = np.concatenate([head["kernel"], head["bias"][None]])
    return np.abs(slopes.reshape(len(slopes), CHOICES, -1)).max(axis=(0, 2))


def test_critics_learn_of_the_request_that_was_spoken_alone(agent, learner, batch, temperatures):

    @jax.jit
    def slope(critic, batch):
        given = agent.networks, learner.target_critic, learner.actor, batch, temperatures, HYPER, 2.0
        return jax.grad(critic_loss, has_aux=True)(critic, jax.random.key(1), *given)

    for request in range(CHOICES):
        spoken = batch.replace(request=np.full(16, request, np.int32))
        gradient, _ = slope(learner.critic, spoken)
        for head in ("Dense_0", "Dense_1"):
            np.testing.assert_array_equal(of_requests(gradient["params"][head]) > 0, np.arange(CHOICES) == request)


def test_a_twist_is_learnt_of_its_own_request_alone(blank_observation, batch, temperatures):
    """With all probability on one request, or on none where no request counts, no other twist is judged."""
    agent = HSAC(HSACConfig(heads="per-request", **SIZES))
    learner = jax.jit(agent.init)(jax.random.key(0), blank_observation(), HYPER)

    @jax.jit
    def slope(actor, batch):
        given = agent.networks, learner.critic, batch, None, temperatures, HYPER
        return jax.grad(actor_loss, has_aux=True)(actor, jax.random.key(1), *given)

    for may_request in (True, False):
        asked = batch.replace(observation=batch.observation.replace(may_request=np.full(16, may_request)))
        for request in range(CHOICES):
            certain = biased(learner.actor, request_head=jnp.where(jnp.arange(CHOICES) == request, 60.0, 0.0))
            gradient, _ = slope(certain, asked)
            alone = request if may_request else 0
            for head in ("mean_head", "log_std_head"):
                slopes = of_requests(gradient["params"][head])
                assert slopes[alone] > 1e-4
                assert np.delete(slopes, alone).max() < 1e-12


def test_the_critics_are_asked_of_every_request_with_its_own_twist(agent, learner, batch):
    """Q of a request is what they say of it with that twist for all, whatever the other requests' twists."""
    twists = np.float32(np.random.default_rng(1).uniform(-1, 1, (16, CHOICES, 2)))
    judge = jax.jit(agent.networks.q)
    q = judge(learner.critic, batch.observation, twists)
    for request in range(CHOICES):
        alone = judge(learner.critic, batch.observation, twists[:, request])
        np.testing.assert_allclose(q[:, :, request], alone[:, :, request], atol=1e-6)
        assert np.abs(q - alone).max() > 1e-3


def test_the_twist_is_that_of_the_request(agent, learner, blank_observation):
    """In both actions, to learn from and best; one for all requests if they share a head."""
    mean = np.float32([[0.8, -0.5], [-0.3, 0.2], [0.1, 0.9], [-1.0, -0.2]])
    if agent.config.heads == "shared":
        mean = mean[:1]
    expected = np.tanh(np.broadcast_to(mean, (CHOICES, 2)))
    steady = biased(learner.actor, mean_head=mean, log_std_head=-9.0, request_head=np.zeros(CHOICES))
    action = jax.jit(agent.act)(
        jax.random.key(0), learner.replace(actor=steady), blank_observation(True, (256,)), HYPER
    )
    assert set(np.unique(action.request)) == set(range(CHOICES))
    np.testing.assert_allclose(action.twist, expected[action.request], atol=0.03)

    best = jax.jit(agent.best_action)
    for request in range(CHOICES):
        loud = biased(steady, request_head=np.arange(CHOICES) == request)
        for may_request, voice in ((True, True), (True, False), (False, True)):
            spoken = request if may_request and voice else 0
            action = best(loud, blank_observation(may_request), voice)
            assert action.request == spoken
            np.testing.assert_allclose(action.twist, expected[spoken], atol=1e-6)


def test_who_knows_two_requests_asks_to_stop_at_most(blank_observation, random_batch):
    agent = HSAC(HSACConfig(requests=2, **SIZES))
    learner = jax.jit(agent.init)(jax.random.key(0), blank_observation(), HYPER)
    action = jax.jit(agent.act)(jax.random.key(0), learner, blank_observation(True, (256,)), HYPER)
    assert set(np.unique(action.request)) == {0, 1}
    # Uniform requests have all the entropy there is, and a target of 0.9 of it is met.
    even = learner.replace(actor=biased(learner.actor, request_head=np.zeros(2)))
    batch = random_batch(np.random.default_rng(0), (16,), requests=2)
    after, metrics = jax.jit(agent.update)(jax.random.key(0), even, batch, HYPER.replace(target_entropy_request=0.9))
    assert float(metrics["request_entropy"]) == pytest.approx(np.log(2))
    assert float(after.log_temperatures["request"]) < np.log(0.05)
