"""The learner's update against its definitions: values, bootstraps, temperatures, rates, averages; and its sizes."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxnav.agents.distributions import request_log_probabilities
from jaxnav.agents.hsac import HSAC, HSACConfig, HSACHyperparameters
from jaxnav.agents.losses.hsac import critic_loss, soft_value

SIZES = {"actor_widths": (16,), "critic_widths": (16, 16)}
AGENT = HSAC(HSACConfig(**SIZES))
init, update, act, best_action = map(jax.jit, (AGENT.init, AGENT.update, AGENT.act, AGENT.best_action))


@pytest.fixture(scope="module")
def fresh(blank_observation):
    return init(jax.random.key(1), blank_observation(), HSACHyperparameters())


@pytest.fixture(scope="module")
def batch(random_batch):
    return random_batch(np.random.default_rng(0), (32,))


def assert_close(a, b, **tolerance):
    jax.tree.map(lambda x, y: np.testing.assert_allclose(x, y, **tolerance), a, b)


def test_soft_value_is_the_sum_over_requests():
    rng = np.random.default_rng(0)
    q, logits = rng.normal(size=(2, 4)), rng.normal(size=(2, 4))
    temperatures = {"twist": 0.2, "request": 0.7}
    counts = jnp.array([True, False])
    log_p = request_log_probabilities(jnp.array(logits), counts)
    p = np.exp(logits[0]) / np.exp(logits[0]).sum()

    one_twist = np.array([[0.4], [-1.1]])
    with_request = sum(p[k] * (q[0, k] - 0.7 * np.log(p[k]) - 0.2 * 0.4) for k in range(4)) - 0.7 * np.log(4)
    value = soft_value(jnp.array(q), jnp.array(one_twist), log_p, counts, temperatures)
    np.testing.assert_allclose(value, [with_request, q[1, 0] + 0.2 * 1.1], rtol=1e-5)

    own = rng.normal(size=(2, 4))
    with_request = sum(p[k] * (q[0, k] - 0.7 * np.log(p[k]) - 0.2 * own[0, k]) for k in range(4)) - 0.7 * np.log(4)
    value = soft_value(jnp.array(q), jnp.array(own), log_p, counts, temperatures)
    np.testing.assert_allclose(value, [with_request, q[1, 0] - 0.2 * own[1, 0]], rtol=1e-5)


@pytest.fixture(scope="module")
def targets(fresh):
    """What critics are to learn of each transition: the slope, where they say 0, of a loss that isn't linear yet."""
    temperatures = jax.tree.map(jnp.exp, fresh.log_temperatures)
    mute = jax.tree.map(jnp.zeros_like, fresh.critic)

    @jax.jit
    @jax.vmap
    def slopes(transition, discount):
        one = jax.tree.map(lambda leaf: leaf[None], transition)
        hyper = HSACHyperparameters(discount=discount, reward_scale=0.1)
        given = AGENT.networks, fresh.target_critic, fresh.actor, one, temperatures, hyper, 10.0
        gradient, _ = jax.grad(critic_loss, has_aux=True)(mute, jax.random.key(2), *given)
        return jnp.stack([gradient["params"][f"Dense_{i}"]["bias"][transition.request] for i in range(2)])

    def targets(batch, discount=0.9):
        first, second = -np.asarray(slopes(batch, jnp.full(batch.reward.shape, discount))).T
        np.testing.assert_allclose(first, second, rtol=1e-6)
        return first

    return targets


def test_only_terminated_transitions_do_not_bootstrap(targets, batch):
    """Those that ended otherwise, by a time-out, do."""
    reward = 0.1 * batch.reward
    bootstraps = np.abs(targets(batch) - reward) > 1e-3
    np.testing.assert_array_equal(bootstraps, ~batch.terminated)
    assert (batch.ended & bootstraps).any()
    np.testing.assert_allclose(targets(batch, discount=0.0), reward, atol=1e-6)


def test_the_bootstrap_is_discounted_once_for_each_step_that_the_reward_covers(targets, batch):
    goes_on = batch.replace(terminated=np.zeros(32, bool))
    steps = np.arange(32) % 4 + 1
    once, often = (targets(one) - 0.1 * batch.reward for one in (goes_on, goes_on.replace(steps=steps)))
    np.testing.assert_allclose(often, once * 0.9 ** (steps - 1), rtol=1e-4, atol=1e-6)


def updated(state, batch, hyper, updates=3):
    for i in range(updates):
        state, metrics = update(jax.random.key(i), state, batch, hyper, 1.0)
    return state, metrics


@pytest.mark.parametrize("name", ["twist", "request"])
def test_temperature_rises_while_entropy_is_below_its_target(fresh, batch, name):
    entropy_field = f"target_entropy_{name}"
    high = updated(fresh, batch, HSACHyperparameters(**{entropy_field: 50.0}))[0].log_temperatures[name]
    low = updated(fresh, batch, HSACHyperparameters(**{entropy_field: -50.0}))[0].log_temperatures[name]
    assert float(high) > np.log(0.05) > float(low)


