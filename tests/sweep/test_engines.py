"""Engines: whichever trains, and whoever is lost meanwhile, the same is found."""

import contextlib
import os
import signal
import socket
import subprocess
import sys
from types import SimpleNamespace

import psutil
import pytest

from jaxnav.errors import UserError
from jaxnav.sweep import engines, search
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


def test_a_cluster_of_two_finds_what_one_process_finds_though_a_worker_is_killed(tmp_path, tiny_sweep, request, full):
    if not full:
        pytest.skip("starts a Ray cluster that compiles and trains: pytest --full")
    cluster = request.getfixturevalue("cluster")
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


class FakeRay:
    """Ray as `OnRay` uses it: two CPUs, calls that are answered at once. lost: an error in place of the answers."""

    class RayError(Exception):
        pass

    class RayTaskError(RayError):
        def __init__(self, cause):
            super().__init__()
            self.cause = cause

    def __init__(self):
        self.exceptions, self.made, self.lost = self, [], None

    def init(self, **_):
        pass

    def shutdown(self):
        self.made.clear()

    def cluster_resources(self):
        return {"CPU": 2.0}

    def remote(self, worker):
        ray = self

        class Actor:
            def __init__(self):
                self.asked, self.forgotten = [], []
                ray.made.append(self)

            @classmethod
            def options(cls, **_):
                return cls

            @classmethod
            def remote(cls):
                return cls()

            @property
            def advance(self):
                return SimpleNamespace(remote=lambda job, round, fills: self.asked.append((job.name, round)) or self)

            @property
            def forget(self):
                return SimpleNamespace(remote=self.forgotten.append)

        return Actor

    def wait(self, waiting):
        return waiting[:1], waiting[1:]

    def get(self, futures):
        if self.lost:
            raise self.lost
        return [future.asked[-1] for future in futures]


def test_a_population_stays_with_one_worker_of_a_cluster(monkeypatch):
    ray = FakeRay()
    monkeypatch.setattr(engines, "_ray", lambda: ray)
    engine, done = OnRay("", 3), []
    tasks = [(SimpleNamespace(name=name), 0, []) for name in "abc"]
    assert len(ray.made) == 2  # as many as there are CPUs
    assert engine.advance(tasks, lambda: done.append(1)) == [("c", 0), ("b", 0), ("c", 0)] and len(done) == 3
    engine.advance([(job, 1, fills) for job, _, fills in tasks[::-1]])
    assert [sorted(actor.asked) for actor in ray.made] == [
        [("a", 0), ("a", 1), ("c", 0), ("c", 1)],
        [("b", 0), ("b", 1)],
    ]
    engine.forget(["b", "nobody"])
    assert [actor.forgotten for actor in ray.made] == [[], ["b"]]
    for error, message in (
        (FakeRay.RayTaskError(UserError("too small")), "too small"),
        (FakeRay.RayError(), "a worker was lost 3 times and more .*--resume"),
    ):
        ray.lost = error
        with pytest.raises(UserError, match=message):
            engine.advance(tasks)


def test_a_cluster_that_is_not_there_is_named():
    with pytest.raises(UserError, match=r"--address is .127.0.0.1:9.: no Ray cluster answers there.*ray start --head"):
        OnRay("127.0.0.1:9", 1)
