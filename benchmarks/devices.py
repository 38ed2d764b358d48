"""The gain of several devices: a training chunk on 1, 2, 4 and 8, against one and against the unparted program.

All devices are of this process. On a CPU they are virtual and share its cores: what is seen there is what parting
costs, not what devices gain. Programs take turns, best of several chunks. That devices change numbers by rounding alone
is for tests/training/test_devices.py: chunks this long let rounding grow until losses have nothing in common.
"""

import argparse
import dataclasses
import json
import os
import time

import jax
import jax.numpy as jnp

from jaxnav import preset
from jaxnav.training import Run, resolve
from jaxnav.training.devices import SHARDS, layout_on


class Training:
    """A run in training without its folder, a chunk at a time."""

    def __init__(self, config, devices):
        run = Run(config, layout_on(devices))
        self.hyper = jax.tree.map(jnp.float32, config.hyper)
        start = time.perf_counter()
        self.loop, _ = run.layout.start(lambda: (run.trainer.init(jax.random.key(config.seed), self.hyper), ()))
        self.program = run.layout.chunk(run.trainer.train_chunk, self.loop, self.hyper)
        self.chunk()
        self.first_s = time.perf_counter() - start

    def chunk(self):
        """Seconds of a chunk."""
        start = time.perf_counter()
        self.loop, _ = jax.block_until_ready(self.program(self.loop, self.hyper))
        return time.perf_counter() - start


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--devices", type=int, nargs="+", default=[1, 2, 4, 8], help="numbers of devices to measure")
    parser.add_argument("--preset", default="quick", help="what to train")
    parser.add_argument("--episodes", type=int, help="played at once, if not the preset's")
    parser.add_argument("--repetitions", type=int, default=3, help="chunks of each after the first, the best counts")
    parser.add_argument("--json", action="store_true", help="one JSON object a line")
    arguments = parser.parse_args()
    # Read when JAX first asks for devices, and by CPUs only.
    flag = f"--xla_force_host_platform_device_count={SHARDS}"
    os.environ["XLA_FLAGS"] = f"{os.environ.get('XLA_FLAGS', '')} {flag}"
    config = resolve(preset(arguments.preset))
    if arguments.episodes is not None:
        config = dataclasses.replace(config, train=dataclasses.replace(config.train, episodes=arguments.episodes))
    counts = [0, 1, *(n for n in arguments.devices if n > 1 and n <= jax.device_count())]
    trainings = [Training(config, devices) for devices in counts]
    times = [[training.chunk() for training in trainings] for _ in range(arguments.repetitions)]
    seconds = [min(column) for column in zip(*times, strict=True)]
    unparted, one = seconds[:2]
    device, cpu = jax.devices()[0].device_kind, jax.default_backend() == "cpu"
    if cpu and not arguments.json:
        print(f"virtual devices on {os.cpu_count()} cores, which they share: no gain is to be expected")
    for devices, training, s in zip(counts, trainings, seconds, strict=True):
        result = {
            "name": "devices",
            "preset": arguments.preset,
            "devices": devices,
            "shards": SHARDS if devices else 1,
            "seconds": round(s, 4),
            "rate_per_s": round(config.train.steps_per_chunk * config.train.episodes / s),
            "times_one_device": round(one / s, 3),
            "times_unparted": round(unparted / s, 3),
            "first_chunk_s": round(training.first_s, 1),
            "virtual": cpu,
            "device": device,
        }
        if arguments.json:
            print(json.dumps(result), flush=True)
        else:
            print(
                f"{devices or 'unparted'}: {s:.3f} s a chunk, {result['rate_per_s']} env steps/s, "
                f"{result['times_one_device']} times one device, {result['times_unparted']} times unparted; "
                f"{result['first_chunk_s']} s until the first chunk",
                flush=True,
            )


if __name__ == "__main__":
    main()
