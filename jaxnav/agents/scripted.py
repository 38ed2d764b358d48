"""Robots that follow a rule instead of a network: a straight line, ORCA, and a planner that uses the dialogue.

They know the map, and of people what the scene gives. Where people have to be read from the scan they have an ideal
tracker: position and velocity of each person in front of the laser with no wall between.
"""

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from ..world import Action, Params, State, World
from ..world.dialogue import fitting_request, may_request
from ..world.geometry import Vec2, closest_approach, norm, unit
from ..world.linear_program import solve
from ..world.orca import agent_half_plane, wall_half_planes
from ..world.people.neighbors import near_walls
from ..world.scenes import SIGHTS
from ..world.sensing import in_sight_of
from ..world.types import LEFT, NONE, REFUSES, RIGHT, STOP
from ..world.walls import wall_clearance


@struct.dataclass
class StraightLine:
    """Full speed toward the goal, silent: the yardstick of a scene's hardness (docs/world.md section 2)."""

    def __call__(self, state: State, world: World, params: Params) -> Action:
        del world
        robot = state.robot
        turn = _turn_toward(robot, robot.goal_x - robot.x, robot.goal_y - robot.y, params)
        return Action(twist=jnp.stack([jnp.ones_like(turn), turn]), request=jnp.int32(NONE))


@struct.dataclass
class OrcaRobot:
    """Toward the goal by way of the passage, as an ORCA agent that expects people to do their half; silent and deaf."""

    def __call__(self, state: State, world: World, params: Params) -> Action:
        return _orca_action(state, world, params)


@struct.dataclass
class Planner:
    """The best of some fifty short plans, judged by where people will be, as the dialogue tells it.

    It asks as soon as it may, obeys, and knows the announced plan; a silent person is expected to walk on as before.

    Attributes:
        hears: bool, whether it uses messages; without, it is deaf.
        speaks: bool, whether it makes requests; without, it is muted.
    """

    hears: jax.Array | bool = True
    speaks: jax.Array | bool = True

    def __call__(self, state: State, world: World, params: Params) -> Action:
        return _planned_action(self, state, world, params)


def _orca_action(state, world, params):
    robot, people, walls = state.robot, state.pedestrians, world.walls(state.scene)
    velocity = Vec2(robot.v * jnp.cos(robot.heading), robot.v * jnp.sin(robot.heading))
    near = near_walls(robot.x, robot.y, walls, params.time_horizon_walls * params.max_v + params.robot_radius, 4)
    wall_planes = wall_half_planes(near, velocity, params.robot_radius, params.time_horizon_walls)
    tracked = _tracked(state, world, walls, params)
    radius = params.robot_radius + params.body_radius
    agent_planes = [
        agent_half_plane(
            Vec2(people.x[i] - robot.x, people.y[i] - robot.y), velocity, Vec2(people.vx[i], people.vy[i]), radius,
            params.time_horizon, params.dt, tracked[i],
        )
        for i in range(world.config.pedestrians)
    ]  # fmt: skip
    target_x, target_y = _local_goal(state, world, walls, params)
    ux, uy = unit(target_x - robot.x, target_y - robot.y)
    vx, vy = solve(wall_planes, agent_planes, Vec2(params.max_v * ux, params.max_v * uy), params.max_v)
    turn = _turn_toward(robot, vx, vy, params)
    # It can't step aside: the part of the velocity that lies ahead is driven, and no more than walls permit that way.
    ahead = jnp.maximum(vx * jnp.cos(robot.heading) + vy * jnp.sin(robot.heading), 0.0)
    chord = robot.heading + 0.5 * turn * params.max_w * params.dt
    for plane in wall_planes:
        closing = -plane.direction.cross(Vec2(jnp.cos(chord), jnp.sin(chord)))
        most = jnp.maximum(-plane.violation(Vec2(jnp.float32(0.0), jnp.float32(0.0))), 0.0) / jnp.maximum(closing, 1e-6)
        ahead = jnp.where(plane.active & (closing > 0), jnp.minimum(ahead, most), ahead)
    return Action(twist=jnp.stack([2.0 * ahead / params.max_v - 1.0, turn]), request=jnp.int32(NONE))


_HORIZON = 9  # steps that are thought ahead
_MARGIN = 0.35  # gap to people below which a plan costs, m
_DETOURS = np.deg2rad(np.arange(-90, 91, 15)).astype(np.float32)
# Every plan: how far off the direction to the goal, how fast, for how many steps until it turns to the goal.
_PLANS = np.array(
    [(0.0, 0.0, _HORIZON), *((d, v, n) for d in _DETOURS for v in (0.5, 1.0) for n in (3, 6))], np.float32
)


