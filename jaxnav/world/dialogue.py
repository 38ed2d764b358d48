"""Encounters: when a dialogue opens and closes, who speaks, what is said, and what is done about it.

Everything is per pedestrian; only `address` looks at all of them. Source: docs/world.md section 6.
"""

import jax
import jax.numpy as jnp

from .geometry import Vec2, closest_approach, cross2d, norm, unit
from .lidar import raycast
from .params import Params
from .types import (
    AGREES,
    LEFT,
    NONE,
    REFUSES,
    RIGHT,
    STOP,
    Encounter,
    Pedestrian,
    PedestrianTraits,
    Robot,
    SeenPedestrian,
    Walls,
)

_REFERENCE_SPEED = 0.5  # the walking speed at which a gate opens at exactly `encounter_distance`
COS_45 = 0.70710678


def start(pedestrian: Pedestrian, robot: Robot) -> Encounter:
    """The `Encounter` of a pedestrian before anything has happened."""
    off, none, zero = jnp.bool_(False), jnp.int32(0), jnp.zeros(())
    return Encounter(
        met=off, is_open=off, age=none, pedestrian_first=off, message=none, message_age=none, request=none,
        request_age=none, reply=none, utterance=jnp.uint32(0), grown=none,
        distance=norm(pedestrian.x - robot.x, pedestrian.y - robot.y),
        x=zero, y=zero, ux=zero, uy=zero, robot_x=zero, robot_y=zero, robot_ux=zero, robot_uy=zero,
    )  # fmt: skip


def may_request(encounter: Encounter | SeenPedestrian) -> jax.Array:
    """Whether a request to this pedestrian would count: gate open, the robot's turn, nothing asked yet."""
    return encounter.is_open & ~encounter.pedestrian_first & (encounter.request == NONE)


def address(encounters: Encounter, request: jax.Array) -> jax.Array:
    """The request to each pedestrian `[P]`: ``request`` for the nearest that may be asked, none for the others."""
    askable = may_request(encounters)
    nearest = jnp.argmin(jnp.where(askable, encounters.distance, jnp.inf))
    addressed = askable & (jnp.arange(askable.shape[0]) == nearest)
    return jnp.where(addressed, request, NONE)


def receive(encounter: Encounter, asked: jax.Array, traits: PedestrianTraits, params: Params) -> Encounter:
    """Register a request and reply to it once the pedestrian has taken its 0-2 steps to answer."""
    request = jnp.where(asked != NONE, asked, encounter.request)
    answers = encounter.is_open & (request != NONE) & (encounter.request_age >= traits.reply_delay)
    reply = jnp.where(answers, jnp.where(traits.compliance < params.compliance, AGREES, REFUSES), encounter.reply)
    return encounter.replace(request=request, reply=reply)


def mute(traits: PedestrianTraits) -> PedestrianTraits:
    """The same traits of people who take no part in dialogue: they never speak first, and never answer in time."""
    return traits.replace(
        first=jnp.ones_like(traits.first), reply_delay=jnp.full_like(traits.reply_delay, jnp.iinfo(jnp.int32).max)
    )


def speak(encounter: Encounter, robot: Robot, pedestrian: Pedestrian, message: int | jax.Array) -> Encounter:
    """The encounter after the pedestrian, unprompted, has said ``message``: open, and its turn from now on.

    For people who are not simulated: those of the world speak when an encounter opens (`advance`).
    """
    ux, uy = _walking_direction(pedestrian)
    robot_ux, robot_uy = unit(robot.goal_x - robot.x, robot.goal_y - robot.y)
    yes, zero = jnp.bool_(True), jnp.int32(0)
    return encounter.replace(
        met=yes, is_open=yes, age=zero, pedestrian_first=yes, message=jnp.int32(message), message_age=zero,
        request=zero, request_age=zero, reply=zero, utterance=jnp.uint32(1), grown=zero,
        distance=norm(pedestrian.x - robot.x, pedestrian.y - robot.y), x=pedestrian.x, y=pedestrian.y, ux=ux, uy=uy,
        robot_x=robot.x, robot_y=robot.y, robot_ux=robot_ux, robot_uy=robot_uy,
    )  # fmt: skip


