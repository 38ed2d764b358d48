"""IRVO pedestrians: ORCA walkers that stop or make way when asked, keep their word, and respect walls.

Source: docs/world.md section 6 and 7.
"""

import jax
import jax.numpy as jnp

from . import dialogue, orca
from .geometry import closest_on_segment, cross2d, norm, unit
from .types import LEFT, NONE, RIGHT, STOP

_COS_45 = 0.70710678


def preferred_velocity(pedestrian, encounter, fate, params):
    """Where the pedestrian wants to go: to its goal, or as a request or its own announcement says."""
    to_x, to_y = pedestrian.goal_x - pedestrian.x, pedestrian.goal_y - pedestrian.y
    ux, uy = unit(to_x, to_y)
    # The last step toward the goal ends on it.
    walk = jnp.minimum(params.preferred_speed, norm(to_x, to_y) / params.dt)

    request = dialogue.obeyed_request(encounter, fate, params)
    turn = jnp.where(request == LEFT, _COS_45, -_COS_45)
    margin_x, margin_y = _COS_45 * encounter.ux - turn * encounter.uy, _COS_45 * encounter.uy + turn * encounter.ux

    # A committed pedestrian tracks a line parallel to the one it was on, half the passing distance to its side. One
    # that commits late has a second left for it, hence up to 72 degrees off its direction, not 45.
    aside = 0.5 * (params.passing_clearance + params.robot_radius + params.body_radius)
    target = jnp.where(encounter.message == LEFT, aside, jnp.where(encounter.message == RIGHT, -aside, 0.0))
    offset = cross2d(encounter.ux, encounter.uy, pedestrian.x - encounter.x, pedestrian.y - encounter.y)
    lateral = jnp.clip((target - offset) / (params.preferred_speed * params.dt + 1e-6), -3.0, 3.0)
    line_x, line_y = unit(encounter.ux - lateral * encounter.uy, encounter.uy + lateral * encounter.ux)

    committed = dialogue.is_committed(encounter, fate)
    aside_now = (request == RIGHT) | (request == LEFT)
    dx = jnp.where(aside_now, margin_x, jnp.where(committed, line_x, ux))
    dy = jnp.where(aside_now, margin_y, jnp.where(committed, line_y, uy))
    speed = jnp.where(request == STOP, 0.0, jnp.where((request != NONE) | committed, params.preferred_speed, walk))
    return speed * dx, speed * dy


def nearest_walls(x, y, walls, count):
    """The ``count`` wall points nearest to (x, y), relative to it: a list of (squared distance, dx, dy), sorted."""
    start = (jnp.float32(jnp.inf), jnp.float32(1.0), jnp.float32(0.0))

    def insert(nearest, wall):
        ax, ay, bx, by, solid = wall
        qx, qy = closest_on_segment(x, y, ax, ay, bx, by)
        dx, dy = qx - x, qy - y
        carried = jnp.where(solid, dx * dx + dy * dy, jnp.inf), dx, dy
        kept = []
        for held in nearest:
            swap = carried[0] < held[0]
            kept.append(tuple(jnp.where(swap, new, old) for new, old in zip(carried, held, strict=True)))
            carried = tuple(jnp.where(swap, old, new) for new, old in zip(carried, held, strict=True))
        return kept, None

    return jax.lax.scan(insert, [start] * min(count, walls.solid.shape[0]), walls.segments())[0]


def choose_velocity(pedestrian, encounter, fate, robot, others, walls, config, params):
    """New velocity of one pedestrian: the permitted one nearest to `preferred_velocity`.

    others: list of (px, py, vx, vy, active), its neighbours relative to it, nearest first.
    """
    want_x, want_y = preferred_velocity(pedestrian, encounter, fate, params)
    wall_planes = [
        orca.wall_half_plane(dx, dy, params.body_radius, params.time_horizon_walls, params.dt, squared < jnp.inf)
        for squared, dx, dy in nearest_walls(pedestrian.x, pedestrian.y, walls, config.wall_neighbors)
    ]
    px, py = robot.x - pedestrian.x, robot.y - pedestrian.y
    sees_robot = (norm(px, py) < params.awareness) & ~dialogue.is_committed(encounter, fate)
    robot_vx, robot_vy = robot.v * jnp.cos(robot.heading), robot.v * jnp.sin(robot.heading)
    agents = [(px, py, robot_vx, robot_vy, params.robot_radius + params.body_radius, sees_robot)]
    agents += [(*other[:4], 2 * params.body_radius, other[4]) for other in others]
    agent_planes = [
        orca.agent_half_plane(
            px, py, pedestrian.vx, pedestrian.vy, vx, vy, radius, params.time_horizon, params.dt, active
        )
        for px, py, vx, vy, radius, active in agents
    ]
    return orca.solve(wall_planes, agent_planes, want_x, want_y, params.max_speed)


def neighbors(pedestrians, config, params):
    """For each pedestrian the others it avoids, nearest first: a list of (px, py, vx, vy, active), each `[P]`."""
    dx = pedestrians.x[None, :] - pedestrians.x[:, None]
    dy = pedestrians.y[None, :] - pedestrians.y[:, None]
    squared = jnp.where(jnp.eye(config.pedestrians, dtype=bool), jnp.inf, dx * dx + dy * dy)
    count = min(config.max_neighbors, config.pedestrians - 1)
    index = jax.lax.top_k(-squared, count)[1]

    def pick(table, k):
        return jnp.take_along_axis(table, index[:, k : k + 1], axis=1)[:, 0]

    return [
        (
            pick(dx, k), pick(dy, k), pedestrians.vx[index[:, k]], pedestrians.vy[index[:, k]],
            pick(squared, k) < params.neighbor_distance**2,
        )
        for k in range(count)
    ]  # fmt: skip


def walk(pedestrians, encounters, fates, robot, walls, config, params):
    """All pedestrians `[P]` after one step of ``dt``; the robot is where it was at the step's beginning."""
    others = neighbors(pedestrians, config, params)
    vx, vy = jax.vmap(lambda p, e, f, o: choose_velocity(p, e, f, robot, o, walls, config, params))(
        pedestrians, encounters, fates, others
    )
    return pedestrians.replace(x=pedestrians.x + vx * params.dt, y=pedestrians.y + vy * params.dt, vx=vx, vy=vy)
