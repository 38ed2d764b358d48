"""Gradients of random 20-step rollouts, in a process of its own, whose findings are one JSON object.

    python tests/world/rollout_gradients.py differences full    against central differences, in float64
    python tests/world/rollout_gradients.py finite full         how many are not finite, in float32

The compiler is asked not to optimise: compiling takes longer than running here.
"""

import functools
import json
import sys

import jax
import jax.numpy as jnp
import numpy as np

from jaxnav.world import SUITES, Action, World, WorldConfig, default_params
from jaxnav.world.config import OBSERVATION_PARTS

STEPS = 20
SIZES = {
    "everyday": {"scenes": ("hallway", "crossflow"), "pedestrians": 4, "max_neighbors": 1, "wall_neighbors": 2},
    "full": {"scenes": SUITES["parity"] + SUITES["hard"], "pedestrians": 6},
}
ROLLOUTS = {"differences": {"everyday": 50, "full": 1000}, "finite": {"everyday": 500, "full": 10_000}}
QUICKLY = {"xla_backend_optimization_level": 0}
# Parameters that the return is a continuous function of, most of the time.
SMOOTH = (
    "dt", "max_v", "max_w", "robot_radius", "body_radius", "preferred_speed", "max_speed", "time_horizon",
    "time_horizon_walls", "passing_clearance", "safe_distance", "reward_arrival", "reward_collision", "reward_progress",
    "reward_step", "reward_closeness", "reward_request", "reward_response",
)  # fmt: skip

STEP = 1e-6  # of a difference, in units of the quantity
FLOOR = 1e-2  # a derivative below this counts as this large: the return itself is in the hundreds
AGREEMENT = 1e-3  # one-sided differences that agree to this share know of no event between them


def draw(world, key):
    """(state, twists `[STEPS, 2]`, requests `[STEPS]`, keys `[STEPS]`, params) of one random rollout.

    A quarter of the episodes has one pedestrian; the people differ from episode to episode.
    """
    key_scene, key_reset, key_params, key_twist, key_request, key_alone, key_steps = jax.random.split(key, 7)
    scene = jax.random.randint(key_scene, (), 0, len(world.scenes), jnp.int32)
    parity, hard = default_params(SUITES["parity"]), default_params(SUITES["hard"])
    is_parity = jnp.array([name in SUITES["parity"] for name in world.config.scenes])[scene]
    params = jax.tree.map(lambda a, b: jnp.where(is_parity, a, b) * jnp.ones(()), parity, hard)
    factors = jax.random.uniform(key_params, (5,), minval=0.8, maxval=1.2)
    params = params.replace(
        awareness=2.0 * factors[0], preferred_speed=0.8 * params.preferred_speed * factors[1],
        time_horizon=params.time_horizon * factors[2], body_radius=params.body_radius * factors[3],
        neighbor_distance=2.0 * factors[4], compliance=0.5 * jnp.ones(()),
    )  # fmt: skip
    state = world.reset(key_reset, params, scene)
    people = state.pedestrians
    alone = jax.random.uniform(key_alone) < 0.25
    state = state.replace(
        pedestrians=people.replace(present=people.present & (~alone | (jnp.arange(world.config.pedestrians) == 0)))
    )
    twists = jax.random.uniform(key_twist, (STEPS, 2), minval=jnp.array([-0.6, -0.5]), maxval=jnp.array([0.95, 0.5]))
    requests = jax.random.randint(key_request, (STEPS,), 0, 4, jnp.int32)
    return state, twists, requests, jax.random.split(key_steps, STEPS), params


def rollout(world, state, twists, requests, keys, params, weights=None):
    """The return up to the end of the episode; with weights `[STEPS]`, plus as much of all that is observed."""

    def step(carry, now):
        state, done = carry
        twist, request, key, weight = now
        state, outcome = world.step(key, state, Action(twist=twist, request=request), params)
        total = jnp.where(done, 0.0, outcome.reward)
        if weight is not None:
            parts = [leaf for leaf in jax.tree.leaves(world.observe(state, params)) if leaf.dtype == total.dtype]
            total += weight * sum(jnp.sum(jnp.sin(part)) for part in parts)
        return (state, done | outcome.terminated), total

    return jnp.sum(jax.lax.scan(step, (state, jnp.bool_(False)), (twists, requests, keys, weights))[1])


