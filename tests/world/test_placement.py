"""Placement: scenes that share a function share its program, and draw what they would draw by themselves."""

import dataclasses

import chex
import jax
import jax.extend
import jax.numpy as jnp
import numpy as np
import pytest

from jaxnav.world import SCENES, SUITES, Params, World, WorldConfig
from jaxnav.world.placement import FromTable, draw_of_scene
from jaxnav.world.scenes import straight

SQUARE = SCENES["square"]


def _meet_in_lane(row, u, robot_speed, speed):
    """From opposite ends of a lane, as long and as wide as the row says."""
    del robot_speed, speed
    length, width = row
    x, y = 0.5 * length + 0.3 * u[1], width * (u[2] - 0.5)
    return (-x, y, x, y), straight(x, -y, -x, -y)


def _stroll_around(reach, u):
    return straight(*(reach * (2.0 * number - 1.0) for number in u[1:5]))


def lanes(count):
    """A world of so many scenes that differ in the numbers of one function for those who meet, and who stroll."""
    stroll = FromTable(_stroll_around, np.float32([3.0]))
    scenes = [
        dataclasses.replace(
            SQUARE, name=f"lane-{i}", meet=FromTable(_meet_in_lane, (np.float32([4.0 + 0.1 * i]), np.float32([0.5]))),
            stroll=stroll,
        )
        for i in range(count)
    ]  # fmt: skip
    return World(WorldConfig(scenes=tuple(scene.name for scene in scenes), pedestrians=3), scenes)


def equations(jaxpr):
    """All equations of a program, those of its loops and branches included."""
    for equation in jaxpr.eqns:
        yield equation
        for inner in jax.extend.core.jaxprs_in_params(equation.params):
            yield from equations(inner)


def test_the_program_does_not_grow_with_the_number_of_scenes_of_one_function():
    programs = []
    for count in (2, 24):
        world = lanes(count)
        programs.append(jax.make_jaxpr(lambda key, world=world: world.reset(key, Params()))(jax.random.key(0)).jaxpr)
    few, many = ([equation.primitive.name for equation in equations(program)] for program in programs)
    assert few == many
    assert "cond" not in many  # what a switch is


def test_a_function_that_scenes_share_is_traced_once():
    traced = []

    def counted(u, *speeds):
        traced.append(1)
        return SQUARE.meet(u, *speeds)

    draws = [counted if i % 2 else SCENES["hallway"].meet for i in range(24)]
    u = jnp.zeros((12, 32))
    jax.jit(lambda scene: draw_of_scene(draws, scene, list(u), 0.6, 0.5))(jnp.int32(3))
    assert len(traced) == 1


@pytest.mark.parametrize("suite", [*SUITES, "hard and hard-laser"])
def test_scenes_draw_together_what_each_draws_alone(suite):
    names = SUITES[suite] if suite in SUITES else SUITES["hard"] + SUITES["hard-laser"]
    draws = [SCENES[name].meet for name in names]
    u = np.random.default_rng(0).random((12, 32), np.float32)
    together = jax.jit(lambda scene: draw_of_scene(draws, scene, list(u), 0.6, 0.5))
    for i, draw in enumerate(draws):
        alone = jax.jit(lambda branch, draw=draw: jax.lax.switch(branch, [lambda u: draw(u, 0.6, 0.5)] * 2, list(u)))(0)
        chex.assert_trees_all_equal(together(i), alone)


def test_tables_of_several_scenes_are_kept_apart():
    """Each scene draws its own rows, all of them, and in the order of its numbers; another function stays itself."""

    def number(row, u):
        return row["number"] + 0.0 * u[0]

    tables = [np.arange(3.0), np.arange(10.0, 15.0), np.array([20.0])]
    draws = [FromTable(number, {"number": np.float32(table)}) for table in tables]
    draws.insert(1, lambda u: -u[0])
    u = (np.arange(60, dtype=np.float32) + 0.5)[None] / 60
    drawn = jax.jit(lambda scene: draw_of_scene(draws, scene, u))
    for scene, table in zip((0, 2, 3), tables, strict=True):
        np.testing.assert_array_equal(drawn(scene), np.repeat(table, 60 // len(table)))
        np.testing.assert_array_equal(drawn(scene), draws[scene](u))
    np.testing.assert_array_equal(drawn(1), -u[0])
    last = np.float32([[1 - 2**-24]])
    assert draws[2](last) == 14.0
