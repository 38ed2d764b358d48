"""Lang_PreNet: what holds for one side holds for the other, and silence is silence."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxnav import Params, World, WorldConfig
from jaxnav.agents.hsac import HSAC, HSACConfig, Hyperparameters
from jaxnav.agents.networks import LangPreNet, message_codes
from jaxnav.language.table import default_table

TABLE = default_table()


@pytest.fixture(scope="module")
def agent():
    return HSAC(HSACConfig(actor_widths=(8,), critic_widths=(8,)))


@pytest.fixture(scope="module")
def actor(agent):
    world = World(WorldConfig(beams=4))
    shapes = jax.eval_shape(lambda key: world.observe(world.reset(key, Params()), Params()), jax.random.key(0))
    zeros = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), shapes)
    return jax.jit(agent.init)(jax.random.key(0), zeros, Hyperparameters()).actor


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
    heard = agent.actor.apply(actor, silence, method="listen")
    np.testing.assert_array_equal(heard, 0.0)
    message, reply = agent.understand(actor, silence)
    np.testing.assert_array_equal(np.exp(message), [[1, 0, 0, 0]] * 2)
    np.testing.assert_array_equal(np.exp(reply), [[1, 0, 0]] * 2)


def test_codes_are_the_messages():
    class Dialogue:
        message = jnp.array([0, 1, 2, 3])

    np.testing.assert_array_equal(message_codes(Dialogue), np.eye(4)[:, 1:])


def test_the_auxiliary_loss_teaches_what_phrases_mean(agent, actor):
    """Gradient descent on it alone: the phrases of the train split are understood, and most others with them."""
    hyper = Hyperparameters()

    @jax.jit
    def learn(actor, key):
        def step(actor, key):
            gradient = jax.grad(agent._message_loss)(actor, key, hyper)
            return jax.tree.map(lambda leaf, slope: leaf - 0.5 * slope, actor, gradient), None

        return jax.lax.scan(step, actor, jax.random.split(key, 2000))[0]

    message, reply = jax.device_get(agent.understand(learn(actor, jax.random.key(1)), jnp.asarray(TABLE.vectors())))
    for split, least in (("train", 0.97), ("validation", 0.88)):
        here = [i for i, phrase in enumerate(TABLE.phrases) if phrase.split == split]
        understood = np.mean([message[i].argmax() == TABLE.phrases[i].message for i in here])
        answered = np.mean([reply[i].argmax() == TABLE.phrases[i].reply for i in here])
        assert understood > least and answered > least, (split, understood, answered)
