"""The nearest walls and other pedestrians, as seen from a pedestrian."""

import jax
import jax.numpy as jnp

from .. import orca
from ..config import WorldConfig
from ..geometry import Vec2, insert_nearest
from ..params import Params
from ..types import Pedestrian, Walls
from ..walls import nearest_walls


def near_walls(x: jax.Array, y: jax.Array, walls: Walls, reach: jax.Array | float, count: int) -> list[orca.NearWall]:
    """The ``count`` walls nearest to (x, y) within ``reach``, nearest first."""
    found = []
    for squared, i in nearest_walls(x, y, walls.near(x, y), count):
        vertices = [Vec2(walls.x[k] - x, walls.y[k] - y) for k in (walls.before[i], i, i + 1, walls.after[i])]
        found.append(orca.NearWall(*vertices, active=squared < reach * reach))
    return found


def near_pedestrians(i: jax.Array, pedestrians: Pedestrian, config: WorldConfig, params: Params) -> list[tuple]:
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
