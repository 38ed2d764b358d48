"""Late scans and late controls are those of an undelayed world some steps before, bit for bit."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxnav.agents.replay import Replay
from jaxnav.world import Action, Params, World, WorldConfig, check_params, delays

SCAN_DELAY, CONTROL_DELAY, STEPS = 3, 2, 8
WORLD = World(
    WorldConfig(
        body="legs", scan_noise=True, scenes=("square",), wall_neighbors=1, scan_delay=SCAN_DELAY,
        control_delay=CONTROL_DELAY, observation=("scan", "pedestrians", "dialogue", "sensor_map"),
    )
)  # fmt: skip
PARAMS = Params(scan_dropout=0.1)
STAND = (-1.0, 0.0)


def play(world):
    """Compiled once, for any latency: states and observations `[STEPS + 1]`, outcomes `[STEPS]`."""

    @jax.jit
    def episode(twists, params):
        requests = jnp.arange(STEPS) % 4
        actions = Action(twist=twists, request=requests)
        first = world.reset(jax.random.key(5), params)

        def step(state, action):
            state, outcome = world.step(jax.random.key(0), state, action, params)
            return state, (state, outcome)

        _, (states, outcomes) = jax.lax.scan(step, first, actions)
        states = jax.tree.map(lambda one, rest: jnp.concatenate([one[None], rest]), first, states)
        return states, jax.vmap(world.observe, in_axes=(0, None))(states, params), outcomes

    return lambda twists, **params: jax.device_get(episode(twists, jax.tree.map(np.float32, PARAMS.replace(**params))))


@pytest.fixture(scope="module")
def delayed():
    return play(WORLD)


@pytest.fixture(scope="module")
def plain():
    """The same world without any history."""
    return play(World(dataclasses.replace(WORLD.config, scan_delay=0, control_delay=0)))


@pytest.fixture(scope="module")
def twists():
    return np.random.default_rng(0).uniform(-1, 1, (STEPS, 2)).astype(np.float32)


def assert_equal(one, other):
    jax.tree.map(np.testing.assert_array_equal, one, other)


@pytest.mark.parametrize("latency", range(SCAN_DELAY + 1))
def test_a_late_scan_is_that_of_some_steps_before(delayed, twists, latency):
    """Walls, legs and noise of then; before there was any, the first one. All else is seen as it is now."""
    states, now, _ = delayed(twists)
    same_states, late, _ = delayed(twists, scan_latency=latency)
    assert_equal(same_states, states)
    then = np.maximum(np.arange(STEPS + 1) - latency, 0)
    assert_equal(late.scan, now.scan[then])
    assert_equal(late.sensor_map, now.sensor_map[then])
    assert len(np.unique(now.scan, axis=0)) == STEPS + 1
    assert_equal(late.replace(scan=0, sensor_map=0), now.replace(scan=0, sensor_map=0))


@pytest.mark.parametrize("latency", range(CONTROL_DELAY + 1))
def test_late_controls_are_the_same_controls_some_steps_before(delayed, twists, latency):
    """The robot stands until the first one arrives; what it says counts at once."""
    states, seen, outcomes = delayed(twists, control_latency=latency)
    shifted = np.concatenate([np.tile(np.float32(STAND), (latency, 1)), twists[: STEPS - latency]])
    same_states, same_seen, same_outcomes = delayed(shifted)
    assert_equal(states.replace(past_twists=0), same_states.replace(past_twists=0))
    assert_equal((seen, outcomes), (same_seen, same_outcomes))
    assert np.all(states.robot.v[: latency + 1] == 0)
    assert np.all(states.robot.v[latency + 1 :] > 0)
    assert_equal(states.past_twists[-1], twists[::-1][:CONTROL_DELAY])


def test_a_history_that_is_not_used_changes_nothing(delayed, plain, twists):
    states, seen, outcomes = plain(twists)
    assert states.past_views is None and states.past_twists is None
    same_states, same_seen, same_outcomes = delayed(twists)
    same = same_states.replace(past_views=None, past_twists=None), same_seen, same_outcomes
    # Another program: the last bits may differ.
    jax.tree.map(
        lambda one, other: np.testing.assert_allclose(one, other, rtol=1e-4, atol=1e-4), (states, seen, outcomes), same
    )


def test_replay_gives_late_snapshots_back_and_each_episode_has_its_own_latency(delayed, twists):
    """Latencies are leaves of `Params`: one compiled function renders a batch of them."""
    states, now, _ = delayed(twists)
    snapshots = jax.jit(jax.vmap(WORLD.snapshot))(states)
    replay = Replay(
        rows=1, template=jax.tree.map(lambda leaf: jax.ShapeDtypeStruct(leaf.shape[1:], leaf.dtype), snapshots)
    )
    contents = replay.add(replay.init(STEPS + 1), jnp.int32(0), snapshots)
    drawn, _ = replay.sample(jax.random.key(0), contents, jnp.int32(1), 40)
    latencies = np.arange(40) % (SCAN_DELAY + 1)

    def scan(snapshot, latency):
        return WORLD.observe_snapshot(snapshot, PARAMS.replace(scan_latency=latency)).scan

    scans = jax.jit(jax.vmap(scan))(drawn, latencies.astype(np.float32))
    then = np.maximum(np.asarray(drawn.t) - latencies, 0)
    assert set(then) == set(range(STEPS + 1))
    np.testing.assert_allclose(scans, now.scan[then], atol=1e-5)


def test_a_step_of_delay_costs_a_snapshot_14_bytes_and_17_a_pedestrian():
    def size(**config):
        world = World(WorldConfig(**config))
        state = jax.eval_shape(world.reset, jax.random.key(0), Params())
        leaves = jax.tree.leaves(jax.eval_shape(world.snapshot, state))
        return sum(leaf.size * leaf.dtype.itemsize for leaf in leaves)

    assert size() == 91
    assert size(control_delay=4) == 91
    assert size(scan_delay=1) == 91 + 31
    assert size(scan_delay=3, pedestrians=2) == 91 + 28 + 3 * (14 + 2 * 17)


def test_steps_keep_the_types_of_a_reset():
    state = jax.eval_shape(WORLD.reset, jax.random.key(0), Params())
    action = Action(twist=jax.ShapeDtypeStruct((2,), jnp.float32), request=jax.ShapeDtypeStruct((), jnp.int32))
    with jax.numpy_rank_promotion("raise"):
        after, _ = jax.eval_shape(WORLD.step, jax.random.key(0), state, action, Params())
        jax.eval_shape(WORLD.observe, state, Params())
    kinds = [[(leaf.shape, leaf.dtype, leaf.weak_type) for leaf in jax.tree.leaves(tree)] for tree in (state, after)]
    assert kinds[0] == kinds[1]


def test_histories_are_newest_first():
    history = delays.start({"a": jnp.zeros(2)}, 3)
    for value in (1.0, 2.0, 3.0, 4.0):
        history = delays.push(history, {"a": jnp.full(2, value)})
    assert history["a"].tolist() == [[4.0, 4.0], [3.0, 3.0], [2.0, 2.0]]
    recalled = [delays.recall(history, {"a": jnp.full(2, 5.0)}, latency)["a"][0].item() for latency in range(4)]
    assert recalled == [5.0, 4.0, 3.0, 2.0]


@pytest.mark.parametrize(("name", "longest"), [("scan_latency", "scan_delay"), ("control_latency", "control_delay")])
@pytest.mark.parametrize("value", [3.0, 0.5, -1.0])
def test_latencies_that_are_no_steps_of_the_history_are_refused(name, longest, value):
    config = WorldConfig(scan_delay=2, control_delay=2)
    remedy = rf"world\.params\.{name} is {value}: give a whole number from 0 to world\.{longest}, which is 2"
    with pytest.raises(ValueError, match=remedy):
        World(config).reset(jax.random.key(0), Params(**{name: value}))
    with pytest.raises(ValueError, match=name):  # one of a batch
        check_params(Params(**{name: np.array([0.0, value])}), config)
    check_params(Params(**{name: np.array([0.0, 1.0, 2.0])}), config)
