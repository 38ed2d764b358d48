"""Engines: whichever trains, and whoever is lost meanwhile, the same is found."""

import contextlib
import os
import signal
import socket
import subprocess
import sys

import psutil
import pytest

from jaxnav.errors import UserError
from jaxnav.sweep import search
from jaxnav.sweep.engines import Local, OnRay
from jaxnav.sweep.store import Store

from .test_search import key


def run(sweep, folder, engine, report=lambda results, state: None):
    folder.mkdir()
    with contextlib.closing(engine):
        return search.run(sweep, folder, Store(folder, "tiny"), engine, report)


@pytest.fixture
def cluster(tmp_path_factory):
    """Address of a Ray cluster of two nodes on this machine, one CPU each."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    ray = [sys.executable, "-m", "ray.scripts.scripts", "start", "--block", "--num-cpus=1", "--disable-usage-stats"]
    ray += ["--object-store-memory=100000000"]
    # The path of a socket may have 107 characters.
    head = ["--head", f"--port={port}", "--include-dashboard=false", f"--temp-dir=/tmp/jaxnav-ray-{os.getpid()}"]
    nodes = [subprocess.Popen([*ray, *head], stdout=subprocess.DEVNULL)]
    import ray as client

    address = f"127.0.0.1:{port}"
    try:
        for _ in range(60):
            with contextlib.suppress(subprocess.CalledProcessError):
                status = [sys.executable, "-m", "ray.scripts.scripts", "status", f"--address={address}"]
                subprocess.run(status, check=True, capture_output=True)
                break
        nodes.append(subprocess.Popen([*ray, f"--address={address}"], stdout=subprocess.DEVNULL))
        yield address
    finally:
        client.shutdown()
        processes = [p for node in nodes for p in (psutil.Process(node.pid), *psutil.Process(node.pid).children(True))]
        for process in processes:
            with contextlib.suppress(psutil.NoSuchProcess):
                process.kill()
        for node in nodes:
            node.wait()


def test_a_cluster_of_two_finds_what_one_process_finds_though_a_worker_is_killed(tmp_path, tiny_sweep, cluster):
    sweep = tiny_sweep(sizes={}, populations=2, trials=8, confirm=1, seeds=2, guard=None)
    alone = run(sweep, tmp_path / "local", Local())
    lost = []

    def kill_one(results, state):
        workers = [p for p in psutil.process_iter(["name"]) if p.info["name"].startswith("ray::Worker")]
        if len(results.phases["search"]) > 6 and not lost and workers:
            os.kill(workers[0].pid, signal.SIGKILL)
            lost.append(workers[0].pid)

    together = run(sweep, tmp_path / "ray", OnRay(cluster, 2), kill_one)
    assert lost

    def found(results):
        return {
            phase: [
                (number, state, values, seed, of, objective) for number, state, values, seed, of, objective, _ in trials
            ]
            for phase, trials in key(results).items()
        }

    assert found(together) == found(alone)


def test_a_cluster_that_is_not_there_is_named():
    with pytest.raises(UserError, match=r"--address is .127.0.0.1:9.: no Ray cluster answers there.*ray start --head"):
        OnRay("127.0.0.1:9", 1)
