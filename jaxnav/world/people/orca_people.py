"""People who move by ORCA: at the permitted velocity nearest to the one they want.

Source: van den Berg et al. 2011; docs/world.md section 7.
"""

import dataclasses

import jax
import jax.numpy as jnp

from .. import linear_program, orca
from ..config import WorldConfig
from ..geometry import Vec2, norm
from ..params import Params
from ..types import Pedestrian, Robot, Walls
from .intention import Intention
from .model import PedestrianModel, Surroundings
from .neighbors import near_pedestrians, near_walls


@dataclasses.dataclass(frozen=True)
class OrcaPeople(PedestrianModel):
    """Agents of ORCA among each other, the robot within ``awareness``, and walls; each does half of the effort.

    Velocities are chosen once a step of ``dt``, at which everybody then walks for its whole length.
    """

    def step(
        self, pedestrians: Pedestrian, memory: None, intentions: Intention, surroundings: Surroundings,
        config: WorldConfig, params: Params,
    ) -> tuple[Pedestrian, None]:  # fmt: skip
        """All pedestrians `[P]` a step later."""

        def one(i, pedestrian, intention):
            others = near_pedestrians(i, pedestrians, config, params)
            robot, walls = surroundings.robot, surroundings.walls
            return choose_velocity(pedestrian, intention, robot, others, walls, config, params)

        indices = jnp.arange(config.pedestrians, dtype=jnp.int32)
        vx, vy = jax.vmap(one)(indices, pedestrians, intentions)
        x, y = pedestrians.x + vx * params.dt, pedestrians.y + vy * params.dt
        return pedestrians.replace(x=x, y=y, vx=vx, vy=vy), memory


def choose_velocity(
    pedestrian: Pedestrian, intention: Intention, robot: Robot, others: list[tuple], walls: Walls,
    config: WorldConfig, params: Params,
) -> tuple[jax.Array, jax.Array]:  # fmt: skip
    """New velocity (vx, vy) of one pedestrian: the permitted one nearest to what it intends.

    others: list of (px, py, vx, vy, active), its neighbours relative to it, nearest first.
    """
    # No further than it could walk within the horizon, as in RVO2.
    reach = params.time_horizon_walls * params.max_speed + params.body_radius
    near = near_walls(pedestrian.x, pedestrian.y, walls, reach, config.wall_neighbors)
    velocity = Vec2(pedestrian.vx, pedestrian.vy)
    wall_planes = orca.wall_half_planes(near, velocity, params.body_radius, params.time_horizon_walls)
    px, py = robot.x - pedestrian.x, robot.y - pedestrian.y
    sees_robot = (norm(px, py) < params.awareness) & ~intention.ignores_robot
    robot_vx, robot_vy = robot.v * jnp.cos(robot.heading), robot.v * jnp.sin(robot.heading)
    agents = [(px, py, robot_vx, robot_vy, params.robot_radius + params.body_radius, sees_robot)]
    agents += [(*other[:4], 2 * params.body_radius, other[4]) for other in others]
    return permitted_velocity(velocity, Vec2(intention.vx, intention.vy), wall_planes, agents, params)


def permitted_velocity(
    velocity: Vec2, wanted: Vec2, wall_planes: list[orca.HalfPlane], agents: list[tuple], params: Params
) -> Vec2:
    """The velocity nearest to the wanted one at which an agent that moves at ``velocity`` keeps clear of all.

    wall_planes: half-planes of the walls; agents: list of (px, py, vx, vy, sum of radii, active), relative positions.
    """
    agent_planes = [
        orca.agent_half_plane(Vec2(px, py), velocity, Vec2(vx, vy), radius, params.time_horizon, params.dt, active)
        for px, py, vx, vy, radius, active in agents
    ]
    return linear_program.solve(wall_planes, agent_planes, wanted, params.max_speed)
