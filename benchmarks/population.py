"""The cost of training learners at once: a training chunk vmapped over members against one learner alone.

Members differ in seed, learning rates and discount, and run in one process and one compilation. The two take turns,
best of several chunks; a whole training adds the compilation of each, once, to 40 chunks (the preset quick). Memory is
what the device, or on a CPU the process, holds at most beyond what it held before, beside what was predicted.
"""

import argparse
import gc
import json
import pathlib
import threading
import time

import jax
import jax.numpy as jnp
import psutil

from jaxnav import preset
from jaxnav.training import Population, make_agent, resolve

CHUNKS = 40


def hyperparameters(base, members):
    """`HSACHyperparameters` `[members]`: learning rates from 3e-4 to 3e-3, discounts from 0.95 to 0.99."""
    share = jnp.linspace(0.0, 1.0, members) if members > 1 else jnp.array([0.5])
    rate = 3e-4 * 10.0**share
    return base.replace(actor_lr=rate, critic_lr=rate, discount=0.95 + 0.04 * share)


class Peak:
    """The most memory that is held inside a ``with``, beyond what is held before it: `bytes`.

    An accelerator knows its peak since the process began: so it is exact only if nothing before has held more.
    """

    def __enter__(self):
        gc.collect()
        self._stop, self._before, self.bytes = threading.Event(), self._now(), 0
        self._watcher = threading.Thread(target=self._watch)
        self._watcher.start()
        return self

    def __exit__(self, *_):
        self._stop.set()
        self._watcher.join()
        stats = jax.devices()[0].memory_stats()
        if stats:
            self.bytes = stats["peak_bytes_in_use"] - self._before

    def _watch(self):
        while not self._stop.wait(0.01):
            self.bytes = max(self.bytes, self._now() - self._before)

    @staticmethod
    def _now():
        stats = jax.devices()[0].memory_stats()
        return stats["bytes_in_use"] if stats else psutil.Process().memory_info().rss


class Training:
    """A population in training, a chunk at a time."""

    def __init__(self, config, members):
        self.config, self.members = config, members
        self.population = Population(config, make_agent(config), members)
        self.hyper = hyperparameters(config.hyper, members)
        start = time.perf_counter()
        self.population.compile()
        jax.block_until_ready(self._start().counter)
        self.compile_s = time.perf_counter() - start
        with Peak() as peak:
            self.loop = self._start()
            start = time.perf_counter()
            self.chunk()
            self.first_s = self.compile_s + time.perf_counter() - start
        self.predicted, self.measured = self.population.bytes_needed / members, peak.bytes / members

    def _start(self):
        return self.population.start(range(self.members), self.hyper)

    def chunk(self):
        """Seconds of a chunk."""
        start, then = time.perf_counter(), int(self.loop.counter)
        self.loop, _ = self.population.train(self.loop, self.hyper, then + self.config.train.steps_per_chunk)
        jax.block_until_ready(self.loop)
        return time.perf_counter() - start


def measure(one, members, repetitions):
    """A JSON object for a population of that size."""
    config = one.config
    many = Training(config, members)
    times = [(one.chunk(), many.chunk()) for _ in range(repetitions)]
    alone, together = (min(column) for column in zip(*times, strict=True))
    whole = [training.first_s + (CHUNKS - 1) * s for training, s in ((one, alone), (many, together))]
    steps = config.train.steps_per_chunk * config.train.episodes
    return {
        "name": "population",
        "algo": config.algo,
        "members": members,
        "seconds_alone": round(alone, 4),
        "seconds_together": round(together, 4),
        "ratio": round(together / alone, 2),
        "cost_per_member": round(together / members / alone, 3),
        "whole_training_ratio": round(whole[1] / whole[0], 2),
        "first_chunk_s": [round(one.first_s, 1), round(many.first_s, 1)],
        "members_per_s": round(members / together / CHUNKS, 4),
        "env_steps_per_s": round(members * steps / together),
        "bytes_per_member": {"predicted": round(many.predicted), "measured": round(many.measured)},
        "device": jax.devices()[0].device_kind,
    }


def draw(results, path):
    """Whole trainings a second against members, and bytes of a member."""
    import matplotlib
    import matplotlib.ticker

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    members = [result["members"] for result in results]
    figure, (rate, size) = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
    rate.plot(members, [result["members_per_s"] for result in results], "o-")
    alone = 1 / results[0]["seconds_alone"] / CHUNKS
    rate.axhline(alone, color="0.6", linestyle="--")
    rate.annotate("one after another", (members[-1], alone), ha="right", va="bottom", color="0.4")
    rate.set(xscale="log", yscale="log", xlabel="members trained at once", ylabel="trainings of the preset quick / s")
    rate.yaxis.set_major_locator(matplotlib.ticker.LogLocator(subs=(1, 2, 5)))
    rate.yaxis.set_minor_formatter("")
    for axis in (rate.xaxis, rate.yaxis):
        axis.set_major_formatter("{x:g}")
    size.plot(members, [result["bytes_per_member"]["measured"] / 1e6 for result in results], "o-", label="measured")
    size.plot(members, [result["bytes_per_member"]["predicted"] / 1e6 for result in results], "x--", label="predicted")
    size.set(xscale="log", ylim=(0, None), xlabel="members trained at once", ylabel="MB a member")
    size.xaxis.set_major_formatter("{x:g}")
    size.legend(frameon=False, loc="lower left")
    figure.suptitle(f"{results[0]['algo']} on {results[0]['device']}")
    figure.savefig(path, dpi=120)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--members", type=int, nargs="+", default=[5], help="sizes of population to measure, ascending")
    parser.add_argument("--algo", default="hsac", help="hsac, td3, ppo or a2c")
    parser.add_argument("--repetitions", type=int, default=5, help="chunks of each, the best counts")
    parser.add_argument("--plot", type=pathlib.Path, help="a picture of several sizes")
    parser.add_argument("--json", action="store_true", help="one JSON object a line")
    arguments = parser.parse_args()
    one, results = Training(resolve(preset("quick", arguments.algo)), 1), []
    for members in arguments.members:
        result = measure(one, members, arguments.repetitions)
        results.append(result)
        if arguments.json:
            print(json.dumps(result), flush=True)
            continue
        size = result["bytes_per_member"]
        print(
            f"{members} members of {result['algo']}: {result['seconds_together']:.3f} s a chunk, one alone "
            f"{result['seconds_alone']:.3f} s: {result['ratio']:.2f} times it, {result['cost_per_member']:.3f} a "
            f"member; with compilation {result['whole_training_ratio']:.2f} times one training; "
            f"{size['measured'] / 1e6:.1f} MB a member, {size['predicted'] / 1e6:.1f} predicted ({result['device']})",
            flush=True,
        )
    if arguments.plot:
        draw(results, arguments.plot)


if __name__ == "__main__":
    main()
