"""Where the populations of a sweep train: in this process, or in Ray's, one population after another in each."""

import contextlib
import logging
import socket

import jax

from ..errors import UserError
from .worker import Round, Worker


class Local:
    """This process and its device."""

    def __init__(self):
        self._worker = Worker()

    def advance(self, jobs, done=lambda: None) -> list[Round]:
        """A round of each job: (unit, round, fills). done: called after each."""
        rounds = []
        self._worker.prepare([unit for unit, _, _ in jobs])
        for job in jobs:
            rounds.append(self._worker.advance(*job))
            done()
        return rounds

    def forget(self, names):
        """Free what populations take that are done."""
        for name in names:
            self._worker.forget(name)

    def close(self):
        """Nothing is left open."""


class OnRay:
    """Workers of a Ray cluster: as many as it has GPUs, or without one CPUs, and no more than populations.

    Ray starts a lost worker anew and asks it again; it then takes up the population's last checkpoint.
    """

    def __init__(self, address, populations):
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

    def advance(self, jobs, done=lambda: None) -> list[Round]:
        """As `Local.advance`; every population stays with one worker."""
        futures = []
        for job in jobs:
            home = self._homes.setdefault(job[0].name, len(self._homes) % self._slots)
            futures.append(self._actors[home].advance.remote(*job))
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

    def forget(self, names):
        """As `Local.forget`."""
        for name in names:
            home = self._homes.pop(name, None)
            if home is not None:
                self._actors[home].forget.remote(name)

    def close(self):
        """Leave the cluster; one that was begun for this sweep ends."""
        self._ray.shutdown()


_RETRIES = 3


def _answers(address):
    """OSError if nobody listens at HOST:PORT, for whom Ray would wait five minutes."""
    host, _, port = address.rpartition(":")
    if port.isdigit() and "/" not in host:
        socket.create_connection((host, int(port)), timeout=10).close()


def _environment():
    """Of the workers: what one of them compiled on a machine, the others there load."""
    cache = jax.config.jax_compilation_cache_dir
    return {"env_vars": {"JAX_COMPILATION_CACHE_DIR": cache}} if cache else {}


def _ray():
    try:
        import ray
    except ImportError as error:
        raise UserError(
            'engine ray needs ray, which isn\'t installed: pip install "jaxnav[sweep]", or leave out --engine'
        ) from error
    return ray


@contextlib.contextmanager
def _quiet():
    """Ray tells of every worker on standard output; a sweep has a table there."""
    with contextlib.redirect_stdout(None):
        yield
