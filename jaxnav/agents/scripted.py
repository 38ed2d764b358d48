"""Robots that follow a rule instead of a network."""

import jax.numpy as jnp

from ..world import Action


def straight_line(policy_params, state, world, params):
    """Full speed toward the goal, silent: the yardstick of a scene's hardness (docs/world.md section 2)."""
    del policy_params, world
    robot = state.robot
    error = jnp.arctan2(robot.goal_y - robot.y, robot.goal_x - robot.x) - robot.heading
    error = jnp.arctan2(jnp.sin(error), jnp.cos(error))
    turn = jnp.clip(error / (params.max_w * params.dt), -1.0, 1.0)
    return Action(twist=jnp.stack([jnp.ones_like(turn), turn]), code=jnp.int32(0))
