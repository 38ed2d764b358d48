"""What a member of a population costs: a training chunk vmapped over members against one learner alone.

Members differ in seed, learning rates and discount. The cost per member is the time of the vmapped chunk, divided by
the number of members and by the time of the same chunk of a single learner; the two take turns, best of several.
"""

import argparse
import json
import time

import jax
import jax.numpy as jnp

from jaxnav import Params, World
from jaxnav.agents.hsac import HSAC, Hyperparameters
from jaxnav.training.config import TrainConfig
from jaxnav.training.loop import Trainer, member_axes


def population(members):
    """`Hyperparameters` `[members]`: learning rates from 3e-4 to 3e-3, discounts from 0.95 to 0.99."""
    share = jnp.linspace(0.0, 1.0, members)
    base = jax.tree.map(lambda leaf: jnp.full(members, leaf, jnp.float32), Hyperparameters())
    rate = 3e-4 * 10.0**share
    return base.replace(actor_lr=rate, critic_lr=rate, discount=0.95 + 0.04 * share)


def timed(chunk, loop, hyper):
    """(loop after a chunk, seconds it took)."""
    start = time.perf_counter()
    loop, _ = jax.block_until_ready(chunk(loop, hyper))
    return loop, time.perf_counter() - start


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--members", type=int, nargs="+", default=[4], help="sizes of population to measure")
    parser.add_argument("--repetitions", type=int, default=5, help="chunks of each, the best counts")
    parser.add_argument("--json", action="store_true", help="one JSON object a line")
    arguments = parser.parse_args()
    trainer = Trainer(World(), HSAC(), Params(), TrainConfig(steps_per_chunk=5, total_steps=1000))
    one = jax.jit(trainer.train_chunk, donate_argnums=0)
    single_loop = jax.jit(trainer.init)(jax.random.key(0), Hyperparameters())
    single_loop, _ = timed(one, single_loop, Hyperparameters())
    for members in arguments.members:
        axes, hyper = member_axes(), population(members)
        keys = jax.random.split(jax.random.key(0), members)
        loop = jax.jit(jax.vmap(trainer.init, out_axes=axes))(keys, hyper)
        many = jax.jit(jax.vmap(trainer.train_chunk, in_axes=(axes, 0), out_axes=(axes, 0)), donate_argnums=0)
        start = time.perf_counter()
        loop, _ = timed(many, loop, hyper)
        compile_s = time.perf_counter() - start
        alone, together = [], []
        for _ in range(arguments.repetitions):
            single_loop, seconds = timed(one, single_loop, Hyperparameters())
            alone.append(seconds)
            loop, seconds = timed(many, loop, hyper)
            together.append(seconds)
        result = {
            "name": "population",
            "members": members,
            "seconds_alone": round(min(alone), 3),
            "seconds_together": round(min(together), 3),
            "cost_per_member": round(min(together) / members / min(alone), 3),
            "compile_s": round(compile_s, 1),
            "device": jax.devices()[0].device_kind,
        }
        if arguments.json:
            print(json.dumps(result), flush=True)
        else:
            print(
                f"{members} members: {result['seconds_together']} s a chunk, one alone {result['seconds_alone']} s: "
                f"a member costs {result['cost_per_member']} of a single learner (first call {result['compile_s']} s)",
                flush=True,
            )


if __name__ == "__main__":
    main()
