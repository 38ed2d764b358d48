"""Points, segments, discs and moving points in the plane, on scalars; gradients are finite everywhere."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

_TINY = 1e-12


class Vec2(NamedTuple):
    """A vector of the plane, or as many as its two arrays hold. Sums, products with scalars and the usual products.

    A pytree of two leaves: what is computed with it is what is computed with x and y, in the same order.
    """

    x: jax.Array
    y: jax.Array

    __array_ufunc__ = None  # a numpy number times a vector is for `__rmul__`

    def __add__(self, other: "Vec2") -> "Vec2":  # type: ignore[override]
        return Vec2(self.x + other.x, self.y + other.y)

    def __sub__(self, other: "Vec2") -> "Vec2":
        return Vec2(self.x - other.x, self.y - other.y)

    def __neg__(self) -> "Vec2":
        return Vec2(-self.x, -self.y)

    def __mul__(self, scalar: jax.Array | float) -> "Vec2":  # type: ignore[override]
        return Vec2(self.x * scalar, self.y * scalar)

    def __rmul__(self, scalar: jax.Array | float) -> "Vec2":  # type: ignore[override]
        return Vec2(scalar * self.x, scalar * self.y)

    def __truediv__(self, scalar: jax.Array | float) -> "Vec2":
        return Vec2(self.x / scalar, self.y / scalar)

    def dot(self, other: "Vec2") -> jax.Array:
        """Scalar product."""
        return self.x * other.x + self.y * other.y

    def cross(self, other: "Vec2") -> jax.Array:
        """z of the cross product: positive where ``other`` points to the left of this."""
        return self.x * other.y - self.y * other.x

    def squared(self) -> jax.Array:
        """Square of the length."""
        return self.x * self.x + self.y * self.y

    def norm(self) -> jax.Array:
        """Length, at least 1e-6."""
        return safe_sqrt(self.squared())

    def unit(self) -> "Vec2":
        """Scaled to length 1; a vector of length 0 stays 0."""
        return self / self.norm()

    def in_frame(self, heading: "Vec2") -> "Vec2":
        """In the axes of a frame whose x axis is the unit vector ``heading``."""
        return Vec2(*to_frame(self.x, self.y, *heading))

    def left(self) -> "Vec2":
        """Turned by a quarter to the left."""
        return Vec2(-self.y, self.x)

    def right(self) -> "Vec2":
        """Turned by a quarter to the right."""
        return Vec2(self.y, -self.x)


def where(condition: jax.Array, one: Any, other: Any) -> Any:
    """``jnp.where`` of all leaves of two pytrees of one structure, such as two `Vec2`."""
    return jax.tree.map(lambda a, b: jnp.where(condition, a, b), one, other)


def safe_sqrt(x: jax.Array) -> jax.Array:
    """sqrt(max(x, 1e-12)): the gradient at 0 and below is 0 instead of infinite."""
    return jnp.sqrt(jnp.maximum(x, _TINY))


def norm(x: jax.Array, y: jax.Array) -> jax.Array:
    """Length of (x, y)."""
    return safe_sqrt(x * x + y * y)


def unit(x: jax.Array, y: jax.Array) -> tuple[jax.Array, jax.Array]:
    """(x, y) scaled to length 1; a vector of length 0 stays 0."""
    length = norm(x, y)
    return x / length, y / length


def cross2d(ax: jax.Array, ay: jax.Array, bx: jax.Array, by: jax.Array) -> jax.Array:
    """z of the cross product: positive where b points to the left of a."""
    return ax * by - ay * bx


def to_frame(x: jax.Array, y: jax.Array, cos: jax.Array, sin: jax.Array) -> tuple[jax.Array, jax.Array]:
    """A world vector (x, y) in the axes of a frame whose heading is (cos, sin)."""
    return cos * x + sin * y, cos * y - sin * x


def closest_on_segment(p: Vec2, a: Vec2, b: Vec2) -> Vec2:
    """Point of segment a-b nearest to p; a segment of length 0 is its point."""
    edge = b - a
    t = jnp.clip((p - a).dot(edge) / jnp.maximum(edge.squared(), _TINY), 0.0, 1.0)
    return a + t * edge


def closest_approach(p: Vec2, e: Vec2, horizon: jax.Array | float = 1.0) -> jax.Array:
    """Time in [0, horizon] at which a point at p that moves by e a unit of time is nearest to the origin."""
    return jnp.clip(-p.dot(e) / jnp.maximum(e.squared(), _TINY), 0.0, horizon)


def time_to_disc(p: Vec2, e: Vec2, radius: jax.Array | float) -> jax.Array:
    """First t in [0, 1] at which p + t e lies within ``radius`` of the origin, else inf. 0 if it does at the start."""
    a, b, c = e.squared(), p.dot(e), p.squared() - radius * radius
    discriminant = b * b - a * c
    t = c / jnp.maximum(safe_sqrt(discriminant) - b, _TINY)
    hit = (b < 0) & (discriminant >= 0) & (t <= 1)
    return jnp.where(c <= 0, 0.0, jnp.where(hit, t, jnp.inf))


def time_to_slab(p: Vec2, e: Vec2, a: Vec2, b: Vec2, radius: jax.Array | float) -> jax.Array:
    """First t in [0, 1] at which p + t e comes within ``radius`` of segment a-b from the side, else inf.

    Together with `time_to_disc` at both ends this is the exact first contact of a moving disc with a wall.
    """
    edge = b - a
    length = edge.norm()
    direction = edge / length
    side = direction.cross(p - a)
    rate = direction.cross(e) * jnp.where(side < 0, -1.0, 1.0)
    gap = jnp.abs(side) - radius
    t = jnp.where(gap <= 0, 0.0, gap / jnp.maximum(-rate, _TINY))
    along = direction.dot(p + t * e - a)
    # A wall without length has no side: its point is for `time_to_disc`.
    return jnp.where((t <= 1) & (along >= 0) & (along <= length) & (length > 1e-5), t, jnp.inf)


def insert_nearest(
    held: list[tuple[jax.Array, jax.Array]], squared: jax.Array, index: jax.Array
) -> list[tuple[jax.Array, ...]]:
    """``held``, a sorted list of (squared distance, index), with one more candidate and without the farthest of all."""
    carried = squared, index
    kept = []
    for old in held:
        swap = carried[0] < old[0]
        kept.append(tuple(jnp.where(swap, new, before) for new, before in zip(carried, old, strict=True)))
        carried = tuple(jnp.where(swap, before, new) for new, before in zip(carried, old, strict=True))
    return kept
