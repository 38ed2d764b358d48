"""Scripted robots: they get where they want to when nobody is there, and words are worth something when somebody is."""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxnav.agents.scripted import OrcaRobot, Planner, StraightLine
from jaxnav.training.evaluation import episode_keys
from jaxnav.world import SCENES, SUITES, World, WorldConfig, default_params
from jaxnav.world.types import NONE, STOP

LINE, ORCA = StraightLine(), OrcaRobot()
PLANNER, DEAF, MUTED = Planner(), Planner(hears=False), Planner(speaks=False)
HARD = (*SUITES["hard"], *SUITES["hard-laser"])
GIVEN = (*SUITES["parity"], *SUITES["hard"])  # a twin of the hard suite is the same to those who look at nobody
STEPS = 100
BLOCK = 250


class Played(NamedTuple):
    """How episodes ended, and the first request that counted; leaves `[episodes]`."""

    arrived: np.ndarray
    hit_pedestrian: np.ndarray
    hit_wall: np.ndarray
    request: np.ndarray


def _act(player, world, params, state):
    return player(state, world, params)


@functools.cache
def _program(names, pedestrians):
    """`BLOCK` episodes in one of these scenes, by a scripted robot: one program for all of them.

    In a crowd without the ORCA robot, whose half-planes for all of its people take long to compile.
    """
    robots = (StraightLine, Planner) if pedestrians > 1 else (StraightLine, Planner, OrcaRobot)
    world = World(WorldConfig(scenes=names, pedestrians=pedestrians))

    def episode(key, robot, planner, scene, alone, params):
        key_reset, key_steps = jax.random.split(key)
        state = world.reset(key_reset, params, scene)
        state = state.replace(pedestrians=state.pedestrians.replace(present=state.pedestrians.present & ~alone))

        def step(carry, key):
            state, played, over = carry
            players = [planner if robot is Planner else robot() for robot in robots]
            action = jax.lax.switch(
                robot, [functools.partial(_act, player, world, params) for player in players], state
            )
            state, outcome = world.step(key, state, action, params)
            now = Played(
                arrived=played.arrived | (outcome.arrived & ~over),
                hit_pedestrian=played.hit_pedestrian | (outcome.hit_pedestrian & ~over),
                hit_wall=played.hit_wall | (outcome.collided & ~outcome.hit_pedestrian & ~over),
                request=jnp.where(over | (played.request != NONE), played.request, outcome.requested),
            )
            return (state, now, over | outcome.terminated), None

        no = jnp.bool_(False)
        start = state, Played(no, no, no, jnp.int32(NONE)), no
        return jax.lax.scan(step, start, jax.random.split(key_steps, STEPS))[0][1]

    return jax.jit(jax.vmap(episode, in_axes=(0, None, None, None, None, None)))


def played(robot, name, alone=False, episodes=BLOCK):
    """`Played` by that robot in that scene, among its people or without any; once for all tests."""
    return _played(robot, name, alone, episodes)


@functools.cache
def _played(robot, name, alone, episodes):
    crowded = SCENES[name].crowd not in (None, (1, 1))
    names = tuple(one for one in SCENES if (SCENES[one].crowd not in (None, (1, 1))) == crowded)
    program = _program(names, 8 if crowded else 1)
    params = jax.tree.map(np.float32, default_params((name,)))
    planner = jax.tree.map(np.bool_, robot if isinstance(robot, Planner) else PLANNER)
    number = (StraightLine, Planner, OrcaRobot).index(type(robot))
    rest = number, planner, names.index(name), np.bool_(alone), params
    blocks = [
        jax.device_get(program(episode_keys(0, first + jnp.arange(BLOCK)), *rest))
        for first in range(0, episodes, BLOCK)
    ]
    return Played(*(np.concatenate(leaves) for leaves in zip(*blocks, strict=True)))


def success(*arguments, **settings):
    return played(*arguments, **settings).arrived.mean()


@pytest.mark.parametrize("name", SUITES["hard"])
def test_a_straight_line_at_full_speed_fails_in_four_episodes_of_ten(name):
    assert success(LINE, name) <= 0.6


@pytest.mark.parametrize("name", GIVEN)
def test_alone_they_arrive(name):
    """Through doors and around corners too; a straight line does where the way is straight, and around no corner."""
    assert success(PLANNER, name, alone=True) == 1.0
    if name != "crossflow":
        assert success(ORCA, name, alone=True) == 1.0
    if not name.startswith("doorway"):  # in which it gets through the door, or doesn't
        assert success(LINE, name, alone=True) == (SCENES[name].passage is None)


@pytest.mark.parametrize("name", [name for name in GIVEN if name != "crossflow"])
def test_an_orca_robot_never_drives_into_a_wall(name):
    assert not played(ORCA, name).hit_wall.any()


def test_an_orca_robot_avoids_people_better_than_a_straight_line():
    line, orca = played(LINE, "square"), played(ORCA, "square")
    assert orca.hit_pedestrian.mean() < line.hit_pedestrian.mean() - 0.2


@pytest.mark.parametrize("name", HARD)
def test_words_are_worth_five_points_in_every_hard_scene(name, full):
    """The planner beside the same when it doesn't hear, and without a voice; the same episodes for all three."""
    episodes = 10_000 if full else BLOCK
    best = success(PLANNER, name, episodes=episodes)
    assert best >= success(DEAF, name, episodes=episodes) + 0.05
    assert best >= success(MUTED, name, episodes=episodes) + 0.05


@pytest.mark.parametrize("name", ["square", "narrow", "corner", "crossflow"])
def test_only_those_with_a_voice_ask(name):
    """Around a corner to stop; otherwise what fits."""
    assert np.mean(played(PLANNER, name).request != NONE) > 0.3
    assert not np.any(played(MUTED, name).request)
    assert not np.any(played(LINE, name).request)
    if SCENES[name].passage:
        asked = played(PLANNER, name).request
        assert np.mean(asked[asked != NONE] == STOP) > 0.9
