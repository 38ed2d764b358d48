"""Bundles of untrained policies, one for each encoder and each way to decide, and the modules that lie in them."""

import contextlib
import dataclasses
import os

import pytest
import torch

from experiments.exporting import single_states
from jaxnav.agents import ENCODERS
from jaxnav.export.bundle import write_bundle
from jaxnav.export.contract import origin_of
from jaxnav.export.modules import modules
from jaxnav.training.config import preset, resolve
from jaxnav.training.run import Run

# Every encoder, head, language, learner and kind of twist at least once; experiments/exporting has all combinations.
SMALL = {"encoder_widths": (4, 8, 8, 32, 8)}  # of the grid encoders
CONFIGURATIONS = {
    "lidar": ("hsac", {"encoder": "lidar"}, {}),
    "approach": (
        "hsac", {"encoder": "lidar-approach", "heads": "per-request", "language": "codes"},
        {"pedestrians": 3, "beams": 50},
    ),
    "grid": ("hsac", {"encoder": "grid", "heads": "per-request"} | SMALL, {"pedestrians": 2}),
    "frozen": (
        "hsac", {"encoder": "grid-frozen", "language": "codes", "requests": 2} | SMALL,
        {"observation": ("scan", "pedestrians", "dialogue", "sensor_map", "pedestrian_map"), "pedestrians": 2},
    ),
    "td3": ("td3", {"encoder": "lidar"}, {"beams": 7, "scenes": ("square",)}),
    "ppo": ("ppo", {"encoder": "lidar-approach"}, {"scan_noise": True, "scenes": ("square",)}),
}  # fmt: skip


def made(name, folder):
    """(run, actor) of a configuration: random weights, episodes of a few steps."""
    algo, sizes, world = CONFIGURATIONS[name]
    base = preset("quick", algo)
    agent = dataclasses.replace(base.agent, **sizes)
    params = base.world.params.replace(max_steps=8.0)
    world = {"observation": ENCODERS[agent.encoder].reads, "params": params, "scenes": ("square", "hallway")} | world
    world = dataclasses.replace(base.world, **world)
    run = Run(resolve(dataclasses.replace(base, agent=agent, world=world, out=str(folder / name))))
    return run, single_states.random_actor(run, seed=1)


@pytest.fixture(scope="session")
def bundles(tmp_path_factory):
    """A function (name of a configuration) -> (run, actor, folder of its bundle); nobody changes what is in it."""
    own, known = tmp_path_factory.mktemp("bundles"), {}
    # All workers share what the first of them has made.
    shared = tmp_path_factory.getbasetemp()
    shared = (shared.parent if "PYTEST_XDIST_WORKER" in os.environ else shared) / "shared_bundles"
    shared.mkdir(exist_ok=True)

    def get(name):
        if name not in known:
            run, actor = made(name, own)
            if not (shared / name).exists():
                write_bundle(run, actor, own / name / "bundle", origin_of(run, "last", {}, None))
                with contextlib.suppress(OSError):  # the other worker was faster
                    (own / name / "bundle").rename(shared / name)
            known[name] = run, actor, shared / name
        return known[name]

    return get


@pytest.fixture
def robot(bundles):
    """A function (name) -> (folder, module policy, module navigator, module scans) of a bundle."""
    opened = []

    def get(name):
        folder = bundles(name)[2]
        opened.append(modules(folder, "policy", "navigator", "scans"))
        return folder, *opened[-1].__enter__()

    yield get
    for context in reversed(opened):
        context.__exit__(None, None, None)


@pytest.fixture(autouse=True, scope="session")
def _one_thread():
    """Two threads of torch beside another worker's take ten times as long."""
    torch.set_num_threads(1)
