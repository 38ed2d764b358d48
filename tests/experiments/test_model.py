"""The fitted model: it is the world's pedestrian, and its blurred awareness is the exact mean that it claims to be."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from experiments.calibration import model, simulated
from experiments.calibration.model import Behaviour, Setting

TRUTH = Behaviour(1.1, 1.6, 2.5, 0.2)
PAIR = Setting(neighbors=1)
CONSTANT = Behaviour(1.0, 3.0, 4.0, 0.3, memory=1e-3, relaxation=1e6)


@jax.jit
def pair(behaviour, window, width):
    """Predicted positions `[P, T, 2]` of the first window."""
    return model.predict(behaviour, jax.tree.map(lambda leaf: leaf[0], window), PAIR, width)


@jax.jit
def pair_with_threshold(behaviour, window):
    return model.predict(behaviour, jax.tree.map(lambda leaf: leaf[0], window), PAIR)


@pytest.fixture(scope="module")
def head_on(walkers):
    """Two people 2 m apart, walking at each other, a little aside; nothing is known of their future."""
    return walkers([[0, 0], [2, 0.1]], [[1, 0], [-1, 0]], np.zeros((2, 1, 2)))


def test_the_world_walks_as_the_model_predicts():
    """A step of `World`, robot, neighbours and all, within what float32 leaves of a difference of positions."""
    recorded = simulated.record(jax.random.key(3), TRUTH, 2, episodes=80)

    @jax.jit
    def error(behaviour):
        predicted = jax.vmap(lambda window: model.predict(behaviour, window, simulated.setting(2)))(recorded)
        return jnp.linalg.norm(predicted - recorded.future, axis=-1)[..., 0]

    counts = recorded.weight > 0
    assert counts.sum() > 800
    assert error(TRUTH)[counts].max() < 1e-4
    # Of which the model knows by avoidance: who avoids nobody is off by centimetres in many steps.
    assert np.mean(error(TRUTH._replace(awareness=0.0))[counts] > 0.01) > 0.05


def test_blurred_awareness_is_the_mean_over_a_logistic_distribution(head_on):
    width = 0.4
    quantiles = (jnp.arange(4000) + 0.5) / 4000
    drawn = 1.8 + width * jax.scipy.special.logit(quantiles)
    each = jax.vmap(lambda a: pair_with_threshold(CONSTANT._replace(awareness=a), head_on))(drawn)
    assert np.ptp(each[:, 0, 0, 1]) > 0.01  # those who are seen are avoided
    blurred = pair(CONSTANT._replace(awareness=1.8), head_on, width)
    np.testing.assert_allclose(blurred, each.mean(axis=0), atol=1e-4)


def test_gradients_are_those_of_finite_differences(head_on):
    """By every parameter; the threshold itself has none by awareness, its blur has."""

    def ahead(behaviour, window, width):
        return pair(behaviour, window, width)[0, 0, 0]

    start = Behaviour(*map(jnp.float32, (1.4, 2.2, 0.8, 0.3, 0.5, 2.0)))
    gradient = jax.grad(ahead)(start, head_on, 0.4)
    for name in ("preferred_speed", "awareness", "time_horizon", "radius", "relaxation"):
        h = 0.01 * getattr(start, name)
        up, down = (start._replace(**{name: getattr(start, name) + sign * h}) for sign in (1, -1))
        difference = (ahead(up, head_on, 0.4) - ahead(down, head_on, 0.4)) / (2 * h)
        assert getattr(gradient, name) == pytest.approx(float(difference), rel=0.02, abs=2e-5), name
    assert abs(gradient.awareness) > 1e-3 and abs(gradient.time_horizon) > 1e-2 and abs(gradient.radius) > 1e-2
    hard = jax.grad(lambda behaviour: pair_with_threshold(behaviour, head_on)[0, 0, 0])(start)
    assert hard.awareness == 0


@pytest.mark.parametrize("reason", ["same group", "not there", "out of sight"])
def test_some_are_not_avoided(head_on, reason):
    alone = {
        "same group": head_on._replace(group=np.array([[5, 5]])),
        "not there": head_on._replace(present=np.array([[True, False]])),
        "out of sight": head_on,
    }[reason]
    behaviour = CONSTANT._replace(awareness=1.9) if reason == "out of sight" else CONSTANT
    assert pair_with_threshold(CONSTANT, head_on)[0, 0, 1] < -0.01
    np.testing.assert_allclose(pair_with_threshold(behaviour, alone)[0, 0], [0.4, 0], atol=1e-6)


def test_robots_drive_on_and_people_give_way_to_their_size(head_on):
    robot = head_on._replace(robot=np.array([[False, True]]))
    small, large = (
        model.predict(CONSTANT, jax.tree.map(lambda leaf: leaf[0], robot), PAIR._replace(robot_radius=radius))
        for radius in (0.1, 0.5)
    )
    np.testing.assert_allclose(small[1, 0], [1.6, 0.1], atol=1e-6)
    assert large[0, 0, 1] < small[0, 0, 1] - 0.01


def test_own_velocity_is_an_exponential_mean_of_what_is_known(walkers):
    window = jax.tree.map(lambda leaf: leaf[0], walkers([[0, 0]] * 2, [[0, 0]] * 2, np.zeros((2, 1, 2))))
    window = window._replace(
        velocity=np.array([[[1.0, 0], [2.0, 0]]] * 2), known=np.array([[True, True], [True, False]])
    )
    weight = np.exp(-0.4 / 0.8)
    own = model.own_velocity(CONSTANT._replace(memory=0.8), window, PAIR)
    np.testing.assert_allclose(own[:, 0], [(1 + 2 * weight) / (1 + weight), 1.0], rtol=1e-6)


def test_people_turn_from_their_own_velocity_to_the_worlds_and_who_stands_goes_on_standing(walkers):
    """After t seconds exp(-t / relaxation) of their own velocity is left."""
    t = 0.4 * np.arange(12) + 0.2
    behaviour = Behaviour(1.5, 0.0, 1.0, 0.1, memory=1e-3, relaxation=3.0)
    window = walkers([[0, 0], [0, 9]], [[1.0, 0], [0.1, 0]], np.zeros((2, 12, 2)))
    window = window._replace(standing=np.array([[False, True]]))
    walked = np.asarray(pair_with_threshold(behaviour, window))
    np.testing.assert_allclose(walked[0, :, 0], np.cumsum(0.4 * (1.5 - 0.5 * np.exp(-t / 3.0))), rtol=1e-5)
    np.testing.assert_allclose(walked[1, :, 0], 0.04 * np.arange(1, 13), rtol=1e-5)
