"""How many full steps a second this world gives beside its peers: JaxMARL's JaxNav and social-jym's LaserNav."""

import argparse
import contextlib
import json
import sys
import time
from unittest import mock

import jax
import jax.numpy as jnp
from rich.console import Console
from rich.table import Table
from world import drive

from jaxnav import Params, World

BEAMS = 180
OURS = "jaxnav"

_HELP = f"""A full step is an action, one control period of the world, its reward, an observation with {BEAMS} beams
over 180 degrees, and a new episode where one has ended: 1 robot, and 1 person where the peer has people, without sensor
noise, at random actions. Every world runs in this process, on this device, with the numbers of episodes side by side at
which it is fast; its best rate counts. A peer steps and resets as its own `step` does it. A ratio is the rate of this
world by that of the peer.

What differs:
  jaxnav    0.4 s a step, no sub-steps, contacts swept; 1 pedestrian who talks (ORCA and a dialogue); square, hallway
            and crosswalk, 12 walls, 12 m of range in closed form; scans, steps; begins from episodes drawn beforehand
  JaxNav    0.1 s a step, no sub-steps; no people; random grid maps of 11 x 11 m; 6 m of range, marched by 0.05 m;
            steps, scans, resets, and scans again, in every episode
  LaserNav  0.25 s a step, its person moved in 25 sub-steps of 0.01 s (headed social force); circular crossing with 3
            obstacles of 4 segments; 10 m of range in closed form, no history of scans; scans, steps, resets, scans

A peer that is not installed is named as not run. To install them beside jaxnav:
  JaxNav    pip install jaxmarl six
  LaserNav  git clone --recurse-submodules https://github.com/TommasoVandermeer/social-jym
            pip install ./social-jym ./social-jym/JHSFM ./social-jym/JSFM ./social-jym/JORCA

examples:
  python benchmarks/peers.py                                 a table
  python benchmarks/peers.py --json > peers.jsonl            one JSON object a line
  taskset -c 0 python benchmarks/peers.py                    on one core
"""


def jaxnav(episodes):
    """The states of this world, and how ``count`` steps of all of them are run: as in benchmarks/world.py."""
    world, params = World(), Params()
    keys = jax.random.split(jax.random.key(0), episodes)
    states = jax.jit(jax.vmap(lambda key: world.reset(key, params)))(keys)
    return states, lambda states, count: drive(world, params, states, count, sensing=True)


def jaxmarl(episodes):
    """The same of JaxMARL's JaxNav. ImportError where it is not installed."""
    from jaxmarl.environments.jaxnav.jaxnav_env import JaxNav

    env = JaxNav(num_agents=1, lidar_num_beams=BEAMS, lidar_angle_factor=0.5)
    _, states = jax.jit(jax.vmap(env.reset))(jax.random.split(jax.random.key(0), episodes))
    low, high = jnp.array([env.min_v, -env.max_w]), jnp.array([env.max_v, env.max_w])

    def one(states, key):
        key_action, key_step = jax.random.split(key)
        action = {"agent_0": jax.random.uniform(key_action, (episodes, 2), minval=low, maxval=high)}
        observation, states, reward, *_ = jax.vmap(env.step)(jax.random.split(key_step, episodes), states, action)
        return states, jnp.sum(observation["agent_0"]) + jnp.sum(reward["agent_0"])

    return states, _scan(one)


def social_jym(episodes):
    """The same of social-jym's LaserNav. ImportError where it is not installed."""
    from socialjym.envs.lasernav import LaserNav
    from socialjym.utils.rewards.lasernav_rewards.reward1 import Reward1

    env = LaserNav(
        robot_radius=0.3, robot_dt=0.25, humans_dt=0.01, scenario="circular_crossing", n_humans=1, n_obstacles=3,
        reward_function=Reward1(robot_radius=0.3), n_stack=1, lidar_angular_range=jnp.pi, lidar_num_rays=BEAMS,
    )  # fmt: skip
    states, resets, _, infos, _ = env.batch_reset(jax.random.split(jax.random.PRNGKey(0), episodes))

    def one(carry, key):
        action = jax.random.uniform(key, (episodes, 2), minval=jnp.array([0.0, -1.0]), maxval=1.0)
        states, observation, infos, reward, _, keys = env.batch_step(*carry[:2], action, *carry[2:], False, True)
        return (states, infos, *keys), jnp.sum(observation) + jnp.sum(reward)

    return (states, infos, resets, jax.random.split(jax.random.PRNGKey(1), episodes)), _scan(one)


# Who is measured, with how many episodes side by side, and with how many steps of all of them together at once.
WORLDS = {
    OURS: (jaxnav, (1024, 4096), 200_000),
    "JaxNav": (jaxmarl, (16, 64, 256, 1024), 4_000),
    "LaserNav": (social_jym, (16, 64, 256, 1024), 4_000),
}


def _scan(one):
    return lambda start, count: jax.lax.scan(one, start, jax.random.split(jax.random.key(1), count))


def rate(world, episodes, steps, seconds):
    """Steps a second of one world, the best of its repetitions. ImportError where the peer is not installed."""
    start, run = world(episodes)
    count = max(2, steps // episodes)
    compiled = jax.jit(lambda start: run(start, count)).lower(start).compile()
    jax.block_until_ready(compiled(start))
    best, until = float("inf"), time.perf_counter() + seconds
    while time.perf_counter() < until:
        begin = time.perf_counter()
        jax.block_until_ready(compiled(start))
        best = min(best, time.perf_counter() - begin)
    return count * episodes / best


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, epilog=_HELP, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seconds", type=float, default=3.0, metavar="S", help="repeat for this long (default: 3)")
    parser.add_argument("--json", action="store_true", help="one JSON object a line instead of a table")
    arguments = parser.parse_args()
    if not 0 < arguments.seconds < float("inf"):
        parser.error(f"--seconds is {arguments.seconds}: give a finite number above 0")

    table = Table(
        "world", "a second", "episodes", "ratio", title=f"{jax.devices()[0].device_kind}, jax {jax.__version__}"
    )
    for column in table.columns[1:]:
        column.justify = "right"
    console = Console(stderr=True)
    ours = None
    for peer, (world, sizes, steps) in WORLDS.items():
        best = 0.0, 0
        try:
            for episodes in sizes:
                # JaxMARL prints when it is imported, to what it believes to be the true standard output.
                with mock.patch.object(sys, "__stdout__", sys.stderr), contextlib.redirect_stdout(sys.stderr):
                    best = max(best, (rate(world, episodes, steps, arguments.seconds), episodes))
                console.print(f"{peer}, {episodes} episodes: done", style="dim")
        except ImportError as error:
            console.print(f"{peer}: not run ({error}); --help says how to install it")
            table.add_row(peer, "not run", "", "")
            continue
        ours = ours or best[0]
        result = {"name": "peer", "peer": peer, "rate_per_s": round(best[0]), "ratio": round(ours / best[0], 1)}
        if arguments.json:
            print(json.dumps(result), flush=True)
        table.add_row(peer, f"{best[0]:,.0f}", f"{best[1]:,}", f"{ours / best[0]:,.1f}")
    if not arguments.json:
        Console().print(table)


if __name__ == "__main__":
    main()
