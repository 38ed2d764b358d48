"""The intention of a pedestrian: a velocity, by its goal and by what was said, and whether it yields to the robot.

Source: docs/world.md sections 6 and 7.
"""

import jax
import jax.numpy as jnp
from flax import struct

from .. import dialogue
from ..dialogue import COS_45
from ..geometry import cross2d, norm, unit
from ..params import Params
from ..types import LEFT, NONE, RIGHT, STOP, Encounter, Pedestrian, PedestrianTraits

_TURN = 0.3  # from its way point a pedestrian turns toward its goal


@struct.dataclass
class Intention:
    """The intention that a model of pedestrians carries out. For all pedestrians every field is `[P]`.

    vx, vy: the velocity it wants, m/s; ignores_robot: bool, it keeps to what it announced or decided and doesn't yield.
    """

    vx: jax.Array
    vy: jax.Array
    ignores_robot: jax.Array


def intend(pedestrians: Pedestrian, encounters: Encounter, traits: PedestrianTraits, params: Params) -> Intention:
    """`Intention` `[P]` of pedestrians `[P]`."""

    def one(pedestrian, encounter, traits):
        vx, vy = preferred_velocity(pedestrian, encounter, traits, params)
        decided = dialogue.is_committed(encounter, traits) | dialogue.decides_alone(encounter, traits, params)
        return Intention(vx=vx, vy=vy, ignores_robot=decided)

    return jax.vmap(one)(pedestrians, encounters, traits)


def preferred_velocity(
    pedestrian: Pedestrian, encounter: Encounter, traits: PedestrianTraits, params: Params
) -> tuple[jax.Array, jax.Array]:
    """Where one pedestrian wants to go, (vx, vy): to its goal, or as a request, its announcement or its choice says."""
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


def turn(pedestrians: Pedestrian) -> Pedestrian:
    """The same pedestrians, of whom those have turned toward their goal who are near their way point."""
    near = norm(pedestrians.via_x - pedestrians.x, pedestrians.via_y - pedestrians.y) < _TURN
    return pedestrians.replace(turned=pedestrians.turned | near)
