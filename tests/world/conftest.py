"""Worlds compiled once for all tests of the world, and situations built by hand."""

import dataclasses
from collections.abc import Callable

import chex
import jax
import numpy as np
import pytest

from jaxnav.world import Action, Params, State, World, WorldConfig
from jaxnav.world.people import OrcaPeople, Surroundings, advance
from jaxnav.world.types import Encounter, Pedestrian, PedestrianTraits, Robot

EPISODES = 2048


@dataclasses.dataclass(frozen=True)
class Compiled:
    """A world with its functions under ``jit``; `resets` and `steps` are those of ``EPISODES`` episodes at once."""

    world: World
    reset: Callable
    step: Callable
    observe: Callable
    resets: Callable
    steps: Callable

    def act(self, state, action, params=Params()):
        return self.step(jax.random.key(0), state, action, params)

    def play(self, policy, scenes, steps, params=Params()):
        """States `[steps + 1, EPISODES]` and outcomes `[steps, EPISODES]`, numpy; episodes run on after their end."""
        keys = jax.random.split(jax.random.key(0), (steps + 1, EPISODES))
        states = [self.resets(keys[0], params, np.broadcast_to(np.int32(scenes), EPISODES))]
        outcomes = []
        for step in range(steps):
            state, outcome = self.steps(keys[step + 1], states[-1], policy(step, states[-1]), params)
            states.append(state)
            outcomes.append(outcome)
        return tuple(jax.tree.map(lambda *leaves: np.stack(leaves), *records) for records in (states, outcomes))


def compiled(**config):
    world = World(WorldConfig(**config))
    resets = jax.jit(jax.vmap(world.reset, in_axes=(0, None, 0)))
    steps = jax.jit(jax.vmap(world.step, in_axes=(0, 0, 0, None)))
    # All tests share this one trace of the step, whatever state, action and parameters they hand in.
    step = jax.jit(chex.assert_max_traces(world.step, n=1))
    return Compiled(world, jax.jit(world.reset), step, jax.jit(world.observe), resets, steps)


@pytest.fixture(scope="session")
def default():
    """The default world: square, hallway and crosswalk, one pedestrian."""
    return compiled()


@pytest.fixture(scope="session")
def crowd():
    """Six pedestrians, of whom four are observed, every part of the observation."""
    parts = ("scan", "pedestrians", "dialogue", "sensor_map", "pedestrian_map")
    return compiled(pedestrians=6, observation=parts)


@pytest.fixture(scope="session")
def variant():
    """A deaf robot with a noisy laser, and collisions tested at the end of a step only."""
    return compiled(
        hearing=False, swept_collisions=False, scan_noise=True, observation=("scan", "dialogue"), scenes=("square",)
    )


@pytest.fixture(scope="session")
def random_episodes(default):
    """60 steps of robots at random twists and requests in all scenes; half of what they ask is refused."""
    rng = np.random.default_rng(0)

    def policy(step, state):
        del step, state
        twist = rng.uniform((-0.5, -1.0), 1.0, (EPISODES, 2)).astype(np.float32)
        return Action(twist=twist, request=rng.integers(0, 4, EPISODES, np.int32))

    return default.play(policy, np.arange(EPISODES) % 3, 60, Params(small_talk=0.05, compliance=0.5, max_steps=50.0))


def action(v=0.0, w=0.0, request=0):
    """The action that drives v m/s and w rad/s with the default limits."""
    return Action(twist=np.array([v / 0.3 - 1.0, w / 0.9], np.float32), request=np.int32(request))


def situation(
    robot=(0.0, 0.0, 0.0), goal=(4.5, 0.0), twist=(0.0, 0.0), pedestrians=((-4.0, 4.0, -4.0, 4.0),), speed=0.5, scene=0,
    t=0, first_draw=0.99, message_draw=0.99, compliance_draw=0.0, side_draw=0.0, reply_delay=0, commit_delay=2,
    decide_delay=2, **encounter,
):  # fmt: skip
    """A `State` before anything was said. robot: x, y, heading; pedestrians: x, y, goal x, y, walking at ``speed``.

    By default the robot is the initiator, the usual message is drawn and requests are granted at once. ``encounter``:
    fields of `Encounter` to set for all pedestrians.
    """
    x, y, goal_x, goal_y = np.array(pedestrians, np.float32).T
    count = len(pedestrians)
    length = np.maximum(np.hypot(goal_x - x, goal_y - y), 1e-6)
    pose = [np.float32(value) for value in robot]

    def each(value, dtype=np.float32):
        return np.full(count, value, dtype)

    kinds = dict.fromkeys(Encounter.__dataclass_fields__, np.float32)
    kinds |= dict.fromkeys(("met", "is_open", "pedestrian_first"), bool)
    kinds |= dict.fromkeys(("message", "message_age", "request", "request_age", "reply", "grown", "age"), np.int32)
    kinds |= {"utterance": np.uint32}
    fields = {name: each(0, dtype) for name, dtype in kinds.items()}
    fields["distance"] = np.hypot(x - pose[0], y - pose[1]).astype(np.float32)
    fields |= {name: each(value, kinds[name]) for name, value in encounter.items()}
    return State(
        t=np.int32(t), scene=np.int32(scene), seed=np.uint32(7),
        robot=Robot(
            x=pose[0], y=pose[1], heading=pose[2], v=np.float32(twist[0]), w=np.float32(twist[1]),
            goal_x=np.float32(goal[0]), goal_y=np.float32(goal[1]), start_heading=pose[2],
            past=np.zeros((2, 3), np.float32),
        ),
        pedestrians=Pedestrian(
            x=x, y=y, vx=(speed * (goal_x - x) / length).astype(np.float32),
            vy=(speed * (goal_y - y) / length).astype(np.float32), goal_x=goal_x, goal_y=goal_y,
            via_x=goal_x, via_y=goal_y, turned=each(True, bool), present=each(True, bool),
        ),
        traits=PedestrianTraits(
            first=each(first_draw), message=each(message_draw), compliance=each(compliance_draw),
            decides=each(0.5), side=each(side_draw), reply_delay=each(reply_delay, np.int32),
            commit_delay=each(commit_delay, np.int32), decide_delay=each(decide_delay, np.int32),
        ),
        encounters=Encounter(**fields), min_distance=np.float32(np.inf),
    )  # fmt: skip


@pytest.fixture(scope="session", name="action")
def _action():
    return action


@pytest.fixture(scope="session", name="situation")
def _situation():
    return situation


@pytest.fixture(scope="session", name="walk_in")
def _walk_in():
    """The pedestrians of a state a step later, among walls; by ORCA, or by another model that remembers nothing."""

    def walk(walls, state, config, params, model=None):
        surroundings = Surroundings(robot=state.robot, walls=walls, t=state.t, seed=state.seed)
        model = model or OrcaPeople()
        return advance(model, state.pedestrians, None, state.encounters, state.traits, surroundings, config, params)[0]

    return walk
