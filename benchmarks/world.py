"""How many scans, steps and observations a second the world gives, and how long it takes to compile."""

import argparse
import json
import statistics
import time

import jax
import jax.numpy as jnp
from rich.console import Console
from rich.table import Table

from jaxnav import Action, Params, World, WorldConfig

EPISODES = (256, 4096)
GRID = ("sensor_map", "pedestrian_map")
ABOUT = {
    "raycast": "laser scans: 180 beams, 12 walls and 1 pedestrian",
    "step": "steps without sensing: dialogue, pedestrian, robot, contacts, reward; ended episodes replaced",
    "full_step": "the same, and before it the observation: scan, pedestrian, dialogue, pose",
    "grid_observation": "sensor map and pedestrian map, 4 x 48 x 48 numbers, written to memory",
}
NOISY = ("raycast", "full_step", "grid_observation")  # without a scan there is no noise: step is measured once

_HELP = f"""Every benchmark runs with 256 and with 4096 episodes side by side, with 1 pedestrian and,
where a scan is part of it, with sensor noise off and on.

{chr(10).join(f"  {name:17s} {text}" for name, text in ABOUT.items())}

A rate is the best of many repetitions, after one to warm up: what slows a repetition down is the machine's other work.
The table has the median beside it; where the two are far apart the machine was busy, and neither is worth quoting.
compile_s is tracing and compiling, once, without a cache. Actions are random.

examples:
  python benchmarks/world.py                                   everything, as a table
  python benchmarks/world.py --only full_step --episodes 4096  one of them
  python benchmarks/world.py --json > world.jsonl              one JSON object a line
"""


def turning(states, turn):
    """``states`` with the robot turned, so that every observation is another one."""
    return states.replace(robot=states.robot.replace(heading=states.robot.heading + turn))


def scans(world, params, states, count):
    """``count`` scans of each episode; their sum `[N, B]`."""

    def one(total, turn):
        return total + jax.vmap(world.observe, in_axes=(0, None))(turning(states, turn), params).scan, None

    start = jnp.zeros((states.t.shape[0], world.config.beams))
    return jax.lax.scan(one, start, 0.01 * jnp.arange(count))[0]


def grids(world, params, states, count):
    """``count`` grid observations of each episode; the last `[N, 48, 48]` and `[N, 3, 48, 48]`.

    Each is written whole over the one before it: memory fresh from the system at every call would cost more than the
    observation.
    """

    def observe(states):
        observation = jax.vmap(world.observe, in_axes=(0, None))(states, params)
        return observation.sensor_map, observation.pedestrian_map

    def one(_, turn):
        return observe(turning(states, turn)), None

    start = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape), jax.eval_shape(observe, states))
    return jax.lax.scan(one, start, 0.01 * jnp.arange(count))[0]


def drive(world, params, states, count, sensing):
    """``count`` steps of each episode with random actions; the last states and a number for each step."""
    episodes = states.t.shape[0]
    pool = jax.tree.map(lambda leaf: jnp.concatenate([leaf, leaf]), states)

    def one(carry, key):
        states, done = carry
        key_fresh, key_action, key_step = jax.random.split(key, 3)
        # Ended episodes are replaced at the beginning of the next turn. Were it done right after the step, XLA would
        # compute the step once more for every leaf that is chosen.
        offset = jax.random.randint(key_fresh, (), 0, episodes)
        fresh = jax.tree.map(lambda leaf: jax.lax.dynamic_slice_in_dim(leaf, offset, episodes), pool)
        states = jax.tree.map(
            lambda new, old: jnp.where(done.reshape(episodes, *[1] * (old.ndim - 1)), new, old), fresh, states
        )
        seen = jnp.float32(0.0)
        if sensing:
            observation = jax.vmap(world.observe, in_axes=(0, None))(states, params)
            # Every number of it is used, or the compiler would leave it out.
            seen = sum(jnp.sum(leaf.astype(jnp.float32)) for leaf in jax.tree.leaves(observation))
        bits = jax.random.bits(key_action, (episodes, 3))
        twist = bits[:, :2].astype(jnp.float32) / 2.0**31 - 1.0
        action = Action(twist=twist, code=(bits[:, 2] & 3).astype(jnp.int32))
        keys = jax.random.split(key_step, episodes)
        states, outcome = jax.vmap(world.step, in_axes=(0, 0, 0, None))(keys, states, action, params)
        return (states, outcome.terminated | outcome.truncated), seen + jnp.sum(outcome.reward)

    start = states, jnp.zeros(episodes, bool)
    return jax.lax.scan(one, start, jax.random.split(jax.random.key(1), count))


