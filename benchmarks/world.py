"""How many scans, steps and observations a second the world gives, and how long it takes to compile."""

import argparse
import functools
import json
import pathlib
import statistics
import time

import jax
import jax.numpy as jnp
from rich.console import Console
from rich.table import Table

from jaxnav import Action, Params, World, WorldConfig, maps

EPISODES = (256, 4096)
CROWDS = (1, 2, 4, 8, 16, 32, 64)  # pedestrians an episode
OFFICE = pathlib.Path(__file__).parent.parent / "examples" / "office.yaml"
GRID = ("sensor_map", "pedestrian_map")
ABOUT = {
    "raycast": "laser scans: 180 beams, 12 walls and 1 pedestrian",
    "step": "steps without sensing: dialogue, pedestrian, robot, contacts, reward; ended episodes replaced",
    "full_step": "the same, and before it the observation: scan, pedestrian, dialogue, pose",
    "grid_observation": "sensor map and pedestrian map, 4 x 48 x 48 numbers, written to memory",
    "crowd": "full steps times pedestrians, for 1 to 64 of them in the square, 4,096 in all; and memory",
    "map": "full steps on a floor plan read from a map (--map)",
}
NOISY = ("raycast", "full_step", "grid_observation")  # without a scan there is no noise: step is measured once

