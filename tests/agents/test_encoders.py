"""The paper's network on grid maps: its numbers are torch's, what is frozen stays; any learner takes any encoder."""

import dataclasses
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import torch
from flax import linen as nn
from hypothesis import given
from hypothesis import strategies as st

from jaxnav import Params, World, WorldConfig
from jaxnav.agents import LEARNERS
from jaxnav.agents.encoders import ENCODERS, GRID_PARTS, GridEncoder
from jaxnav.agents.features import approach_features
from jaxnav.agents.networks import message_codes
from jaxnav.training.config import TrainConfig, make_agent, preset, resolve
from jaxnav.training.loop import Trainer

SMALL = {"channels_1": 3, "channels_2": 5, "channels_3": 6, "features": 16, "dialogue": 4}


@pytest.fixture(scope="module")
def observations():
    """Observations `[2]` of the grid encoders."""
    world = World(WorldConfig(observation=GRID_PARTS, beams=24, pedestrians=2))

    def observe(key):
        return world.observe(world.reset(key, Params()), Params())

    return jax.jit(jax.vmap(observe))(jax.random.split(jax.random.key(3), 2))


def images(params, observations):
    """Img_PreNet in torch: convolution, ReLU, 2 x 2 maximum, three times, and a layer."""
    maps = np.concatenate([np.asarray(observations.sensor_map)[:, None], np.asarray(observations.pedestrian_map)], 1)
    x = torch.from_numpy(maps)
    for i in range(3):
        kernel, bias = (torch.from_numpy(np.array(params[f"Conv_{i}"][name])) for name in ("kernel", "bias"))
        x = torch.nn.functional.conv2d(x, kernel.permute(3, 2, 0, 1), bias, padding=1)
        x = torch.nn.functional.max_pool2d(torch.relu(x), 2)
    x = x.permute(0, 2, 3, 1).reshape(len(maps), -1)  # as flax orders them
    kernel, bias = (torch.from_numpy(np.array(params["Dense_0"][name])) for name in ("kernel", "bias"))
    return torch.relu(x @ kernel + bias)


def test_img_pre_net_computes_what_torch_computes(observations):
    encoder = GridEncoder(**SMALL)
    heard = message_codes(observations.dialogue)
    params = jax.jit(encoder.init)(jax.random.key(0), observations, heard)
    _, inside = encoder.apply(params, observations, heard, capture_intermediates=True)
    image = nn.relu(inside["intermediates"]["Dense_0"]["__call__"][0])
    np.testing.assert_allclose(image, images(params["params"], observations).numpy(), atol=2e-6)
    assert np.ptp(np.asarray(observations.sensor_map), axis=(1, 2)).min() > 0


@pytest.mark.parametrize("frozen", [True, False])
def test_frozen_convolutions_have_no_gradient_and_the_rest_has(observations, frozen):
    encoder = GridEncoder(frozen=frozen, **SMALL)
    heard = message_codes(observations.dialogue)
    params = jax.jit(encoder.init)(jax.random.key(0), observations, heard)
    weights = jax.random.normal(jax.random.key(1), (SMALL["features"],))
    gradient = jax.grad(lambda p: jnp.sum(encoder.apply(p, observations, heard) * weights))(params)["params"]
    for i in range(3):
        assert bool((gradient[f"Conv_{i}"]["kernel"] == 0).all()) == frozen
    assert bool((gradient["Dense_0"]["kernel"] == 0).all()) == frozen
    assert not (gradient["MLP_1"]["Dense_0"]["kernel"] == 0).all()


def test_a_leading_axis_more_or_less_is_the_same(observations):
    encoder = GridEncoder(**SMALL)
    heard = message_codes(observations.dialogue)
    params = jax.jit(encoder.init)(jax.random.key(0), observations, heard)
    many = encoder.apply(params, observations, heard)
    one = encoder.apply(params, jax.tree.map(lambda leaf: leaf[0], observations), heard[0])
    deep = encoder.apply(params, jax.tree.map(lambda leaf: leaf[None], observations), heard[None])
    assert one.shape == (SMALL["features"],)
    np.testing.assert_allclose(many[0], one, atol=1e-6)
    np.testing.assert_allclose(many, deep[0], atol=1e-6)


