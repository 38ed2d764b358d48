"""People who move by the social force model: what pushes them adds up, and they give in to it in time.

Source: Helbing and Molnar, "Social force model for pedestrian dynamics", Physical Review E 51, 1995, whose numbers are
the defaults of `Params`; docs/world.md section 7.
"""

import dataclasses

import jax
import jax.numpy as jnp

from ..config import WorldConfig
from ..geometry import Vec2, closest_on_segment, norm, unit
from ..params import Params
from ..types import Pedestrian, Walls
from ..walls import nearest_walls
from .intention import Intention
from .model import PedestrianModel, Surroundings

_NEAREST = 0.01  # m: nobody's ellipse is thinner, so that forces at its ends stay finite
_SAME = 1e-4  # m: two walls whose nearest points are closer than this push once, at their common corner


@dataclasses.dataclass(frozen=True)
class SocialForce(PedestrianModel):
    """Pedestrians whom everybody within ``neighbor_distance`` repels, the robot within ``awareness``, and near walls.

    The robot repels as a pedestrian of its velocity would, unless a pedestrian is committed or has decided; then it
    doesn't. Bodies have no size here, as in the source: nothing but the force keeps them apart.

    substeps: into so many a step is divided. A step of 0.4 s is as long as it takes to give in to a force, and a
    wall's force changes e-fold in 0.2 m: one such step would end 0.2 m off. With 16 a dense crowd is within 1 cm of 128
    in half of all steps, and within 2 cm in nine of ten.
    """

    substeps: int = 16

    def __post_init__(self):
        if not isinstance(self.substeps, int) or self.substeps < 1:
            raise ValueError(f"substeps is {self.substeps!r}: give a whole number of at least 1")

    def step(
        self, pedestrians: Pedestrian, memory: None, intentions: Intention, surroundings: Surroundings,
        config: WorldConfig, params: Params,
    ) -> tuple[Pedestrian, None]:  # fmt: skip
        """All pedestrians `[P]` a step later: semi-implicit Euler, each sub-step at most ``max_speed`` fast."""
        robot, dt = surroundings.robot, params.dt / self.substeps
        robot_vx, robot_vy = robot.v * jnp.cos(robot.heading), robot.v * jnp.sin(robot.heading)
        # Which walls are near is looked up once; where on them the nearest points are, in every sub-step.
        segments = jax.vmap(lambda x, y: _near_segments(x, y, surroundings.walls, config.wall_neighbors))(
            pedestrians.x, pedestrians.y
        )
        others = jnp.arange(config.pedestrians)

        def substep(carry, k):
            x, y, vx, vy = carry
            # The robot goes on at its velocity of the step's beginning.
            robot_x, robot_y = robot.x + k * dt * robot_vx, robot.y + k * dt * robot_vy

            def one(i, x_i, y_i, vx_i, vy_i, intention, segments):
                forces = [relaxation(vx_i, vy_i, intention.vx, intention.vy, params)]

                def of(other_x, other_y, other_vx, other_vy, reach):
                    dx, dy = x_i - other_x, y_i - other_y
                    fx, fy = repulsion(dx, dy, other_vx, other_vy, params)
                    weight = view_weight(intention.vx, intention.vy, fx, fy, params)
                    weight = jnp.where(norm(dx, dy) < reach, weight, 0.0)
                    return weight * fx, weight * fy

                fx, fy = jax.vmap(of, in_axes=(0, 0, 0, 0, None))(x, y, vx, vy, params.neighbor_distance)
                counts = pedestrians.present & (others != i)
                forces.append((jnp.sum(jnp.where(counts, fx, 0.0)), jnp.sum(jnp.where(counts, fy, 0.0))))
                reach = jnp.where(intention.ignores_robot, 0.0, params.awareness)
                forces.append(of(robot_x, robot_y, robot_vx, robot_vy, reach))
                forces.append(wall_repulsion(x_i, y_i, segments, params))
                new_vx = vx_i + dt * sum(fx for fx, _ in forces)
                new_vy = vy_i + dt * sum(fy for _, fy in forces)
                slower = jnp.minimum(params.max_speed / jnp.maximum(norm(new_vx, new_vy), 1e-6), 1.0)
                return slower * new_vx, slower * new_vy

            vx, vy = jax.vmap(one)(others, x, y, vx, vy, intentions, segments)
            return (x + dt * vx, y + dt * vy, vx, vy), None

        start = pedestrians.x, pedestrians.y, pedestrians.vx, pedestrians.vy
        x, y, vx, vy = jax.lax.scan(substep, start, jnp.arange(self.substeps))[0]
        return pedestrians.replace(x=x, y=y, vx=vx, vy=vy), memory