def obeyed_request(encounter: Encounter, traits: PedestrianTraits, params: Params) -> jax.Array:
    """The request the pedestrian is carrying out in this step, else none."""
    obeys = encounter.is_open & (encounter.reply == AGREES)
    obeys &= encounter.request_age - traits.reply_delay < params.obey_steps
    return jnp.where(obeys, encounter.request, NONE)


def is_committed(encounter: Encounter, traits: PedestrianTraits) -> jax.Array:
    """Whether the pedestrian carries out what it announced and no longer avoids the robot."""
    return encounter.is_open & encounter.pedestrian_first & (encounter.message_age >= traits.commit_delay)


def decides_alone(encounter: Encounter, traits: PedestrianTraits, params: Params) -> jax.Array:
    """Whether a pedestrian with whom nothing is agreed has picked a side of its own and no longer avoids the robot."""
    alone = encounter.is_open & ~encounter.pedestrian_first & (encounter.reply != AGREES)
    return alone & (encounter.age >= traits.decide_delay) & (traits.decides < params.p_decides_late)


def fitting_request(robot: Robot, pedestrian: Pedestrian) -> jax.Array:
    """The request that suits the geometry: stop for crossing headings, else the side the pedestrian is on already."""
    ux, uy = _walking_direction(pedestrian)
    path_x, path_y = unit(robot.goal_x - robot.x, robot.goal_y - robot.y)
    # From the pedestrian to the nearest point of the robot's path: the part of the offset that is across the path.
    dx, dy = robot.x - pedestrian.x, robot.y - pedestrian.y
    along = dx * path_x + dy * path_y
    path_is_left = cross2d(ux, uy, dx - along * path_x, dy - along * path_y) > 0
    return jnp.where(_is_crossing(robot, ux, uy), STOP, jnp.where(path_is_left, RIGHT, LEFT))


def follows_message(encounter: Encounter, robot: Robot) -> jax.Array:
    """Whether the robot, at the end of a step, does what it was asked (docs/world.md section 8, r_res)."""
    left_of_line = cross2d(
        encounter.robot_ux, encounter.robot_uy, robot.x - encounter.robot_x, robot.y - encounter.robot_y
    )
    stops = (encounter.message == STOP) & (robot.v <= 0.15)
    right = (encounter.message == RIGHT) & ((robot.w < 0) | (left_of_line <= -0.3))
    left = (encounter.message == LEFT) & ((robot.w > 0) | (left_of_line >= 0.3))
    return encounter.is_open & (stops | right | left)


