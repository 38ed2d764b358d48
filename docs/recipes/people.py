"""A pedestrian model: people who walk where they want, and stop while somebody stands in their way."""

import jax
import jax.numpy as jnp

from jaxnav.world import PedestrianModel

AHEAD = 0.8  # m


def in_the_way(x, y, vx, vy, other_x, other_y):
    """Whether somebody at (other_x, other_y) stands within AHEAD metres of the way of a velocity (vx, vy)."""
    speed = jnp.maximum(jnp.hypot(vx, vy), 1e-6)
    ahead = ((other_x - x) * vx + (other_y - y) * vy) / speed
    aside = jnp.abs((other_x - x) * vy - (other_y - y) * vx) / speed
    return (ahead > 0.0) & (ahead < AHEAD) & (aside < 0.4)


class Polite(PedestrianModel):
    def step(self, pedestrians, memory, intentions, surroundings, config, params):
        robot, everybody = surroundings.robot, pedestrians

        def one(i, person, wanted):
            way = person.x, person.y, wanted.vx, wanted.vy
            others = in_the_way(*way, everybody.x, everybody.y) & everybody.present
            others &= jnp.arange(config.pedestrians) != i
            stops = others.any() | (in_the_way(*way, robot.x, robot.y) & ~wanted.ignores_robot)
            return jnp.where(stops, 0.0, wanted.vx), jnp.where(stops, 0.0, wanted.vy)

        vx, vy = jax.vmap(one)(jnp.arange(config.pedestrians), pedestrians, intentions)
        x, y = pedestrians.x + params.dt * vx, pedestrians.y + params.dt * vy
        return pedestrians.replace(x=x, y=y, vx=vx, vy=vy), memory


POLITE = Polite()
