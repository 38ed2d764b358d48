"""Walls as closed chains: checked and tabled with numpy, searched under jit."""

from collections.abc import Iterable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from .geometry import Vec2, closest_on_segment, insert_nearest, time_to_disc, time_to_slab
from .types import Walls

_FARTHEST = 10_000.0  # m from the origin, beyond which single precision no longer tells millimetres


def walls_from_chains(chains: Iterable[Any]) -> Walls:
    """`Walls` (numpy) of closed chains of (x, y) vertices, free space to the left of each edge.

    A chain of two vertices is a wall without thickness, free on both sides. ValueError: a chain of fewer, a coordinate
    that is not finite or beyond 10 km, an edge without length.
    """
    points, solid, before, after = [], [], [], []
    for number, chain in enumerate(chains):
        chain = np.asarray(chain, float)
        _check_chain(number, chain)
        if points:
            # The pen is lifted on the way to the next chain.
            solid.append(False)
            before.append(len(points) - 1)
            after.append(len(points))
        first, count = len(points), len(chain)
        points += [*chain, chain[0]]
        solid += [True] * count
        before += [first + (i - 1) % count for i in range(count)]
        after += [first + (i + 2) % count for i in range(count)]
    x, y = np.array(points, np.float32).T
    return Walls(
        x=x, y=y, solid=np.array(solid), before=np.array(before, np.int32), after=np.array(after, np.int32)
    )  # fmt: skip


def enclosed_area(chain: Any) -> float:
    """Signed area, m^2, of a closed chain of (x, y) vertices: positive where it runs counter-clockwise."""
    x, y = np.asarray(chain, float).T
    return 0.5 * float(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)))


def is_inside(x: np.ndarray, y: np.ndarray, chains: Iterable[Any]) -> np.ndarray:
    """Whether points are in free space, numpy: an odd number of walls to the right; thin walls count twice."""
    inside = np.zeros(np.shape(x), bool)
    for chain in chains:
        chain = np.asarray(chain, float)
        for (ax, ay), (bx, by) in zip(chain, np.roll(chain, -1, axis=0), strict=True):
            at = ax + (y - ay) / (by - ay if by != ay else 1.0) * (bx - ax)
            inside ^= ((ay > y) != (by > y)) & (at > x)
    return inside


def _check_chain(number, chain):
    if chain.ndim != 2 or chain.shape[1] != 2 or len(chain) < 2:
        raise ValueError(f"chain {number} of the walls has shape {chain.shape}: give at least two vertices (x, y)")
    if not np.all(np.isfinite(chain)):
        vertex = int(np.argmin(np.isfinite(chain).all(axis=1)))
        raise ValueError(f"chain {number} of the walls has vertex {vertex} at {chain[vertex]}: give finite numbers")
    if np.abs(chain).max() > _FARTHEST:
        vertex = int(np.argmax(np.abs(chain).max(axis=1)))
        raise ValueError(
            f"chain {number} of the walls has vertex {vertex} at {chain[vertex]}: "
            f"give metres, at most {_FARTHEST:.0f} from the origin"
        )
    lengths = np.hypot(*(np.roll(chain, -1, axis=0) - chain).T)
    if lengths.min() < 1e-4:
        vertex = int(np.argmin(lengths))
        raise ValueError(
            f"chain {number} of the walls has an edge of {lengths[vertex]:.2g} m after vertex {vertex}: "
            "leave out vertices that are closer together than 0.1 mm"
        )


def pad_walls(walls: Sequence[Walls]) -> Walls:
    """Several `Walls` padded to one size: leaves `[len(walls), ...]`. Padding repeats the last vertex, not solid."""
    size = max(one.solid.size for one in walls)

    def pad(one):
        missing = size - one.solid.size
        last = {"mode": "constant", "constant_values": one.x.size - 1}
        return Walls(
            x=np.pad(one.x, (0, missing), mode="edge"), y=np.pad(one.y, (0, missing), mode="edge"),
            solid=np.pad(one.solid, (0, missing)), before=np.pad(one.before, (0, missing), **last),
            after=np.pad(one.after, (0, missing), **last),
        )  # fmt: skip

    return jax.tree.map(lambda *leaves: np.stack(leaves), *[pad(one) for one in walls])


def wall_clearance(x: jax.Array, y: jax.Array, walls: Walls) -> jax.Array:
    """Distance from a point to the nearest wall."""
    point = Vec2(x, y)

    def one(ax, ay, bx, by, solid):
        return jnp.where(solid, (closest_on_segment(point, Vec2(ax, ay), Vec2(bx, by)) - point).norm(), jnp.inf)

    return jnp.min(jax.vmap(one)(*walls.segments()), axis=0)


def nearest_walls(x: jax.Array, y: jax.Array, walls: Walls, count: int) -> list:
    """The ``count`` walls nearest to (x, y) of those that face it: a list of (squared distance, index), sorted.

    The distance is inf where there are fewer.
    """
    point = Vec2(x, y)

    def insert(held, wall):
        index, (ax, ay, bx, by, solid) = wall
        a, b = Vec2(ax, ay), Vec2(bx, by)
        faces = solid & ((b - a).cross(point - a) > 0)
        squared = jnp.where(faces, (closest_on_segment(point, a, b) - point).squared(), jnp.inf)
        return insert_nearest(held, squared, index), None

    segments = walls.segments()
    size = segments[-1].shape[0]
    indices = jnp.arange(size, dtype=jnp.int32) if walls.listed is None else walls.listed
    start = [(jnp.full_like(x, jnp.inf), jnp.int32(0))] * min(count, size)
    return jax.lax.scan(insert, start, (indices, segments))[0]


def time_to_walls(p: Vec2, e: Vec2, walls: Walls, radius: jax.Array | float) -> jax.Array:
    """First time in [0, 1] at which a disc at p that moves by e touches a wall, else inf."""

    def nearer(time, wall):
        ax, ay, bx, by, solid = wall
        a, b = Vec2(ax, ay), Vec2(bx, by)
        # Chains are closed, so that the first vertex of every wall covers all of them.
        corner, side = time_to_disc(p - a, e, radius), time_to_slab(p, e, a, b, radius)
        return jnp.minimum(time, jnp.where(solid, jnp.minimum(corner, side), jnp.inf)), None

    return jax.lax.scan(nearer, jnp.full_like(p.x, jnp.inf), walls.segments())[0]