def advance(
    encounter: Encounter,
    traits: PedestrianTraits,
    robot: Robot,
    pedestrian: Pedestrian,
    turns: jax.Array,
    walls: Walls,
    word: jax.Array,
    params: Params,
) -> Encounter:
    """Close or open the gate after a step; a pedestrian that is first speaks at opening.

    turns: whether the pedestrian has just passed its way point; word: a random uint32, whose lower 16 bits, plus 1,
    become the wording of what is said (a message, or small talk).
    """
    px, py = pedestrian.x - robot.x, pedestrian.y - robot.y
    distance = norm(px, py)
    grown = jnp.where(distance > encounter.distance, encounter.grown + 1, 0)
    # A pedestrian that leaves ends its encounter; one that comes in its place may have another.
    stays = encounter.is_open & (grown < 2) & pedestrian.present
    opens = ~encounter.met & pedestrian.present & _gate(px, py, pedestrian, robot, params)

    ux, uy = _walking_direction(pedestrian)
    robot_ux, robot_uy = unit(robot.goal_x - robot.x, robot.goal_y - robot.y)
    first = jnp.where(opens, traits.first < params.p_pedestrian_first, encounter.pedestrian_first)
    speaks = opens & first
    message = jnp.where(speaks, _message(traits, robot, pedestrian, ux, uy, walls, params), encounter.message)
    message = jnp.where(stays | opens, message, NONE)
    request = jnp.where(stays, encounter.request, NONE)

    # Half of the bits decide on small talk, the other half choose its wording; 0 would mean silence.
    chats = pedestrian.present & ((word >> 16).astype(jnp.float32) < params.small_talk * 65536.0)
    held = jnp.where(message != NONE, encounter.utterance, 0)
    utterance = jnp.where(speaks | (chats & (message == NONE)), (word & 0xFFFF) + 1, held)

    def freeze(now, before, anew: jax.Array | bool = False):
        return jnp.where(opens | anew, now, before)

    return encounter.replace(
        met=(encounter.met | opens) & pedestrian.present,
        is_open=stays | opens,
        age=jnp.where(stays, encounter.age + 1, 0),
        pedestrian_first=first & (stays | opens),
        message=message,
        message_age=jnp.where(stays & (message != NONE), encounter.message_age + 1, 0),
        request=request,
        request_age=jnp.where(request != NONE, encounter.request_age + 1, 0),
        reply=jnp.where(stays, encounter.reply, NONE),
        utterance=utterance,
        distance=distance,
        grown=jnp.where(opens, 0, grown),
        x=freeze(pedestrian.x, encounter.x, turns),
        y=freeze(pedestrian.y, encounter.y, turns),
        ux=freeze(ux, encounter.ux, turns),
        uy=freeze(uy, encounter.uy, turns),
        robot_x=freeze(robot.x, encounter.robot_x),
        robot_y=freeze(robot.y, encounter.robot_y),
        robot_ux=freeze(robot_ux, encounter.robot_ux),
        robot_uy=freeze(robot_uy, encounter.robot_uy),
    )


def _gate(px, py, pedestrian, robot, params):
    """Close enough, and predicted to come closer than ``encounter_clearance`` soon; from observables only."""
    speed = norm(pedestrian.vx, pedestrian.vy)
    growth = (params.max_v + speed) / (params.max_v + _REFERENCE_SPEED)
    near = norm(px, py) < params.encounter_distance * jnp.maximum(growth, 1.0)
    vx = pedestrian.vx - robot.v * jnp.cos(robot.heading)
    vy = pedestrian.vy - robot.v * jnp.sin(robot.heading)
    t = closest_approach(Vec2(px, py), Vec2(vx, vy), params.encounter_horizon)
    return near & (norm(px + t * vx, py + t * vy) < params.encounter_clearance)


def _walking_direction(pedestrian):
    """Unit vector toward where the pedestrian walks to: it has one even while standing."""
    x, y = pedestrian.target()
    x, y = x - pedestrian.x, y - pedestrian.y
    # A pedestrian on its target has no direction: rounding must not become the gradient of one.
    arrived = x * x + y * y <= 1e-12
    return tuple(jnp.where(arrived, jax.lax.stop_gradient(u), u) for u in unit(x, y))


def _is_crossing(robot, ux, uy):
    """Whether the headings differ by 45 to 135 degrees."""
    return jnp.abs(jnp.cos(robot.heading) * ux + jnp.sin(robot.heading) * uy) <= COS_45


def _message(traits, robot, pedestrian, ux, uy, walls, params):
    """The announced message: stop when crossing, else the wider side; another one in a share of the cases."""
    beams = Vec2(jnp.zeros(2), jnp.array([1.0, -1.0]))  # straight left and right
    x, y = pedestrian.x, pedestrian.y
    free_left, free_right = raycast(Vec2(x, y), Vec2(ux, uy), walls.near(x, y), beams, params.scan_range)
    side = jnp.where(free_right >= free_left, RIGHT, LEFT)
    usual = jnp.where(_is_crossing(robot, ux, uy), STOP, side)
    # One draw decides on the exception and, where there is one, which of the other two messages it is.
    shift = jnp.where(traits.message < 0.5 * params.message_exceptions, 1, 2)
    other = (usual - 1 + shift) % 3 + 1
    return jnp.where(traits.message < params.message_exceptions, other, usual)