def measure(name, episodes, noise, seconds):
    """One benchmark: a dict as --json prints it, and the median rate."""
    parts = GRID if name == "grid_observation" else ("scan",) if name == "raycast" else WorldConfig().observation
    world, params = World(WorldConfig(observation=parts, scan_noise=noise)), Params()
    keys = jax.random.split(jax.random.key(0), episodes)
    states = jax.block_until_ready(jax.jit(jax.vmap(lambda key: world.reset(key, params)))(keys))
    count = 10 if name == "grid_observation" else 50
    run = {
        "raycast": lambda states: scans(world, params, states, count),
        "step": lambda states: drive(world, params, states, count, sensing=False),
        "full_step": lambda states: drive(world, params, states, count, sensing=True),
        "grid_observation": lambda states: grids(world, params, states, count),
    }[name]
    start = time.perf_counter()
    compiled = jax.jit(run).lower(states).compile()
    compile_s = time.perf_counter() - start
    times = []
    jax.block_until_ready(compiled(states))
    until = time.perf_counter() + seconds
    while len(times) < 5 or time.perf_counter() < until:
        start = time.perf_counter()
        jax.block_until_ready(compiled(states))
        times.append(time.perf_counter() - start)
    result = {
        "name": name,
        "episodes": episodes,
        "noise": noise,
        "rate_per_s": round(count * episodes / min(times)),
        "compile_s": round(compile_s, 2),
        "device": jax.devices()[0].device_kind,
        "jax": jax.__version__,
    }
    return result, count * episodes / statistics.median(times)


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, epilog=_HELP, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--only", choices=ABOUT, metavar="NAME", help=f"one of {', '.join(ABOUT)}")
    parser.add_argument("--episodes", type=int, metavar="N", help="this many instead of 256 and 4096")
    parser.add_argument("--seconds", type=float, default=2.0, metavar="S", help="repeat for this long (default: 2)")
    parser.add_argument("--json", action="store_true", help="one JSON object a line instead of a table")
    arguments = parser.parse_args()
    if arguments.episodes is not None and arguments.episodes < 1:
        parser.error(f"--episodes is {arguments.episodes}: give a whole number of at least 1")

    table = Table("name", "episodes", "noise", "a second", "median", "compile", title="")
    for column in table.columns[1:]:
        column.justify = "right"
    console = Console(stderr=True)
    for name in [arguments.only] if arguments.only else ABOUT:
        for episodes in [arguments.episodes] if arguments.episodes else EPISODES:
            for noise in (False, True) if name in NOISY else (False,):
                result, median = measure(name, episodes, noise, arguments.seconds)
                if arguments.json:
                    print(json.dumps(result), flush=True)
                    continue
                console.print(f"{name}, {episodes} episodes, noise {'on' if noise else 'off'}: done", style="dim")
                table.add_row(
                    name, f"{episodes:,}", "on" if noise else "off", f"{result['rate_per_s']:,}", f"{median:,.0f}",
                    f"{result['compile_s']:.1f} s",
                )  # fmt: skip
    if not arguments.json:
        table.title = f"{jax.devices()[0].device_kind}, jax {jax.__version__}"
        Console().print(table)


if __name__ == "__main__":
    main()