# Differences


def differences(world, rollouts):
    """Gradients beside central differences, for all components of twists and parameters of many rollouts."""

    def value(vector, state, requests, keys, params):
        changed = dict(zip(SMOOTH, vector[2 * STEPS :], strict=True))
        return rollout(world, state, vector[: 2 * STEPS].reshape(STEPS, 2), requests, keys, params.replace(**changed))

    def beside(vector, *rest):
        """[components, 2]: the values above and below ``vector`` in each component."""
        shifts = STEP * jnp.array([1.0, -1.0])
        shifted = vector + shifts[None, :, None] * jnp.eye(vector.size)[:, None]
        return jax.vmap(jax.vmap(lambda moved: value(moved, *rest)))(shifted)

    state, twists, requests, keys, params = _drawn(world, rollouts)
    vector = np.concatenate(
        [twists.reshape(rollouts, -1), np.stack([getattr(params, name) for name in SMOOTH], 1)], axis=1
    )
    arguments = vector, state, requests, keys, params
    here, gradient = _in_blocks(jax.value_and_grad(value), 25, *arguments)
    above, below = np.moveaxis(_in_blocks(beside, 25, *arguments), -1, 0)

    ahead, behind = (above - here[:, None]) / STEP, (here[:, None] - below) / STEP
    central = 0.5 * (ahead + behind)
    smooth = np.abs(ahead - behind) <= AGREEMENT * np.maximum(np.abs(central), FLOOR)
    error = np.abs(gradient - central) / np.maximum(np.abs(central), FLOOR)
    labels = np.array(["twist v", "twist w"] * STEPS + list(SMOOTH))
    components = {}
    for label in dict.fromkeys(labels.tolist()):
        of = labels == label
        components[label] = {
            "largest_error": np.max(error[:, of], initial=0.0, where=smooth[:, of]).item(),
            "events": np.mean(~smooth[:, of]).item(),
            "not_zero": np.mean(gradient[:, of] != 0).item(),
        }
    return {
        "rollouts": rollouts, "compared": smooth.sum().item(), "events": np.mean(~smooth).item(),
        "largest_error": np.max(error, where=smooth, initial=0.0).item(), "components": components,
    }  # fmt: skip


# Finiteness


def finite(world, rollouts):
    """How many random rollouts have a gradient that is not finite, by what it is of and where the rollout started."""

    def total(floats, state, requests, keys, params):
        twists, poses, values = floats
        state = state.replace(**{name: getattr(state, name).replace(**pose) for name, pose in poses.items()})
        weights = jnp.ones(STEPS)
        return rollout(world, state, twists, requests, keys, params.replace(**values), weights)

    def gradient(key, kind, state, twists, requests, keys, params):
        state, twists = _degenerate(world, key, kind, state, twists, params)
        poses = {
            "robot": {name: getattr(state.robot, name) for name in ("x", "y", "heading", "v", "w", "goal_x", "goal_y")},
            "pedestrians": {
                name: getattr(state.pedestrians, name) for name in ("x", "y", "vx", "vy", "goal_x", "goal_y")
            },
        }
        by = jax.grad(total)((twists, poses, vars(params)), state, requests, keys, params)
        return [jnp.concatenate([jnp.ravel(leaf) for leaf in jax.tree.leaves(part)]) for part in by]

    kinds = np.arange(rollouts) % len(KINDS)
    chance = jax.random.split(jax.random.key(1), rollouts)
    by = _in_blocks(gradient, 250, chance, kinds, *_drawn(world, rollouts))
    bad = [~np.all(np.isfinite(part), axis=1) for part in by]
    largest = np.max(np.abs(by[0]), axis=1)
    return {
        "rollouts": rollouts,
        "not_finite": {name: int(part.sum()) for name, part in zip(("twists", "poses", "params"), bad, strict=True)},
        "not_finite_from": {kind: int(np.any(bad, axis=0)[kinds == k].sum()) for k, kind in enumerate(KINDS)},
        "largest_by_twists": {f"{share:.0%}": float(np.quantile(largest, share)) for share in (0.5, 0.99, 1.0)},
    }


