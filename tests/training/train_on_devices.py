"""Trains in a process of its own: python train_on_devices.py JOBS, a JSON list of objects with

config: a `RunConfig`; devices: how many; copy: a folder to which the run's is copied after the sixth line, as a kill
would leave it, or null; stop: the chunk in which this process is sent SIGTERM, or null; distributed: whether it is one
of several processes. Prints a JSON list: of each job by what means devices told each other something, and the signal
that stopped it.
"""

import json
import os
import re
import shutil
import signal
import sys
import time

import jax

from jaxnav.training.config import run_from_json
from jaxnav.training.devices import Layout, is_first, join_processes, layout_on
from jaxnav.training.run import Run
from jaxnav.training.signals import Interrupted
from jaxnav.training.train import train as train_run


def collectives(text):
    """By what means devices tell each other something in a compiled program, each with the types of what they tell."""
    found = re.findall(r" = (.*?) (all-[a-z-]+|collective-[a-z-]+|reduce-scatter)\(", text)
    return sorted({f"{name} {type_}" for shapes, name in found for type_ in re.findall(r"(\w+)\[", shapes)})


def train(config, devices, copy, stop):
    run = Run(run_from_json(config), layout_on(devices))
    told, compiled = {}, Layout.chunk

    def chunk(self, train_chunk, loop, hyper):
        program, calls = compiled(self, train_chunk, loop, hyper), []
        told["collectives"] = collectives(program.as_text())

        def counted(loop, hyper):
            calls.append(None)
            if len(calls) == stop:
                os.kill(os.getpid(), signal.SIGTERM)
            return program(loop, hyper)

        return counted

    def success(policy, seed):
        assert is_first() and all(len(leaf.devices()) == 1 for leaf in jax.tree.leaves(policy.parameters))
        return {"square": 0.5}

    def report(line):
        assert is_first()
        if copy and line["env_steps"] == 6 * config["train"]["steps_per_chunk"] * config["train"]["episodes"]:
            shutil.copytree(run.folder, copy)

    Layout.chunk, run.evaluator.success = chunk, success
    run.prepare_folder()
    try:
        train_run(run, report, time.monotonic())
    except Interrupted as stopped:
        told["signal"] = stopped.signal
    Layout.chunk = compiled
    return told


def main():
    jobs = json.loads(sys.argv[1])
    if any(job.pop("distributed") for job in jobs):
        join_processes()
    print("\n" + json.dumps([train(**job) for job in jobs]))


if __name__ == "__main__":
    main()