def relaxation(vx: jax.Array, vy: jax.Array, want_x: jax.Array, want_y: jax.Array, params: Params) -> tuple:
    """Acceleration toward the wanted velocity, m/s^2 (equation 2)."""
    return (want_x - vx) / params.relaxation_time, (want_y - vy) / params.relaxation_time


def repulsion(dx: jax.Array, dy: jax.Array, other_vx: jax.Array, other_vy: jax.Array, params: Params) -> tuple:
    """Acceleration by somebody else, m/s^2: minus the gradient of a potential with elliptical contours (equation 3).

    dx, dy: from the other one; other_vx, other_vy: its velocity. The ellipse has one focus where it is and one where it
    will be ``stride_time`` later: it claims the ground ahead of it.
    """
    ahead_x, ahead_y = other_vx * params.stride_time, other_vy * params.stride_time
    far_x, far_y = dx - ahead_x, dy - ahead_y
    both = norm(dx, dy) + norm(far_x, far_y)
    squared = 0.25 * (both * both - ahead_x * ahead_x - ahead_y * ahead_y)
    b = jnp.sqrt(jnp.maximum(squared, _NEAREST**2))  # the semi-minor axis
    ux, uy = unit(dx, dy)
    wx, wy = unit(far_x, far_y)
    size = params.pedestrian_force / params.pedestrian_force_range * jnp.exp(-b / params.pedestrian_force_range)
    size = size * both / (4.0 * b)
    return size * (ux + wx), size * (uy + wy)


def view_weight(want_x: jax.Array, want_y: jax.Array, fx: jax.Array, fy: jax.Array, params: Params) -> jax.Array:
    """The weight of a repulsion: 1 from within ``view_angle`` of the wanted direction (equations 7, 8)."""
    ux, uy = unit(want_x, want_y)
    seen = -(ux * fx + uy * fy) >= norm(fx, fy) * jnp.cos(0.5 * params.view_angle)
    return jnp.where(seen, 1.0, params.unseen_weight)


def wall_repulsion(x: jax.Array, y: jax.Array, segments: list[tuple], params: Params) -> tuple:
    """Acceleration by walls, m/s^2: each pushes away from its point nearest to (x, y) (equation 5).

    segments: list of (ax, ay, bx, by, active). Two walls whose nearest point is their common corner push once.
    """
    fx = fy = jnp.zeros_like(x)
    points = []
    for ax, ay, bx, by, active in segments:
        qx, qy = closest_on_segment(Vec2(x, y), Vec2(ax, ay), Vec2(bx, by))
        for px, py, counted in points:
            active &= ~(counted & (norm(px - qx, py - qy) < _SAME))
        points.append((qx, qy, active))
        ux, uy = unit(x - qx, y - qy)
        size = params.wall_force / params.wall_force_range * jnp.exp(-norm(x - qx, y - qy) / params.wall_force_range)
        size = jnp.where(active, size, 0.0)
        fx, fy = fx + size * ux, fy + size * uy
    return fx, fy


def _near_segments(x: jax.Array, y: jax.Array, walls: Walls, count: int) -> list[tuple]:
    """(ax, ay, bx, by, active) of the ``count`` walls nearest to (x, y) that face it."""
    near = nearest_walls(x, y, walls.near(x, y), count)
    return [(walls.x[i], walls.y[i], walls.x[i + 1], walls.y[i + 1], squared < jnp.inf) for squared, i in near]
