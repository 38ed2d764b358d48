"""The learner: its losses against their definitions, and a bandit whose optimum is known in closed form."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxnav import Params, World, WorldConfig
from jaxnav.agents.distributions import code_log_probabilities, twist_log_density
from jaxnav.agents.hsac import HSAC, Batch, HSACConfig, Hyperparameters, soft_value

AGENT = HSAC(HSACConfig(actor_widths=(64,), critic_widths=(64, 64)))
init, update = jax.jit(AGENT.init), jax.jit(AGENT.update)


def blank_observation(may_request, batch=()):
    """An observation of zeros: a bandit's only state."""
    world = World(WorldConfig(beams=4))
    shapes = jax.eval_shape(lambda key: world.observe(world.reset(key, Params()), Params()), jax.random.key(0))
    zeros = jax.tree.map(lambda leaf: jnp.zeros((*batch, *leaf.shape), leaf.dtype), shapes)
    return zeros.replace(may_request=jnp.full(batch, may_request))


def random_batch(key, size, may_request=True, terminated=0.0):
    keys = jax.random.split(key, 4)
    observation = jax.tree.map(jnp.array, blank_observation(may_request, (size,)))
    scan = jax.random.uniform(keys[0], (size, 4), maxval=5.0)
    return Batch(
        observation=observation.replace(scan=scan), next_observation=observation.replace(scan=scan[::-1]),
        twist=jnp.tanh(jax.random.normal(keys[1], (size, 2))), code=jax.random.randint(keys[2], (size,), 0, 4),
        reward=100 * jax.random.normal(keys[3], (size,)), terminated=jnp.full(size, terminated),
    )  # fmt: skip


def test_bandit_learns_the_closed_form_optimum():
    """One step, Q(a, d) = alpha_c log p*(a) + g(d): the optimum is pi = p* and p = softmax(g / alpha_d)."""
    alpha, mean, log_std = 0.3, jnp.array([0.5, -0.3]), jnp.array([-0.8, -0.4])
    gain = jnp.array([0.0, 0.3, -0.2, 0.1])
    hyper = Hyperparameters(temperature_lr=0.0, initial_temperature=alpha, reward_scale=1.0, tau=0.05)
    batch = 256
    observation = blank_observation(True, (batch,))

    def step(state, key_and_index):
        key, index = key_and_index
        key_twist, key_code, key_update = jax.random.split(key, 3)
        twist = jnp.tanh(1.2 * jax.random.normal(key_twist, (batch, 2)))
        code = jax.random.randint(key_code, (batch,), 0, 4)
        reward = alpha * twist_log_density(twist, mean, log_std) + gain[code]
        data = Batch(
            observation=observation, next_observation=observation, twist=twist, code=code, reward=reward,
            terminated=jnp.ones(batch),
        )  # fmt: skip
        return AGENT.update(key_update, state, data, hyper, 1.0 - index / 2500)[0], None

    @jax.jit
    def train(key):
        state = AGENT.init(key, blank_observation(True), hyper)
        return jax.lax.scan(step, state, (jax.random.split(key, 2500), jnp.arange(2500)))[0]

    actor = train(jax.random.key(0)).actor
    silence = jnp.zeros((1, 3))
    learnt_mean, learnt_log_std, logits = AGENT.actor.apply(actor, blank_observation(True), silence, method="act")
    np.testing.assert_allclose(learnt_mean, mean, atol=0.1)
    np.testing.assert_allclose(jnp.exp(learnt_log_std), jnp.exp(log_std), rtol=0.2)
    np.testing.assert_allclose(jax.nn.softmax(logits), jax.nn.softmax(gain / alpha), atol=0.05)


def test_soft_value_is_the_sum_over_codes():
    rng = np.random.default_rng(0)
    q, logits = rng.normal(size=(2, 4)), rng.normal(size=(2, 4))
    log_density = np.array([0.4, -1.1])
    temperatures = {"twist": 0.2, "code": 0.7}
    counts = jnp.array([True, False])
    value = soft_value(
        jnp.array(q), jnp.array(log_density), code_log_probabilities(jnp.array(logits), counts), counts, temperatures
    )
    p = np.exp(logits[0]) / np.exp(logits[0]).sum()
    with_code = sum(p[k] * (q[0, k] - 0.7 * np.log(p[k]) - 0.2 * 0.4) for k in range(4)) - 0.7 * np.log(4)
    np.testing.assert_allclose(value, [with_code, q[1, 0] + 0.2 * 1.1], rtol=1e-5)