@pytest.mark.parametrize("encoder", ["lidar", "lidar-approach", "grid"])
def test_rows_of_nobody_do_not_count(encoder, observations):
    """What is seen of one pedestrian is the same in a world that has room for three."""
    one = jax.tree.map(lambda leaf: leaf[0, :1] if leaf.ndim > 1 and leaf.shape[1] == 2 else leaf[0], observations)
    if encoder != "grid":
        one = one.replace(scan=jnp.linspace(0.5, 4.0, 24), pedestrians=jnp.ones((1, 4)), seen=jnp.ones(1, bool))
    one = one.replace(dialogue=one.dialogue.replace(is_open=jnp.ones(1, jnp.int32)))

    def pad(leaf):
        return jnp.concatenate([leaf, jnp.zeros((2, *leaf.shape[1:]), leaf.dtype)])

    three = one.replace(dialogue=jax.tree.map(pad, one.dialogue))
    if encoder != "grid":
        three = three.replace(pedestrians=pad(one.pedestrians), seen=pad(one.seen))
    net = ENCODERS[encoder].build(tuple(SMALL.values()) if encoder == "grid" else ())
    weights = jax.jit(net.init)(jax.random.key(0), one, message_codes(one.dialogue))
    # Biases begin as zeros, and then the rows of nobody have no voice anyway.
    rng = np.random.default_rng(1)
    weights = jax.tree.map(lambda leaf: leaf + 0.3 * rng.normal(size=leaf.shape).astype(np.float32), weights)
    apply = jax.jit(net.apply)
    features = [apply(weights, seen, message_codes(seen.dialogue)) for seen in (one, three)]
    np.testing.assert_allclose(*features, atol=1e-6)
    if encoder != "grid":  # who is out of sight, but speaks, counts
        hidden = one.replace(seen=jnp.zeros(1, bool), pedestrians=jnp.zeros((1, 4)))
        silent = jax.tree.map(jnp.zeros_like, one.dialogue)
        speaks = silent.replace(utterance=jnp.full_like(silent.utterance, 5))
        a, b = (apply(weights, hidden.replace(dialogue=talk), message_codes(talk)) for talk in (speaks, silent))
        assert np.abs(a - b).max() > 1e-3


finite = st.floats(-5.0, 5.0, width=32)


@given(st.tuples(finite, finite), st.tuples(finite, finite), st.tuples(finite, finite), st.floats(0.0, 0.6))
def test_the_closest_approach_is_that_of_two_who_are_driven_there(place, velocity, goal, speed):
    """Against both moved along in steps of 6 ms, for each of the robot's four ways to go on."""
    pose = jnp.zeros((3, 3)).at[2, :2].set(jnp.array(goal))
    person = jnp.array([[*place, *np.divide(velocity, 5)]], jnp.float32)
    observation = SimpleNamespace(pedestrians=person, pose=pose, twist=jnp.array([speed, 0.3]), seen=jnp.ones(1, bool))
    found = np.asarray(approach_features(observation), np.float64).reshape(4, 3)
    to_goal = np.array(goal) / max(np.hypot(*goal), 1e-6)
    t = np.linspace(0.0, 6.0, 1001)[:, None]
    for row, own in zip(found, ([speed, 0.0], [0.6, 0.0], 0.6 * to_goal, [0.0, 0.0]), strict=True):
        gap = np.hypot(*(np.array(place) + t * (np.array(velocity) / 5 - np.array(own))).T)
        time, nearest = 4 * row[0], gap.min()
        assert row[1] == pytest.approx(min(nearest, 2.0) / 2, abs=6e-3)
        # Where the gap hardly changes the time is open: what it is at the time that is given, is not.
        assert np.interp(time, t[:, 0], gap) == pytest.approx(nearest, abs=1e-2)
        danger = np.exp(-0.5 * time - 3 * max(nearest - 0.3, 0.0))
        assert row[2] == pytest.approx(danger, abs=3e-2)


def test_who_is_not_in_sight_approaches_nobody():
    observation = SimpleNamespace(
        pedestrians=jnp.zeros((2, 3, 4)), pose=jnp.zeros((2, 3, 3)), twist=jnp.full((2, 2), 0.5),
        seen=jnp.array([[False, True, False]] * 2),
    )  # fmt: skip
    features = np.asarray(approach_features(observation))
    assert features.shape == (2, 3, 12) and (features[:, [0, 2]] == 0).all()
    np.testing.assert_allclose(features[:, 1], np.tile([0.0, 0.0, 1.0], (2, 4)), atol=1e-5)  # where the robot is


@pytest.mark.parametrize("encoder", ENCODERS)
@pytest.mark.parametrize("algo", LEARNERS)
def test_any_learner_takes_any_encoder(algo, encoder):
    """Traced, not run: shapes and types of a chunk's result are those of its beginning, so that it goes on."""
    base = preset("quick" if encoder.startswith("lidar") else encoder, algo)
    base = dataclasses.replace(base, agent=dataclasses.replace(base.agent, encoder=encoder))
    train = TrainConfig(episodes=8, replay_rows=10, steps_per_chunk=25, total_steps=25)
    config = resolve(dataclasses.replace(base, train=train))
    assert config.agent.encoder == encoder
    trainer = Trainer(config.world.world(), make_agent(config), config.world.params, config.train)
    hyper = jax.tree.map(jnp.float32, config.hyper)
    start = jax.eval_shape(lambda: trainer.init(jax.random.key(0), hyper))
    end, metrics = jax.eval_shape(trainer.train_chunk, start, hyper)
    assert jax.tree.structure(start) == jax.tree.structure(end)
    assert [(a.shape, a.dtype) for a in jax.tree.leaves(start)] == [(a.shape, a.dtype) for a in jax.tree.leaves(end)]
    assert {"critic_loss", "actor_loss", "q", "reward", "finite"} <= metrics.keys()
