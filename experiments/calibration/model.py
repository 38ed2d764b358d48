"""The fitted model: the world's pedestrian, with each person's preferred velocity estimated from its own past.

A person wants to go on as it went, and with time more and more as the world's pedestrian does: at ``preferred_speed``
to its destination. It moves as the world's ORCA people do, next to everybody within ``awareness``.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxnav.world import Params
from jaxnav.world.geometry import Vec2, norm, unit
from jaxnav.world.people.orca_people import permitted_velocity

_ELSEWHERE = 1e3  # metres: where a neighbour is put that isn't there, so that its half-plane stays finite


class Behaviour(NamedTuple):
    """How people walk. The first four are parameters of the world, the last two of the estimate of their intention.

    preferred_speed: m/s; awareness: distance at which somebody, person or robot, starts to be avoided, m;
    time_horizon: for how long a velocity is to be free of them, s; radius: of a body, m; memory: decay time of the mean
    over a person's past velocities, s; relaxation: decay time of a person's own velocity toward the preferred one, s,
    0 for the world's pedestrian, who walks to its goal from the first step.
    """

    preferred_speed: jax.Array | float
    awareness: jax.Array | float
    time_horizon: jax.Array | float
    radius: jax.Array | float
    memory: jax.Array | float = 1e-3
    relaxation: jax.Array | float = 0.0


class Setting(NamedTuple):
    """The fixed settings. dt: s; max_speed: m/s, by default more than people run at; robot_radius: m; neighbors: the
    most who are avoided at once."""

    dt: float = 0.4
    max_speed: float = 5.0
    robot_radius: float = 0.0
    neighbors: int = 4


def predict(behaviour, window, setting, width=None):
    """`[P, T, 2]` positions at the T instants after the `Windows` row ``window``, everybody walking at once.

    width: blur of ``awareness``, metres. As a threshold it has no gradient; with a width it is drawn, for each person
    and step, from a logistic distribution of that scale, and people walk at the expected velocity. None: the threshold.
    """
    window = jax.tree.map(jnp.asarray, window)
    own = own_velocity(behaviour, window, setting)
    # Groups keep together by agreement, not by avoidance; nobody avoids itself.
    apart = window.group[:, None] != window.group[None, :]
    avoids = apart & window.present[:, None] & window.present[None, :]

    def step(carry, t):
        position, velocity = carry
        want = preferred_velocity(behaviour, window, own, position, t, setting)
        new = _permitted(behaviour, window.robot, avoids, position, velocity, want, setting, width)
        new = jnp.where(window.robot[:, None], own, new)
        position = position + new * setting.dt
        return (position, new), position

    times = setting.dt * jnp.arange(window.future.shape[1])
    return jnp.swapaxes(jax.lax.scan(step, (window.position, own), times)[1], 0, 1)


def own_velocity(behaviour, window, setting):
    """`[P, 2]` mean of the past velocities, those ``memory`` seconds ago weighing 1 / e as much as the last one."""
    age = setting.dt * jnp.arange(window.velocity.shape[1])
    weight = jnp.exp(-age / behaviour.memory) * window.known
    return jnp.einsum("ph,phd->pd", weight, window.velocity) / jnp.maximum(weight.sum(1), 1e-6)[:, None]


def preferred_velocity(behaviour, window, own, position, t, setting):
    """`[P, 2]` where people want to go t seconds into the future; who stands wants to go on standing."""
    to_x, to_y = (window.goal - position).T
    ux, uy = unit(to_x, to_y)
    # As in the world: the last step toward the goal ends on it.
    speed = jnp.minimum(behaviour.preferred_speed, norm(to_x, to_y) / setting.dt)
    walk = jnp.stack([speed * ux, speed * uy], axis=1)
    # The mean over the coming step: 1 for the world's pedestrian.
    relaxation = jnp.maximum(behaviour.relaxation, 1e-3)
    left = jnp.exp(-(t + 0.5 * setting.dt) / relaxation)
    return jnp.where(window.standing[:, None], own, walk + left * (own - walk))


def _permitted(behaviour, robot, avoids, position, velocity, want, setting, width):
    """`[P, 2]` new velocities: ORCA, the nearest ``neighbors`` considered."""
    dx, dy = (position[None, :] - position[:, None]).transpose(2, 0, 1)
    squared = jnp.where(avoids, dx * dx + dy * dy, jnp.inf)
    count = min(setting.neighbors, len(position) - 1)
    index = jax.lax.top_k(-squared, count)[1]
    radius = jnp.where(robot, setting.robot_radius, behaviour.radius)

    def one(i, nearest):
        there = avoids[i, nearest]
        others = (
            jnp.where(there, dx[i, nearest], _ELSEWHERE), jnp.where(there, dy[i, nearest], 0.0),
            *jnp.where(there[:, None], velocity[nearest], 0.0).T, radius[i] + radius[nearest], there,
        )  # fmt: skip
        return _choose_velocity(behaviour, velocity[i], others, want[i], setting, width)

    return jax.vmap(one)(jnp.arange(len(position)), index)


def _choose_velocity(behaviour, velocity, others, want, setting, width):
    """`[2]` new velocity of one person. others: (px, py, vx, vy, sum of radii, there), each `[K]`, nearest first."""
    px, py, _, _, _, there = others
    distance = norm(px, py)
    params = Params(time_horizon=behaviour.time_horizon, dt=setting.dt, max_speed=setting.max_speed)
    agents = list(zip(*others, strict=True))

    def avoiding(aware):
        seen = [(*agent[:5], agent[5] & aware[k]) for k, agent in enumerate(agents)]
        return jnp.stack(permitted_velocity(Vec2(*velocity), Vec2(*want), [], seen, params))

    if width is None:
        return avoiding(distance < behaviour.awareness)
    # The nearest k are avoided if awareness lies between the distances of the k-th and the next: the velocity is a
    # step function of awareness, and this its exact mean.
    count = len(agents)
    velocities = jax.vmap(avoiding)(jnp.tri(count + 1, count, -1, dtype=bool))
    seen = there * jax.nn.sigmoid((behaviour.awareness - distance) / width)
    return velocities[0] + seen @ (velocities[1:] - velocities[:-1])