@pytest.mark.parametrize("terminated", [1.0, 0.0])
def test_only_terminated_transitions_do_not_bootstrap(terminated):
    hyper = Hyperparameters()
    batch = random_batch(jax.random.key(0), 8, terminated=terminated)
    state = init(jax.random.key(1), blank_observation(True), hyper)
    temperatures = jax.tree.map(jnp.exp, state.log_temperatures)
    bootstrap = jax.jit(AGENT._target)
    target = bootstrap(jax.random.key(2), state, batch, temperatures, hyper)
    assert np.allclose(target, 0.01 * batch.reward, rtol=1e-6) == bool(terminated)
    no_future = bootstrap(jax.random.key(2), state, batch, temperatures, hyper.replace(discount=0.0))
    np.testing.assert_allclose(no_future, 0.01 * batch.reward, rtol=1e-6)


def updated(hyper, may_request=True, updates=3):
    state = init(jax.random.key(1), blank_observation(True), hyper)
    for i in range(updates):
        state, metrics = update(jax.random.key(i), state, random_batch(jax.random.key(i), 32, may_request), hyper)
    return state, metrics


@pytest.mark.parametrize("name", ["twist", "code"])
def test_temperature_rises_while_entropy_is_below_its_target(name):
    entropy_field = f"target_entropy_{name}"
    high = updated(Hyperparameters(**{entropy_field: 50.0}))[0].log_temperatures[name]
    low = updated(Hyperparameters(**{entropy_field: -50.0}))[0].log_temperatures[name]
    assert float(high) > np.log(0.05) > float(low)


def test_where_no_code_counts_its_temperature_rests():
    state, metrics = updated(Hyperparameters(), may_request=False)
    assert float(state.log_temperatures["code"]) == pytest.approx(np.log(0.05))
    assert float(metrics["code_entropy"]) == 0.0


def test_update_changes_everything_and_targets_by_tau():
    hyper = Hyperparameters(tau=0.25)
    before = init(jax.random.key(1), blank_observation(True), hyper)
    after, _ = update(jax.random.key(0), before, random_batch(jax.random.key(0), 32), hyper)
    expected = jax.tree.map(lambda old, new: old + 0.25 * (new - old), before.critic, after.critic)
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, atol=1e-7), after.target_critic, expected)
    for name in ("actor", "critic"):
        moved = [bool((a != b).any()) for a, b in zip(*map(jax.tree.leaves, (before[name], after[name])), strict=True)]
        # The pedestrian embedding of a zero observation sits behind a ReLU; everything else must move.
        assert np.mean(moved) > 0.8


def test_learning_rates_scale_the_step():
    """Adam's first step is the learning rate times the sign of the gradient, so twice the rate is twice the step."""
    batch = random_batch(jax.random.key(0), 32)
    before = init(jax.random.key(1), blank_observation(True), Hyperparameters())

    def step(**rates):
        after, _ = update(jax.random.key(0), before, batch, Hyperparameters(**rates))
        return jax.tree.map(lambda a, b: a - b, after.critic, before.critic)

    jax.tree.map(
        lambda one, two: np.testing.assert_allclose(2 * one, two, atol=1e-6), step(critic_lr=1e-3), step(critic_lr=2e-3)
    )
    assert max(float(jnp.abs(leaf).max()) for leaf in jax.tree.leaves(step(critic_lr=0.0))) == 0.0


def test_act_and_best_action_keep_silent_where_codes_do_not_count():
    state, _ = updated(Hyperparameters(), updates=1)
    for may_request in (True, False):
        observation = blank_observation(may_request, (512,))
        codes = np.asarray(AGENT.act(jax.random.key(0), state.actor, observation, Hyperparameters()).code)
        assert (codes > 0).any() == may_request
    loud = jax.tree.map(lambda leaf: leaf, state.actor)
    loud["params"]["code_head"]["bias"] = jnp.array([0.0, 9.0, 0.0, 0.0])
    assert int(AGENT.best_action(loud, blank_observation(True)).code) == 1
    assert int(AGENT.best_action(loud, blank_observation(True), voice=False).code) == 0
    assert int(AGENT.best_action(loud, blank_observation(False)).code) == 0


def test_policy_does_not_depend_on_how_many_pedestrians_are_seen():
    """Parameters fit any number, and the order of the pedestrians is of no consequence."""
    state, _ = updated(Hyperparameters(), updates=1)
    world = World(WorldConfig(beams=4, pedestrians=6))
    observation = world.observe(world.reset(jax.random.key(0), Params()), Params())
    assert observation.pedestrians.shape == (4, 4)
    flipped = observation.replace(
        pedestrians=observation.pedestrians[::-1], dialogue=jax.tree.map(lambda leaf: leaf[::-1], observation.dialogue)
    )
    one, two = (AGENT.best_action(state.actor, seen).twist for seen in (observation, flipped))
    np.testing.assert_allclose(one, two, atol=1e-6)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("encoder", "cnn"),
        ("language", "latin"),
        ("batch", 0),
        ("updates_per_step", -1),
        ("actor_widths", ()),
        ("huber_delta", float("nan")),
    ],
)
def test_bad_sizes_name_the_field(field, value):
    with pytest.raises(ValueError, match=f"agent.{field}.*(choose|give)"):
        HSACConfig(**{field: value})
