"""IRVO pedestrians: ORCA walkers that stop or make way when asked, keep their word, and respect walls.

Source: docs/world.md section 6 and 7.
"""

import itertools

import jax
import jax.numpy as jnp

from . import dialogue, linear_program, orca
from .dialogue import COS_45
from .geometry import cross2d, insert_nearest, norm, unit
from .types import LEFT, NONE, RIGHT, STOP
from .walls import nearest_walls

_TURN = 0.3  # from its way point a pedestrian turns toward its goal


def preferred_velocity(pedestrian, encounter, traits, params):
    """Where the pedestrian wants to go: to its goal, or as a request, its announcement or its own late choice says."""
    target_x, target_y = pedestrian.target()
    to_x, to_y = target_x - pedestrian.x, target_y - pedestrian.y
    ux, uy = unit(to_x, to_y)
    # The last step toward the goal ends on it.
    arriving = jnp.minimum(params.preferred_speed, norm(to_x, to_y) / params.dt)
    walk = jnp.where(pedestrian.turned, arriving, params.preferred_speed)

    request = dialogue.obeyed_request(encounter, traits, params)
    turn = jnp.where(request == LEFT, COS_45, -COS_45)
    margin_x, margin_y = COS_45 * encounter.ux - turn * encounter.uy, COS_45 * encounter.uy + turn * encounter.ux

    # A committed pedestrian tracks a line parallel to the one it was on, half the passing distance to its side. One
    # that commits late has a second left for it, hence up to 72 degrees off its direction, not 45. Before a way point,
    # a door or a corner, there is no room for sides.
    committed = dialogue.is_committed(encounter, traits)
    alone = dialogue.decides_alone(encounter, traits, params)
    side = jnp.where(committed, encounter.message, jnp.where(traits.side < 0.5, RIGHT, LEFT))
    aside = 0.5 * (params.passing_clearance + params.robot_radius + params.body_radius)
    target = jnp.where(side == LEFT, aside, jnp.where(side == RIGHT, -aside, 0.0))
    offset = cross2d(encounter.ux, encounter.uy, pedestrian.x - encounter.x, pedestrian.y - encounter.y)
    lateral = jnp.clip((target - offset) / (params.preferred_speed * params.dt + 1e-6), -3.0, 3.0)
    line_x, line_y = unit(encounter.ux - lateral * encounter.uy, encounter.uy + lateral * encounter.ux)

    aside_now = (request == RIGHT) | (request == LEFT)
    on_line = (committed | alone) & pedestrian.turned
    dx = jnp.where(aside_now, margin_x, jnp.where(on_line, line_x, ux))
    dy = jnp.where(aside_now, margin_y, jnp.where(on_line, line_y, uy))
    speed = jnp.where(request == STOP, 0.0, jnp.where((request != NONE) | on_line, params.preferred_speed, walk))
    return speed * dx, speed * dy


def near_walls(x, y, walls, reach, count):
    """The ``count`` walls nearest to (x, y) within ``reach``: a list of `orca.NearWall`, nearest first."""
    found = []
    for squared, i in nearest_walls(x, y, walls.near(x, y), count):
        vertices = [(walls.x[k] - x, walls.y[k] - y) for k in (walls.before[i], i, i + 1, walls.after[i])]
        found.append(orca.NearWall(*itertools.chain(*vertices), active=squared < reach * reach))
    return found


def choose_velocity(pedestrian, encounter, traits, robot, others, walls, config, params):
    """New velocity of one pedestrian: the permitted one nearest to `preferred_velocity`.

    others: list of (px, py, vx, vy, active), its neighbours relative to it, nearest first.
    """
    want_x, want_y = preferred_velocity(pedestrian, encounter, traits, params)
    # No further than it could walk within the horizon, as in RVO2.
    reach = params.time_horizon_walls * params.max_speed + params.body_radius
    near = near_walls(pedestrian.x, pedestrian.y, walls, reach, config.wall_neighbors)
    wall_planes = orca.wall_half_planes(
        near, pedestrian.vx, pedestrian.vy, params.body_radius, params.time_horizon_walls
    )
    px, py = robot.x - pedestrian.x, robot.y - pedestrian.y
    decided = dialogue.is_committed(encounter, traits) | dialogue.decides_alone(encounter, traits, params)
    sees_robot = (norm(px, py) < params.awareness) & ~decided
    robot_vx, robot_vy = robot.v * jnp.cos(robot.heading), robot.v * jnp.sin(robot.heading)
    agents = [(px, py, robot_vx, robot_vy, params.robot_radius + params.body_radius, sees_robot)]
    agents += [(*other[:4], 2 * params.body_radius, other[4]) for other in others]
    agent_planes = [
        orca.agent_half_plane(
            px, py, pedestrian.vx, pedestrian.vy, vx, vy, radius, params.time_horizon, params.dt, active
        )
        for px, py, vx, vy, radius, active in agents
    ]
    return linear_program.solve(wall_planes, agent_planes, want_x, want_y, params.max_speed)


def near_pedestrians(i, pedestrians, config, params):
    """The pedestrians `[P]` nearest to number i: a list of (px, py, vx, vy, active) relative to it, nearest first."""
    x, y = pedestrians.x[i], pedestrians.y[i]

    def insert(held, other):
        j, other_x, other_y, present = other
        squared = jnp.where((j == i) | ~present, jnp.inf, (other_x - x) ** 2 + (other_y - y) ** 2)
        return insert_nearest(held, squared, j), None

    start = [(jnp.full_like(x, jnp.inf), jnp.int32(0))] * min(config.max_neighbors, config.pedestrians - 1)
    indices = jnp.arange(config.pedestrians, dtype=jnp.int32)
    found = jax.lax.scan(insert, start, (indices, pedestrians.x, pedestrians.y, pedestrians.present))[0]
    return [
        (
            pedestrians.x[j] - x, pedestrians.y[j] - y, pedestrians.vx[j], pedestrians.vy[j],
            squared < params.neighbor_distance**2,
        )
        for squared, j in found
    ]  # fmt: skip


def walk(pedestrians, encounters, traits, robot, walls, config, params):
    """All pedestrians `[P]` after one step of ``dt``; the robot is where it was at the step's beginning."""

    def one(i, pedestrian, encounter, traits):
        others = near_pedestrians(i, pedestrians, config, params)
        return choose_velocity(pedestrian, encounter, traits, robot, others, walls, config, params)

    indices = jnp.arange(config.pedestrians, dtype=jnp.int32)
    vx, vy = jax.vmap(one)(indices, pedestrians, encounters, traits)
    x, y = pedestrians.x + vx * params.dt, pedestrians.y + vy * params.dt
    turned = pedestrians.turned | (norm(pedestrians.via_x - x, pedestrians.via_y - y) < _TURN)
    return pedestrians.replace(x=x, y=y, vx=vx, vy=vy, turned=turned)
