"""Engines: where the populations of a sweep train, in this process or in those of a Ray cluster.

Each process trains one population after another. A task is (`PopulationJob`, number of the round, its fills).
"""

import contextlib
import logging
import socket
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, Protocol

import jax

from ..errors import UserError
from .worker import PopulationJob, Round, SlotFill, Worker

Task = tuple[PopulationJob, int, list[SlotFill]]


class Engine(Protocol):
    """Trains populations."""

    def advance(self, tasks: Sequence[Task], done: Callable[[], None] = lambda: None) -> list[Round]:
        """Train a round of each task. done: called after each."""
        ...

    def forget(self, names: Iterable[str]) -> None:
        """Free the memory of populations that are done."""
        ...

    def close(self) -> None:
        """Leave nothing open."""
        ...


class Local:
    """This process and its device."""

    def __init__(self) -> None:
        self._worker = Worker()

    def advance(self, tasks: Sequence[Task], done: Callable[[], None] = lambda: None) -> list[Round]:
        """As `Engine.advance`."""
        rounds = []
        self._worker.prepare([job for job, _, _ in tasks])
        for task in tasks:
            rounds.append(self._worker.advance(*task))
            done()
        return rounds

    def forget(self, names: Iterable[str]) -> None:
        """As `Engine.forget`."""
        for name in names:
            self._worker.forget(name)

    def close(self) -> None:
        """Nothing is open."""


class OnRay:
    """Workers of a Ray cluster: as many as its GPUs, or CPUs where it has no GPU, and at most as many as populations.

    Ray starts a lost worker again and repeats its task; the worker then loads the population's last checkpoint.
    """

    def __init__(self, address: str, populations: int) -> None:
        self._ray = ray = _ray()
        with _quiet():
            try:
                _answers(address)
                ray.init(
                    address=address or None,
                    logging_level=logging.ERROR,
                    log_to_driver=False,
                    runtime_env=_environment(),
                )
            except (ConnectionError, ValueError, RuntimeError, OSError) as error:
                text = str(error).strip().splitlines()[0]
                raise UserError(
                    f"--address is {address!r}: no Ray cluster answers there ({text}): begin one with ray start "
                    "--head, or leave out --address to have one on this machine"
                ) from None
        resources = ray.cluster_resources()
        gpus = int(resources.get("GPU", 0))
        self._slots = max(1, min(populations, gpus or int(resources.get("CPU", 1))))
        actor = ray.remote(Worker).options(
            num_cpus=0 if gpus else 1, num_gpus=1 if gpus else 0, scheduling_strategy="SPREAD",
            max_restarts=_RETRIES, max_task_retries=_RETRIES,
        )  # fmt: skip
        self._actors = [actor.remote() for _ in range(self._slots)]
        self._homes: dict[str, int] = {}

    def advance(self, tasks: Sequence[Task], done: Callable[[], None] = lambda: None) -> list[Round]:
        """As `Engine.advance`; a population stays with one worker."""
        futures = []
        for task in tasks:
            home = self._homes.setdefault(task[0].name, len(self._homes) % self._slots)
            futures.append(self._actors[home].advance.remote(*task))
        waiting = list(futures)
        while waiting:
            ready, waiting = self._ray.wait(waiting)
            for _ in ready:
                done()
        try:
            return self._ray.get(futures)
        except self._ray.exceptions.RayTaskError as error:
            if isinstance(error.cause, UserError):
                raise UserError(str(error.cause)) from None
            raise
        except self._ray.exceptions.RayError as error:
            raise UserError(
                f"a worker was lost {_RETRIES} times and more ({type(error).__name__}): see Ray's logs, free memory "
                "or give fewer --members, then go on with --resume"
            ) from error

    def forget(self, names: Iterable[str]) -> None:
        """As `Engine.forget`."""
        for name in names:
            home = self._homes.pop(name, None)
            if home is not None:
                self._actors[home].forget.remote(name)

    def close(self) -> None:
        """Leave the cluster; one that was started for this sweep ends."""
        self._ray.shutdown()


_RETRIES = 3


def _answers(address: str) -> None:
    """OSError if nothing listens at HOST:PORT: Ray itself would wait five minutes."""
    host, _, port = address.rpartition(":")
    if port.isdigit() and "/" not in host:
        socket.create_connection((host, int(port)), timeout=10).close()


def _environment() -> dict[str, Any]:
    """The workers' environment: all workers of a machine share a cache of compiled programs."""
    cache = jax.config.values["jax_compilation_cache_dir"]
    return {"env_vars": {"JAX_COMPILATION_CACHE_DIR": cache}} if cache else {}


def _ray() -> Any:
    try:
        import ray
    except ImportError as error:
        raise UserError(
            'engine ray needs ray, which isn\'t installed: pip install "jaxnav[sweep]", or leave out --engine'
        ) from error
    return ray


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Keep Ray's lines on every worker away from standard output, where the sweep shows its table."""
    with contextlib.redirect_stdout(None):
        yield
