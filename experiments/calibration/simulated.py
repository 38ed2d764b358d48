"""Walkers of the world itself, with parameters that are known: what a calibration has to find again."""

import functools

import jax
import jax.numpy as jnp
import numpy as np

from jaxnav import Action, Params, World, WorldConfig

from .model import Setting
from .windows import Windows

_HALF_SIDE = 5.0  # of the square, m
_SETTING = Setting(max_speed=2.0, robot_radius=0.17)


def setting(walkers):
    """`Setting` in which each of so many walkers sees all the others and the robot."""
    return _SETTING._replace(neighbors=walkers)


def params_of(truth):
    """`Params` of a world whose pedestrians behave so. Robot and people come into view at the same distance."""
    return Params(
        preferred_speed=truth.preferred_speed, awareness=truth.awareness, neighbor_distance=truth.awareness,
        time_horizon=truth.time_horizon, body_radius=truth.radius, max_speed=_SETTING.max_speed,
        robot_radius=_SETTING.robot_radius, dt=_SETTING.dt, time_horizon_walls=_SETTING.dt,
        # Nobody talks: a pedestrian that keeps its word no longer avoids the robot.
        p_pedestrian_first=0.0,
    )  # fmt: skip


def record(key, truth, walkers, episodes, steps=16, noise=0.0):
    """`Windows` of one instant of past and one of future: the robot drives straight through walkers in a square.

    noise: standard deviation of the recorded positions of people, m; the robot knows where it is.
    Everybody counts but those so near to a wall that it may, which the fit doesn't know.
    """
    key, key_noise = jax.random.split(key)
    start, states = _episodes(jax.random.split(key, episodes), truth, walkers, steps)
    people = np.stack([states.pedestrians.x, states.pedestrians.y], axis=-1)
    people += noise * np.asarray(jax.random.normal(key_noise, people.shape))
    robot = np.stack([states.robot.x, states.robot.y], axis=-1)
    position = np.concatenate([people, robot[:, :, None]], axis=2)
    goal = np.stack([start.pedestrians.goal_x, start.pedestrians.goal_y], axis=-1)
    return _windows(position, np.pad(goal, ((0, 0), (0, 1), (0, 0))))


@functools.partial(jax.jit, static_argnames=("walkers", "steps"))
def _episodes(keys, truth, walkers, steps):
    """(first states `[episodes]`, the states after them `[episodes, steps]`)."""
    world, params = World(WorldConfig(scenes=("square",), pedestrians=walkers)), params_of(truth)
    ahead = Action(twist=jnp.array([1.0, 0.0]), request=jnp.int32(0))

    def episode(key):
        start = world.reset(key, params)

        def step(state, _):
            new = world.step(key, state, ahead, params)[0]
            return new, new

        return start, jax.lax.scan(step, start, length=steps)[1]

    return jax.vmap(episode)(keys)


def _windows(position, goal):
    """`Windows` of episodes. position: `[episodes, steps, P, 2]`, the robot last; goal: `[episodes, P, 2]`."""
    past, now, future = (position[:, i : position.shape[1] - 2 + i].reshape(-1, *position.shape[2:]) for i in range(3))
    count, places = now.shape[:2]
    robot = np.broadcast_to(np.arange(places) == places - 1, (count, places))
    everywhere = np.ones((count, places), bool)
    reach = _SETTING.max_speed * _SETTING.dt + 0.5
    inside = np.abs(now).max(-1) < _HALF_SIDE - reach
    person = np.broadcast_to(np.arange(places), (count, places))
    return Windows(
        instant=np.tile(np.arange(1, position.shape[1] - 1), len(position)), position=now,
        velocity=(now - past)[:, :, None] / _SETTING.dt, known=everywhere[..., None],
        goal=np.repeat(goal, position.shape[1] - 2, axis=0), standing=~everywhere, robot=robot, present=everywhere,
        group=person, future=future[:, :, None], weight=(inside & ~robot).astype(np.float32), person=person,
    )  # fmt: skip
