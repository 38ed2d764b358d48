"""Domain randomisation: what is drawn, that a snapshot's seed draws it again, and what is refused."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxnav.training.config import preset
from jaxnav.training.randomise import check_ranges, draw
from jaxnav.world import Params, World, WorldConfig

RANGES = preset("robust").world.randomise
CONFIG = WorldConfig(pedestrians=8, control_delay=2)


@pytest.fixture(scope="module")
def drawn():
    """`Params` `[4000]` of as many episodes."""
    seeds = jnp.arange(4000, dtype=jnp.uint32)
    return jax.device_get(jax.jit(jax.vmap(lambda seed: draw(seed, Params(), RANGES)))(seeds))


@pytest.mark.parametrize(("name", "low", "high"), RANGES)
def test_values_fill_their_range_evenly(drawn, name, low, high):
    values = getattr(drawn, name)
    if name in ("crowd_size", "control_latency"):
        counts = np.bincount(values.astype(int), minlength=high + 1)[low:]
        assert set(values) == set(range(low, high + 1))
        assert np.abs(counts / len(values) - 1 / (high - low + 1)).max() < 0.03
    else:
        assert low <= values.min() < low + 0.01 * (high - low) and high >= values.max() > high - 0.01 * (high - low)
        assert values.mean() == pytest.approx((low + high) / 2, abs=0.02 * (high - low))


def test_fields_are_drawn_apart_and_the_rest_stays(drawn):
    table = np.stack([getattr(drawn, name) for name, _, _ in RANGES])
    assert np.abs(np.corrcoef(table) - np.eye(len(RANGES))).max() < 0.06
    for name, value in vars(Params()).items():
        if name not in {name for name, _, _ in RANGES} | {"max_speed"}:
            np.testing.assert_array_equal(getattr(drawn, name), np.float32(value))
    assert (drawn.max_speed >= drawn.preferred_speed).all()


def test_an_episode_is_begun_with_what_its_seed_draws():
    world = World(CONFIG)

    @jax.jit
    def begin(seed):
        params = draw(seed, Params(), RANGES)
        state = world.reset(jax.random.key(1), params, 1, seed)
        return params, draw(world.snapshot(state).seed, Params(), RANGES), state

    params, again, state = begin(jnp.uint32(5))
    jax.tree.map(np.testing.assert_array_equal, params, again)
    assert int(state.pedestrians.present.sum()) == int(params.crowd_size)
    speed = np.hypot(state.pedestrians.vx, state.pedestrians.vy)[np.asarray(state.pedestrians.present)]
    np.testing.assert_allclose(speed, params.preferred_speed, rtol=1e-4)


@pytest.mark.parametrize(
    ("ranges", "message"),
    [
        ((("sped", 0.0, 1.0),), "'sped': give fields"),
        ((("compliance", 1.0, 0.0),), "1.0 to 0.0 for compliance: give the lower end first"),
        ((("compliance", 0.0, 1.5),), "compliance is 1.5: give a number from 0 to 1"),
        ((("control_latency", 0, 3),), "control_latency is 3: give a whole number from 0 to world.control_delay"),
        ((("crowd_size", 1, 9),), "crowd_size is 9: give a whole number from 0 to world.pedestrians"),
        ((("compliance", 0.0, 1.0), ("compliance", 0.5, 1.0)), "names a field twice"),
    ],
)
def test_ranges_that_make_no_sense_are_refused(ranges, message):
    with pytest.raises(ValueError, match=message):
        check_ranges(ranges, Params(), CONFIG)