KINDS = (
    "a reset", "on top of a person", "in contact", "at a vertex of a wall", "along a wall", "at the goal",
    "in a throng", "all people in one place", "people at their goals", "a grazing beam", "no speed",
)  # fmt: skip


def _degenerate(world, key, kind, state, twists, params):
    """The rollout moved to where geometry degenerates, as `KINDS` says; a third of the twists is at its limits."""
    key_spot, key_throng, key_twist = jax.random.split(key, 3)
    robot, people, walls = state.robot, state.pedestrians, world.walls(state.scene)
    first_x, first_y, touch = people.x[0], people.y[0], params.robot_radius + params.body_radius
    i = jax.random.randint(key_spot, (), 0, walls.x.size - 1)
    throng_x, throng_y = jax.random.uniform(key_throng, (2, world.config.pedestrians), minval=-0.4, maxval=0.4)
    edge_x, edge_y = (vertices[i + jnp.arange(2)] for vertices in (walls.x, walls.y))
    wall_heading = jnp.arctan2(edge_y[1] - edge_y[0], edge_x[1] - edge_x[0])
    zeros = jnp.zeros(world.config.pedestrians)

    def put(**where):
        return [where.get(name, now) for name, now in (("robot", robot), ("people", people))]

    moved = [
        put(),
        put(robot=robot.replace(x=first_x, y=first_y)),
        put(robot=robot.replace(x=first_x - touch, y=first_y, heading=jnp.zeros(()))),
        put(robot=robot.replace(x=edge_x[0], y=edge_y[0], heading=wall_heading)),
        put(robot=robot.replace(x=jnp.mean(edge_x), y=jnp.mean(edge_y), heading=wall_heading)),
        put(robot=robot.replace(x=robot.goal_x, y=robot.goal_y)),
        put(people=people.replace(x=robot.x + throng_x, y=robot.y + throng_y)),
        put(people=jax.tree.map(lambda leaf: jnp.broadcast_to(leaf[0], leaf.shape), people)),
        put(people=people.replace(x=people.goal_x, y=people.goal_y, turned=people.turned | True)),
        put(
            robot=robot.replace(heading=jnp.zeros(())),
            people=people.replace(x=zeros + robot.x + 1.0, y=zeros + robot.y + params.body_radius),
        ),
        put(robot=robot.replace(v=jnp.zeros(())), people=people.replace(vx=zeros, vy=zeros)),
    ]  # fmt: skip
    robot, people = jax.tree.map(lambda *leaves: jnp.stack(leaves)[kind], *moved)
    limits = jax.random.randint(key_twist, (STEPS, 1), 0, 9, jnp.int32)
    twists = jnp.where(limits == 0, jnp.array([-1.0, 0.0]), jnp.where(limits == 1, jnp.array([1.0, -1.0]), twists))
    twists = jnp.where(limits == 2, jnp.array([1.0, 0.0]), twists)
    return state.replace(robot=robot, pedestrians=people), twists


# Both


def _drawn(world, rollouts):
    keys = jax.random.split(jax.random.key(0), rollouts)
    return jax.jit(jax.vmap(functools.partial(draw, world)), compiler_options=QUICKLY)(keys)


def _in_blocks(function, size, *arguments):
    """What ``vmap`` of the function gives, numpy, ``size`` rows at a time; their number is a multiple of it."""
    block = jax.jit(jax.vmap(function), compiler_options=QUICKLY)
    rows = jax.tree.leaves(arguments)[0].shape[0]
    done = [
        jax.device_get(block(*jax.tree.map(lambda leaf: leaf[first : first + size], arguments)))  # noqa: B023
        for first in range(0, rows, size)
    ]
    return jax.tree.map(lambda *leaves: np.concatenate(leaves), *done)


if __name__ == "__main__":
    study, size = sys.argv[1:]
    jax.config.update("jax_enable_x64", study == "differences")
    # An odd number of beams, so that one looks straight ahead.
    config = WorldConfig(beams=181, scan_noise=True, observation=OBSERVATION_PARTS, **SIZES[size])
    found = {"differences": differences, "finite": finite}[study](World(config), ROLLOUTS[study][size])
    print(json.dumps(found, indent=1))
