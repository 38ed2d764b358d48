"""Lang_PreNet: what holds for one side holds for the other, and silence is silence. The actor's parts agree."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxnav.agents.hsac import HSAC, HSACConfig, HSACHyperparameters
from jaxnav.agents.losses.hsac import message_loss
from jaxnav.agents.networks import LOG_STD_RANGE, Actor, LangPreNet, message_codes
from jaxnav.language.table import default_table

TABLE = default_table()


@pytest.fixture(scope="module")
def agent():
    return HSAC(HSACConfig(actor_widths=(8,), critic_widths=(8,)))


@pytest.fixture(scope="module")
def actor(agent, blank_observation):
    return jax.jit(agent.init)(jax.random.key(0), blank_observation(), HSACHyperparameters()).actor


def test_the_other_side_swaps_right_and_left_exactly():
    net, words = LangPreNet(), jnp.asarray(TABLE.vectors())
    words = words[words[:, -1] != 0]
    params = net.init(jax.random.key(3), words[0])
    mirrored = words.at[:, -1].multiply(-1)
    (message, reply), (other, same_reply) = net.apply(params, words), net.apply(params, mirrored)
    np.testing.assert_allclose(np.asarray(message)[:, [0, 1, 3, 2]], other, rtol=1e-5)
    np.testing.assert_array_equal(reply, same_reply)
    np.testing.assert_allclose(np.exp(message).sum(axis=1), 1.0, rtol=1e-5)


def test_who_names_no_side_asks_for_none(agent, actor):
    words = jnp.asarray(TABLE.vectors())
    message, _ = agent.understand(actor, words[words[:, -1] == 0])
    np.testing.assert_array_equal(np.exp(message)[:, 2:], 0.0)


def test_silence_is_zero_whatever_the_parameters(agent, actor):
    silence = jnp.zeros((2, TABLE.vectors().shape[1]))
    heard = agent.actor_network.apply(actor, silence, method="listen")
    np.testing.assert_array_equal(heard, 0.0)
    message, reply = agent.understand(actor, silence)
    np.testing.assert_array_equal(np.exp(message), [[1, 0, 0, 0]] * 2)
    np.testing.assert_array_equal(np.exp(reply), [[1, 0, 0]] * 2)


def test_requests_are_the_messages():
    class Dialogue:
        message = jnp.array([0, 1, 2, 3])

    np.testing.assert_array_equal(message_codes(Dialogue), np.eye(4)[:, 1:])


def test_the_auxiliary_loss_teaches_what_phrases_mean(agent, actor):
    """Gradient descent on it alone: the phrases of the train split are understood, and most others with them."""
    hyper = HSACHyperparameters()

    @jax.jit
    def learn(actor, key):
        def step(actor, key):
            gradient = jax.grad(message_loss)(actor, key, agent.networks, agent._noisy_vocabulary(hyper))
            return jax.tree.map(lambda leaf, slope: leaf - 0.5 * slope, actor, gradient), None

        return jax.lax.scan(step, actor, jax.random.split(key, 2000))[0]

    message, reply = jax.device_get(agent.understand(learn(actor, jax.random.key(1)), jnp.asarray(TABLE.vectors())))
    for split, least in (("train", 0.97), ("validation", 0.88)):
        here = [i for i, phrase in enumerate(TABLE.phrases) if phrase.split == split]
        understood = np.mean([message[i].argmax() == TABLE.phrases[i].message for i in here])
        answered = np.mean([reply[i].argmax() == TABLE.phrases[i].reply for i in here])
        assert understood > least and answered > least, (split, understood, answered)


@pytest.mark.parametrize("per_request", [False, True])
def test_parts_of_an_actor_are_the_whole_and_those_not_called_have_no_parameters(random_observation, per_request):
    seen = random_observation(np.random.default_rng(0), (5,))
    heard = message_codes(seen.dialogue)
    plain = Actor("lidar", (8,), per_request=per_request)
    heads = {
        "steer": {"mean_head"},
        "gaussian": {"mean_head", "log_std_head"},
        "act": {"mean_head", "log_std_head", "request_head"},
    }

    @jax.jit
    def applied(key):
        own = {name: plain.init(key, seen, heard, method=name) for name in heads}
        wide = jax.tree.map(lambda leaf: 5 * leaf, own["act"])
        parts = {name: plain.apply(wide, seen, heard, method=name) for name in heads}
        return own, parts

    own, parts = applied(jax.random.key(0))
    for name, called in heads.items():
        assert set(own[name]["params"]) == called | {"state_encoder", "body"}
    mean, log_std, logits = parts["act"]
    assert mean.shape == log_std.shape == ((5, 4, 2) if per_request else (5, 2)) and logits.shape == (5, 4)
    low, high = LOG_STD_RANGE
    assert (log_std >= low).all() and (log_std <= high).all()
    np.testing.assert_allclose(parts["steer"], mean, atol=1e-6)
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, atol=1e-6), parts["gaussian"], (mean, log_std))
    assert np.abs(mean).max() > 1