def _planned_action(planner, state, world, params):
    robot, walls = state.robot, world.walls(state.scene)
    target_x, target_y = _local_goal(state, world, walls, params)
    direct = jnp.arctan2(target_y - robot.y, target_x - robot.x)
    tracked = _tracked(state, world, walls, params)
    path_x, path_y = jax.vmap(
        lambda person, encounter: _expected_path(person, encounter, planner, state, world, params)
    )(state.pedestrians, state.encounters)

    def cost(plan):
        detour, speed, steps = plan

        def drive(carry, t):
            x, y, heading, total, least = carry
            wanted = jnp.where(t < steps, direct + detour, jnp.arctan2(target_y - y, target_x - x))
            turn = jnp.clip(_wrap(wanted - heading), -params.max_w * params.dt, params.max_w * params.dt)
            # It turns before it drives on: one that looks elsewhere slows down.
            v = params.max_v * speed * jnp.maximum(jnp.cos(_wrap(wanted - heading)), 0.0)
            length = v * params.dt
            new_x, new_y = x + length * jnp.cos(heading + 0.5 * turn), y + length * jnp.sin(heading + 0.5 * turn)
            rx, ry = x - path_x[:, t], y - path_y[:, t]
            ex = new_x - x - (path_x[:, t + 1] - path_x[:, t])
            ey = new_y - y - (path_y[:, t + 1] - path_y[:, t])
            at = closest_approach(Vec2(rx, ry), Vec2(ex, ey))
            gap = norm(rx + at * ex, ry + at * ey) - params.robot_radius - params.body_radius
            soon = 1.0 - t / _HORIZON
            near = jnp.where(tracked, 0.5 * jnp.maximum(_MARGIN - gap, 0.0) / _MARGIN, 0.0)
            hit = tracked & (gap < 0.03)
            wall = wall_clearance(new_x, new_y, walls) - params.robot_radius
            total += jnp.sum(soon * (near + 100.0 * hit)) + jnp.where(wall < 0.04, 60.0 * soon, 0.0)
            least = jnp.minimum(least, norm(target_x - new_x, target_y - new_y))
            return (new_x, new_y, heading + turn, total, least), None

        start = robot.x, robot.y, robot.heading, 0.1 * jnp.abs(detour), norm(target_x - robot.x, target_y - robot.y)
        (*_, total, least), _ = jax.lax.scan(drive, start, jnp.arange(_HORIZON))
        return total + least

    best = jnp.argmin(jax.vmap(cost)(jnp.asarray(_PLANS)))
    detour, speed, _ = jnp.asarray(_PLANS)[best]
    error = _wrap(direct + detour - robot.heading)
    turn = jnp.clip(error / (params.max_w * params.dt), -1.0, 1.0)
    v = speed * jnp.maximum(jnp.cos(error), 0.0)
    return Action(
        twist=jnp.stack([2.0 * v - 1.0, turn]), request=jnp.where(planner.speaks, _request(state, world, params), NONE)
    )


def _request(state, world, params):
    """The request to the nearest person who may be asked: to stop at a passage, elsewhere the one that fits."""
    askable = jax.vmap(may_request)(state.encounters)
    fits = jax.vmap(fitting_request, in_axes=(None, 0))(state.robot, state.pedestrians)
    nearest = jnp.argmin(jnp.where(askable, state.encounters.distance, jnp.inf))
    walls = world.walls(state.scene)
    before_passage = ~_is_clear(state.robot, state.robot.goal_x, state.robot.goal_y, walls, params)
    return jnp.where(before_passage, STOP, fits[nearest])


