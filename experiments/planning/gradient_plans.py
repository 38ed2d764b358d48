"""Twists planned by gradient ascent through the world: what is climbed, from where, and how."""

import math

import jax
import jax.numpy as jnp
import optax

from jaxnav import Action, OrcaRobot
from jaxnav.world.robot import arc, twist_from_action
from jaxnav.world.types import NONE
from jaxnav.world.walls import wall_clearance

# Just inside of [-1, 1]: at its ends, where the world clips, there is no gradient.
_LIMIT = 0.999
_PEOPLE_MARGIN, _WALL_MARGIN = 0.25, 0.08  # gaps below which a plan pays, m
_PRICE = 400.0  # of a margin used up, in the reward's units; beyond contact it goes on rising


def drive(world, params, state, keys, twists):
    """(what a plan climbs, (true return, arrived, collided, hit a person, steps)) of silently driving twists `[T, 2]`.

    Both are sums up to the end of the episode, but for what is climbed a collision is no end.
    """
    walls = world.walls(state.scene)

    def step(carry, now):
        state, ended, arrived = carry
        key, twist = now
        before = state.robot
        state, outcome = world.step(key, state, Action(twist=twist, request=jnp.int32(NONE)), params)
        v, w = twist_from_action(twist, params)
        half_x, half_y, _ = arc(before.x, before.y, before.heading, v, w, 0.5 * params.dt)
        to_walls = wall_clearance(jnp.stack([half_x, state.robot.x]), jnp.stack([half_y, state.robot.y]), walls)
        used = jnp.append((to_walls - params.robot_radius) / _WALL_MARGIN, outcome.pedestrian_distance / _PEOPLE_MARGIN)
        progress = jnp.hypot(before.goal_x - before.x, before.goal_y - before.y) - outcome.goal_distance
        climbed = params.reward_progress * progress + params.reward_step + outcome.reward_terms["closeness"]
        climbed -= _PRICE * jnp.sum(jnp.maximum(1.0 - used, 0.0) ** 2)
        counted = (jnp.where(ended, 0.0, outcome.reward), ~ended & outcome.arrived, ~ended & outcome.collided)
        counted += (~ended & outcome.hit_pedestrian, ~ended)
        carry = state, ended | outcome.terminated, arrived | outcome.arrived
        return carry, (jnp.where(arrived, 0.0, climbed), counted)

    no = jnp.bool_(False)
    climbed, (total, arrived, collided, hit, steps) = jax.lax.scan(step, (state, no, no), (keys, twists))[1]
    return jnp.sum(climbed), (jnp.sum(total), jnp.any(arrived), jnp.any(collided), jnp.any(hit), jnp.sum(steps))


def first_plans(key, world, params, state, keys, starts):
    """Twists `[starts, T, 2]`: those of the ORCA robot, first as it is, then of ones whom slow random changes disturb.

    They see where that takes them and go on from there; others wait a while before they set out.
    """
    steps = keys.shape[0]
    key_knots, key_wait = jax.random.split(key)
    # Straight from knot to knot, 2.4 s apart: a side or a pace is held for a while.
    knots = jax.random.normal(key_knots, (starts, 2, math.ceil(steps / 6) + 1)) * jnp.array([[0.6], [0.6]])
    instants = jnp.arange(steps) / 6.0
    changes = jax.vmap(jax.vmap(lambda values: jnp.interp(instants, jnp.arange(values.size), values)))(knots)
    wait = jnp.maximum(jax.random.randint(key_wait, (starts, 1), -12, 13), 0)
    changes = changes.at[:, 0].add(jnp.where(jnp.arange(steps) < wait, -2.0, 0.0))
    changes = jnp.where(jnp.arange(starts)[:, None, None] == 0, 0.0, jnp.moveaxis(changes, 1, 2))

    def disturbed(changes):
        def step(state, now):
            key, change = now
            twist = jnp.clip(OrcaRobot()(state, world, params).twist + change, -_LIMIT, _LIMIT)
            return world.step(key, state, Action(twist=twist, request=jnp.int32(NONE)), params)[0], twist

        return jax.lax.scan(step, state, (keys, changes))[1]

    return jax.vmap(disturbed)(changes)


def plan(world, params, scene, key, steps, starts, iterations, rate):
    """(the best plan `[T, 2]`, outcomes) of the episode of that key.

    outcomes: (return, arrived, collided, hit a person, steps), `[iterations + 1]` each, of the best until then.
    """
    key_reset, key_steps = jax.random.split(key)  # as `jaxnav.training.rollout.play` does
    state = world.reset(key_reset, params, scene)
    keys = jax.random.split(key_steps, steps)
    optimiser = optax.adam(rate)
    climb = jax.vmap(jax.value_and_grad(lambda twists: drive(world, params, state, keys, twists), has_aux=True))

    def iterate(carry, _):
        twists, moments, best, best_outcome = carry
        (_, outcome), gradient = climb(twists)
        better = outcome[0] > best_outcome[0]
        best, best_outcome = jax.tree.map(
            lambda new, old: jnp.where(better.reshape(-1, *[1] * (new.ndim - 1)), new, old),
            (twists, outcome), (best, best_outcome),
        )  # fmt: skip
        ascent, moments = optimiser.update(-gradient, moments)
        chosen = jnp.argmax(best_outcome[0])
        until_now = jax.tree.map(lambda leaf: leaf[chosen], best_outcome)
        return (jnp.clip(twists + ascent, -_LIMIT, _LIMIT), moments, best, best_outcome), until_now

    twists = first_plans(jax.random.fold_in(key, 1), world, params, state, keys, starts)
    no = jnp.zeros(starts, bool)
    nothing = jnp.full(starts, -jnp.inf), no, no, no, jnp.zeros(starts, int)
    carry = twists, optimiser.init(twists), twists, nothing
    (_, _, best, outcome), outcomes = jax.lax.scan(iterate, carry, None, length=iterations + 1)
    return best[jnp.argmax(outcome[0])], outcomes
