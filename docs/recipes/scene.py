"""A scene: a T-junction, where the robot comes along the bar and the pedestrian out of the stem."""

import jax.numpy as jnp

from jaxnav import Scene


def meet(u, robot_speed, speed):
    side = jnp.where(u[0] < 0.5, -1.0, 1.0)
    offsets = [0.8 * (u[i] - 0.5) for i in range(1, 4)]
    start = jnp.minimum(2.0 + 3.0 * speed / robot_speed * u[4], 4.5)  # timed to meet at the mouth of the stem
    robot = (-4.0 * side, offsets[0], 4.0 * side, offsets[1])  # x, y, goal x, goal y
    turn_x, turn_y = offsets[2], 0.0 * u[5]  # a way point in front of the robot; 0.0 * u[5] is 0 in u's shape
    return robot, (offsets[2], -start, turn_x, turn_y, -4.4 * side, 0.8 * (u[6] - 0.5))


WALLS = ((-5.0, -1.0), (-1.0, -1.0), (-1.0, -5.0), (1.0, -5.0), (1.0, -1.0), (5.0, -1.0), (5.0, 1.0), (-5.0, 1.0))
JUNCTION = Scene(
    "junction", chains=(WALLS,), floors=((-5.0, -1.0, 5.0, 1.0), (-1.0, -5.0, 1.0, 1.0)), capacity=16, meet=meet
)