def _expected_path(person, encounter, planner, state, world, params):
    """(x, y) `[_HORIZON + 1]`: where a person is expected at each step, by what was said as far as it was heard."""
    time = params.dt * jnp.arange(_HORIZON + 1)
    speed = norm(person.vx, person.vy)
    ux, uy = unit(person.vx, person.vy)
    message = jnp.where(planner.hears & encounter.is_open, encounter.message, NONE)
    request = jnp.where(encounter.is_open & (encounter.reply != REFUSES), encounter.request, NONE)

    # A silent person walks on as before; one that announced a side, along its line and to that side of it.
    aside = 0.5 * (params.passing_clearance + params.robot_radius + params.body_radius)
    wanted = jnp.where(message == LEFT, aside, jnp.where(message == RIGHT, -aside, 0.0))
    offset = encounter.ux * (person.y - encounter.y) - encounter.uy * (person.x - encounter.x)
    shift = jnp.where(message == NONE, 0.0, (wanted - offset) * jnp.minimum(time / 0.8, 1.0))
    along_x = jnp.where(message == NONE, person.vx, encounter.ux * params.preferred_speed)
    along_y = jnp.where(message == NONE, person.vy, encounter.uy * params.preferred_speed)
    x, y = person.x + along_x * time - shift * encounter.uy, person.y + along_y * time + shift * encounter.ux

    # A person that is still to come through the passage goes there first, then on along the arm in which the robot is.
    door_x, door_y = _passage(state, world)
    from_x, from_y = state.robot.x - door_x, state.robot.y - door_y
    sideways = jnp.abs(from_x) > jnp.abs(from_y)
    on_x, on_y = jnp.where(sideways, jnp.sign(from_x), 0.0), jnp.where(sideways, 0.0, jnp.sign(from_y))
    side = jnp.where(message == NONE, 0.0, wanted)
    after = jnp.maximum(speed * time - norm(door_x - person.x, door_y - person.y), 0.0)
    aside_by = side * jnp.minimum(after, 1.0)
    before = jnp.minimum(speed * time, norm(door_x - person.x, door_y - person.y))
    in_x, in_y = unit(door_x - person.x, door_y - person.y)
    through_x = person.x + before * in_x + after * on_x - aside_by * on_y
    through_y = person.y + before * in_y + after * on_y + aside_by * on_x
    x, y = jnp.where(person.turned, x, through_x), jnp.where(person.turned, y, through_y)

    # A person that agreed, or hasn't answered, stands, or makes way within a second and then walks beside its line.
    turn = jnp.where(request == LEFT, jnp.pi / 4, -jnp.pi / 4)
    heading = jnp.arctan2(encounter.uy, encounter.ux) + turn
    first = jnp.minimum(time, 1.0)
    margin_x = person.x + first * params.preferred_speed * jnp.cos(heading) + (time - first) * ux * speed
    margin_y = person.y + first * params.preferred_speed * jnp.sin(heading) + (time - first) * uy * speed
    aside_now = (request == RIGHT) | (request == LEFT)
    x, y = jnp.where(aside_now, margin_x, x), jnp.where(aside_now, margin_y, y)
    return jnp.where(request == STOP, person.x, x), jnp.where(request == STOP, person.y, y)


def _tracked(state, world, walls, params):
    """Which people `[P]` the robot knows of: those the scene gives, or those its tracker finds in the scan."""
    robot, people = state.robot, state.pedestrians
    sights = jnp.array([SIGHTS.index(scene.sight) for scene in world.scenes])[state.scene]
    scanned = sights == SIGHTS.index("none")
    visible = in_sight_of(robot, people, walls, jnp.where(scanned, SIGHTS.index("line"), sights))
    dx, dy = people.x - robot.x, people.y - robot.y
    ahead = dx * jnp.cos(robot.heading) + dy * jnp.sin(robot.heading) > 0
    return people.present & visible & (~scanned | (ahead & (norm(dx, dy) < params.scan_range)))


def _local_goal(state, world, walls, params):
    """The goal, or the scene's passage as long as walls stand in the way."""
    robot = state.robot
    x, y = _passage(state, world)
    direct = _is_clear(robot, robot.goal_x, robot.goal_y, walls, params)
    return jnp.where(direct, robot.goal_x, x), jnp.where(direct, robot.goal_y, y)


def _passage(state, world):
    """The scene's passage, or the goal where the way is straight."""
    passages = [scene.passage or (np.nan, np.nan) for scene in world.scenes]
    x, y = (jnp.array([passage[i] for passage in passages])[state.scene] for i in (0, 1))
    return jnp.where(jnp.isnan(x), state.robot.goal_x, x), jnp.where(jnp.isnan(y), state.robot.goal_y, y)


def _is_clear(robot, x, y, walls, params):
    """Whether the robot could drive straight to (x, y)."""
    share = jnp.linspace(0.0, 1.0, 24)
    gaps = wall_clearance(robot.x + share * (x - robot.x), robot.y + share * (y - robot.y), walls)
    return jnp.min(gaps[4:]) > params.robot_radius + 0.03


def _turn_toward(robot, x, y, params):
    """The turning rate, in [-1, 1], that brings the heading nearest to the direction (x, y)."""
    return jnp.clip(_wrap(jnp.arctan2(y, x) - robot.heading) / (params.max_w * params.dt), -1.0, 1.0)


def _wrap(angle):
    return jnp.arctan2(jnp.sin(angle), jnp.cos(angle))
