"""The cost of language in training: a chunk in which phrases are heard against the same chunk with one-hot codes.

Both are compiled, then take turns, so that a machine which slows down slows both. Compilation counts too: a run of
``--steps`` steps is what a user waits for.
"""

import argparse
import json
import statistics
import time

import jax

from jaxnav import Params, World
from jaxnav.agents import HSAC, HSACConfig, HSACHyperparameters
from jaxnav.training import TrainConfig
from jaxnav.training.loop import Trainer


class Learner:
    """A training loop on the device, with the seconds it takes to compile and for each chunk."""

    def __init__(self, language):
        trainer, self.hyper = (
            Trainer(World(), HSAC(HSACConfig(language=language)), Params(), TrainConfig()),
            HSACHyperparameters(),
        )
        start = time.perf_counter()
        init = jax.jit(trainer.init).lower(jax.random.key(0), self.hyper).compile()
        self.loop = init(jax.random.key(0), self.hyper)
        self.chunk = jax.jit(trainer.train_chunk, donate_argnums=0).lower(self.loop, self.hyper).compile()
        self.compile_s, self.seconds = time.perf_counter() - start, []

    def run(self):
        """One chunk of 25 steps and 200 updates."""
        start = time.perf_counter()
        self.loop, metrics = self.chunk(self.loop, self.hyper)
        jax.block_until_ready(metrics)
        self.seconds.append(time.perf_counter() - start)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--chunks", type=int, default=12, help="chunks of each that are timed")
    parser.add_argument("--json", action="store_true", help="one JSON object a line")
    arguments = parser.parse_args()
    learners = {language: Learner(language) for language in ("codes", "phrases")}
    for learner in learners.values():
        learner.run()
        learner.seconds.clear()
    for _ in range(arguments.chunks):
        for learner in learners.values():
            learner.run()
    rows = {
        language: {
            "name": "language", "language": language, "chunk_s": statistics.median(learner.seconds),
            "compile_s": learner.compile_s,
        }
        for language, learner in learners.items()
    }  # fmt: skip
    pairs = zip(learners["phrases"].seconds, learners["codes"].seconds, strict=True)
    ratio = statistics.median(a / b for a, b in pairs)
    device = jax.devices()[0].device_kind
    if arguments.json:
        for row in rows.values():
            print(json.dumps(row | {"device": device}))
        print(json.dumps({"name": "language_cost", "ratio": ratio, "device": device}))
        return
    for language, row in rows.items():
        print(f"{language:8} {row['chunk_s']:.3f} s a chunk, compiled in {row['compile_s']:.1f} s")
    print(
        f"a chunk with phrases takes {ratio:.3f} times as long as one with codes (median of {arguments.chunks} pairs)"
    )


if __name__ == "__main__":
    main()
