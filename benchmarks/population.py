"""What seeds trained at once cost: a training chunk vmapped over members against one learner alone.

Members differ in seed, learning rates and discount, and run in one process and one compilation. The two take turns,
best of several chunks; a whole training adds the compilation of each, once, to 40 chunks (the preset quick).
"""

import argparse
import json
import time

import jax
import jax.numpy as jnp

from jaxnav.training.config import make_agent, preset, resolve
from jaxnav.training.population import Population

CHUNKS = 40


def hyperparameters(base, members):
    """`Hyperparameters` `[members]`: learning rates from 3e-4 to 3e-3, discounts from 0.95 to 0.99."""
    share = jnp.linspace(0.0, 1.0, members) if members > 1 else jnp.array([0.5])
    rate = 3e-4 * 10.0**share
    return base.replace(actor_lr=rate, critic_lr=rate, discount=0.95 + 0.04 * share)


class Training:
    """A population in training, a chunk at a time."""

    def __init__(self, config, members):
        self.config, self.members = config, members
        self.population = Population(config, make_agent(config), members)
        self.hyper = hyperparameters(config.hyper, members)
        start = time.perf_counter()
        self.loop = self.population.start(range(members), self.hyper)
        self.chunk()
        self.first_s = time.perf_counter() - start

    def chunk(self):
        """Seconds of a chunk."""
        start, then = time.perf_counter(), int(self.loop.counter)
        self.loop, _ = self.population.train(self.loop, self.hyper, then + self.config.train.steps_per_chunk)
        return time.perf_counter() - start


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--members", type=int, nargs="+", default=[5], help="sizes of population to measure")
    parser.add_argument("--algo", default="hsac", help="hsac, td3, ppo or a2c")
    parser.add_argument("--repetitions", type=int, default=5, help="chunks of each, the best counts")
    parser.add_argument("--json", action="store_true", help="one JSON object a line")
    arguments = parser.parse_args()
    config = resolve(preset("quick", arguments.algo))
    one = Training(config, 1)
    for members in arguments.members:
        many = Training(config, members)
        times = [(one.chunk(), many.chunk()) for _ in range(arguments.repetitions)]
        alone, together = (min(column) for column in zip(*times, strict=True))
        whole = [training.first_s + (CHUNKS - 1) * s for training, s in ((one, alone), (many, together))]
        result = {
            "name": "population",
            "algo": arguments.algo,
            "members": members,
            "seconds_alone": round(alone, 3),
            "seconds_together": round(together, 3),
            "ratio": round(together / alone, 2),
            "cost_per_member": round(together / members / alone, 3),
            "whole_training_ratio": round(whole[1] / whole[0], 2),
            "first_chunk_s": [round(one.first_s, 1), round(many.first_s, 1)],
            "device": jax.devices()[0].device_kind,
        }
        if arguments.json:
            print(json.dumps(result), flush=True)
        else:
            print(
                f"{members} members of {arguments.algo}: {together:.3f} s a chunk, one alone {alone:.3f} s: "
                f"{result['ratio']} times one; a whole training, compilation included, "
                f"{result['whole_training_ratio']} times one",
                flush=True,
            )


if __name__ == "__main__":
    main()