def test_where_no_request_counts_its_temperature_rests(fresh, batch):
    nowhere = np.zeros(32, bool)
    silent = batch.replace(observation=batch.observation.replace(may_request=nowhere), request=np.zeros(32, np.int32))
    state, metrics = updated(fresh, silent, HSACHyperparameters())
    assert float(state.log_temperatures["request"]) == pytest.approx(np.log(0.05))
    assert float(metrics["request_entropy"]) == 0.0


def test_update_changes_everything_targets_by_tau_and_averages_by_their_share(fresh, batch):
    hyper = HSACHyperparameters(tau=0.25, average=0.125)
    after, _ = update(jax.random.key(0), fresh, batch, hyper, 1.0)
    assert_close(
        after.target_critic, jax.tree.map(lambda a, b: a + 0.25 * (b - a), fresh.critic, after.critic), atol=1e-7
    )
    assert_close(after.averaged, jax.tree.map(lambda a, b: a + 0.125 * (b - a), fresh.actor, after.actor), atol=1e-7)
    assert AGENT.policy(after) is after.averaged
    for name in ("actor", "critic"):
        moved = [
            bool((a != b).any())
            for a, b in zip(*map(jax.tree.leaves, (getattr(fresh, name), getattr(after, name))), strict=True)
        ]
        assert all(moved)


def test_learning_rates_scale_the_step(fresh, batch):
    """Adam's first step is the learning rate times the sign of the gradient, so twice the rate is twice the step."""

    def step(lr_scale=1.0, **rates):
        after, _ = update(jax.random.key(0), fresh, batch, HSACHyperparameters(**rates), lr_scale)
        names = ("actor", "critic", "log_temperatures")
        return {name: jax.tree.map(lambda a, b: a - b, getattr(after, name), getattr(fresh, name)) for name in names}

    rates = {"actor": "actor_lr", "critic": "critic_lr", "log_temperatures": "temperature_lr"}
    slow, fast = dict.fromkeys(rates.values(), 1e-3), dict.fromkeys(rates.values(), 2e-3)
    assert_close(step(2.0, **slow), step(**fast), atol=1e-7)
    for name, rate in rates.items():
        one, two = (step(**slow | {rate: value})[name] for value in (1e-3, 2e-3))
        assert_close(two, jax.tree.map(lambda leaf: 2 * leaf, one), atol=1e-6)
        rests = step(**slow | {rate: 0.0})
        still = {name: max(float(jnp.abs(leaf).max()) for leaf in jax.tree.leaves(rests[name])) == 0 for name in rests}
        assert still == {other: other == name for other in rests}


def test_the_reward_counts_by_its_scale(fresh, batch):
    """Scaled by so much, or that much greater: it is the same."""
    scaled, _ = update(jax.random.key(0), fresh, batch, HSACHyperparameters(reward_scale=0.5), 1.0)
    greater = batch.replace(reward=50 * batch.reward)
    same, _ = update(jax.random.key(0), fresh, greater, HSACHyperparameters(reward_scale=0.01), 1.0)
    assert_close(scaled.critic, same.critic, atol=1e-6)


def test_act_and_best_action_keep_silent_where_requests_do_not_count(fresh, blank_observation):
    for may_request in (True, False):
        observation = blank_observation(may_request, (512,))
        requests = np.asarray(act(jax.random.key(0), fresh, observation, HSACHyperparameters()).request)
        assert (requests > 0).any() == may_request
    loud = jax.tree.map(lambda leaf: leaf, fresh.actor)
    loud["params"]["request_head"]["bias"] = jnp.array([0.0, 9.0, 0.0, 0.0])
    for may_request, voice in ((True, True), (True, False), (False, True), (False, False)):
        request = best_action(loud, blank_observation(may_request), voice).request
        assert int(request) == (may_request and voice)


def test_policy_does_not_depend_on_how_many_pedestrians_are_seen(fresh, random_observation):
    """Parameters fit any number, and the order of the pedestrians is of no consequence."""
    rng = np.random.default_rng(0)
    two, one = random_observation(rng), random_observation(rng)

    def people(change, *observations):
        parts = [(each.pedestrians, each.seen, each.dialogue) for each in observations]
        pedestrians, seen, dialogue = jax.tree.map(change, *parts)
        return two.replace(pedestrians=pedestrians, seen=seen, dialogue=dialogue)

    four = people(lambda *leaves: np.concatenate(leaves), two, one)
    flipped = people(lambda leaf: leaf[::-1], four)
    first, second = (best_action(fresh.actor, seen, True).twist for seen in (four, flipped))
    np.testing.assert_allclose(first, second, atol=1e-6)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("encoder", "cnn"),
        ("language", "latin"),
        ("requests", 3),
        ("heads", "two"),
        ("batch", 0),
        ("updates_per_step", -1),
        ("n_step", 0),
        ("actor_widths", ()),
        ("critic_widths", (8, 0)),
        ("huber_delta", float("nan")),
    ],
)
def test_bad_sizes_name_the_field(field, value):
    with pytest.raises(ValueError, match=f"agent.{field}.*(choose|give)"):
        HSACConfig(**{field: value})