_HELP = f"""Every benchmark runs with 256 and with 4096 episodes side by side, with 1 pedestrian and,
where a scan is part of it, with sensor noise off and on; crowd and map with 4096 and without noise.

{chr(10).join(f"  {name:17s} {text}" for name, text in ABOUT.items())}

A rate is the best of many repetitions, after one to warm up: what slows a repetition down is the machine's other work.
The table has the median beside it; where the two are far apart the machine was busy, and neither is worth quoting.
compile_s is tracing and compiling, once, without a cache. Actions are random.

examples:
  python benchmarks/world.py                                   everything, as a table
  python benchmarks/world.py --only full_step --episodes 4096  one of them
  python benchmarks/world.py --only crowd --plot crowd.png     how the cost grows with the crowd, as a figure
  python benchmarks/world.py --only map --map house.yaml       your own building
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
        action = Action(twist=twist, request=(bits[:, 2] & 3).astype(jnp.int32))
        keys = jax.random.split(key_step, episodes)
        states, outcome = jax.vmap(world.step, in_axes=(0, 0, 0, None))(keys, states, action, params)
        return (states, outcome.terminated | outcome.truncated), seen + jnp.sum(outcome.reward)

    start = states, jnp.zeros(episodes, bool)
    return jax.lax.scan(one, start, jax.random.split(jax.random.key(1), count))


def measure(name, episodes, noise, seconds):
    """One benchmark: a dict as --json prints it, and the median rate."""
    parts = GRID if name == "grid_observation" else ("scan",) if name == "raycast" else WorldConfig().observation
    return time_program(name, World(WorldConfig(observation=parts, scan_noise=noise)), episodes, seconds, noise=noise)


def measure_crowd(pedestrians, seconds):
    """Pedestrian-steps a second of full steps, 4,096 pedestrians in all, and what they take of memory."""
    world = World(WorldConfig(scenes=("square",), pedestrians=pedestrians))
    result, median = time_program("full_step", world, max(4096 // pedestrians, 64), seconds, pedestrians=pedestrians)
    return result | {"name": "crowd", "rate_per_s": result["rate_per_s"] * pedestrians}, median * pedestrians


def measure_map(path, seconds):
    """Full steps a second on a map."""
    scene = maps.load(path)
    world = World(WorldConfig(scenes=(scene.name,)), [scene])
    result, median = time_program("full_step", world, 4096, seconds, map=pathlib.Path(path).name)
    return result | {"name": "map"}, median


def time_program(name, world, episodes, seconds, **fields):
    """A dict as --json prints it, and the median rate, of a benchmark in a world."""
    params = Params()
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
    sizes = compiled.memory_analysis()
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
        **fields,
        "rate_per_s": round(count * episodes / min(times)),
        "memory_mb": round((sizes.temp_size_in_bytes + sizes.argument_size_in_bytes) / 1e6, 2),
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
    parser.add_argument("--episodes", type=int, metavar="N", help="instead of 256 and 4096; not for crowd and map")
    parser.add_argument("--seconds", type=float, default=2.0, metavar="S", help="repeat for this long (default: 2)")
    parser.add_argument("--json", action="store_true", help="one JSON object a line instead of a table")
    parser.add_argument(
        "--map", default=OFFICE, metavar="FILE", help="yaml file of a ROS map (default: a small office)"
    )
    parser.add_argument("--plot", metavar="FILE", help="draw crowd as a figure, where it is measured")
    arguments = parser.parse_args()
    if arguments.episodes is not None and arguments.episodes < 1:
        parser.error(f"--episodes is {arguments.episodes}: give a whole number of at least 1")
    if arguments.episodes is not None and arguments.only in ("crowd", "map"):
        parser.error(f"--episodes is {arguments.episodes}: leave it out, {arguments.only} has numbers of its own")
    if not 0 < arguments.seconds < float("inf"):
        parser.error(f"--seconds is {arguments.seconds}: give a finite number above 0")
    if arguments.plot and arguments.only not in (None, "crowd"):
        parser.error(f"--plot is {arguments.plot}: only crowd is drawn; give --only crowd, or leave out --only")

    table = Table("name", "episodes", "noise", "a second", "median", "memory", "compile", title="")
    for column in table.columns[1:]:
        column.justify = "right"
    console = Console(stderr=True)
    crowds = []
    for label, run in benchmarks(arguments):
        try:
            result, median = run()
        except ValueError as error:
            parser.error(str(error))
        if result["name"] == "crowd":
            crowds.append(result)
        if arguments.json:
            print(json.dumps(result), flush=True)
            continue
        console.print(f"{label}: done", style="dim")
        table.add_row(
            label, f"{result['episodes']:,}", "on" if result.get("noise") else "off", f"{result['rate_per_s']:,}",
            f"{median:,.0f}", f"{result['memory_mb']:,.1f} MB", f"{result['compile_s']:.1f} s",
        )  # fmt: skip
    if arguments.plot:
        draw_crowds(crowds, arguments.plot)
    if not arguments.json:
        table.title = f"{jax.devices()[0].device_kind}, jax {jax.__version__}"
        Console().print(table)


def benchmarks(arguments):
    """(label, function without arguments) of every benchmark that was asked for."""
    for name in [arguments.only] if arguments.only else ABOUT:
        if name == "crowd":
            for count in CROWDS:
                yield f"crowd, {count} pedestrians", functools.partial(measure_crowd, count, arguments.seconds)
        elif name == "map":
            yield "map", functools.partial(measure_map, arguments.map, arguments.seconds)
        else:
            for episodes in [arguments.episodes] if arguments.episodes else EPISODES:
                for noise in (False, True) if name in NOISY else (False,):
                    yield name, functools.partial(measure, name, episodes, noise, arguments.seconds)


def draw_crowds(results, path):
    """Time and memory of a pedestrian-step against the number of pedestrians."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8, 3.2), layout="constrained")
    counts = [result["pedestrians"] for result in results]
    quantities = (
        ("microseconds", [1e6 / result["rate_per_s"] for result in results]),
        (
            "kB of memory",
            [1e3 * result["memory_mb"] / (result["episodes"] * result["pedestrians"]) for result in results],
        ),
    )
    for axes, (label, values) in zip(figure.subplots(1, 2), quantities, strict=True):
        axes.plot(counts, values, "o-", color="#0072B2")
        axes.set_xscale("log", base=2)
        axes.set_xticks(counts, counts)
        axes.set_ylim(0, 1.15 * max(values))
        axes.set_xlabel("pedestrians in an episode")
        axes.set_ylabel(f"{label} a pedestrian-step")
        axes.grid(color="#ECEEF1")
        axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(path, dpi=150)


if __name__ == "__main__":
    main()
