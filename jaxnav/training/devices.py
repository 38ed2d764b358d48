"""One run on several devices and in several processes: what lies where, and what the processes tell each other.

A run on a mesh is parted into `SHARDS` shards, whatever the number of its devices: each has its own episodes, their
replay and its share of every batch. Random numbers are drawn by shard, so that devices change nothing but the order
in which sums are added up. Parameters are replicated. XLA parts the program (GSPMD): `Trainer` knows of no device.
"""

import contextlib
import dataclasses
import os
import re
from collections.abc import Callable, Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.experimental import multihost_utils
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from ..errors import UserError
from .config import RunConfig
from .loop import LoopState

SHARDS = 8

_AXIS = "shards"
_TEXT = 1000  # bytes of an error that other processes are told


def _quick_to_compile() -> dict[str, Any] | None:
    """Options for a program that runs once: on a CPU it compiles in a third of the time, and runs slower."""
    if jax.default_backend() != "cpu":
        return None
    options = {"xla_backend_optimization_level": 0, "xla_cpu_use_fusion_emitters": False}
    try:
        jax.jit(lambda: 0, compiler_options=options).lower().compile()
    except jax.errors.JaxRuntimeError:  # another jax, which doesn't know them
        return None
    return options


@dataclasses.dataclass(frozen=True)
class Layout:
    """Where the numbers of a training lie.

    shards: into which it is parted: with the seed they decide its numbers; mesh: the devices that hold them, of one
    axis, each as many whole shards; None is one device, JAX's default.
    """

    shards: int = 1
    mesh: Mesh | None = None

    def start(self, init: Callable[[], tuple[LoopState, Any]]) -> tuple[LoopState, Any]:
        """The two results of ``init()``: a `LoopState`, made where it is to lie, and another pytree, made `local`."""
        if self.mesh is None:
            return jax.jit(init, compiler_options=_quick_to_compile())()
        loop, beside = jax.jit(init, out_shardings=(self._of_loop(), self._sharding()))()
        return loop, self.local(beside)

    def vmap(self, function: Callable[..., Any], in_axes: tuple[int | None, ...]) -> Callable[..., Any]:
        """``jax.vmap`` over episodes, of which each device maps over its own.

        XLA would do as much for most functions, not for one that does something of its own with a whole batch, such as
        to compute only some of its rows (`jaxnav.world.linear_program`).
        """
        mapped = jax.vmap(function, in_axes)
        if self.mesh is None:
            return mapped
        specs = tuple(PartitionSpec() if axis is None else PartitionSpec(_AXIS) for axis in in_axes)
        return jax.shard_map(mapped, mesh=self.mesh, in_specs=specs, out_specs=PartitionSpec(_AXIS), check_vma=False)

    def chunk(self, train_chunk: Callable[..., Any], loop: LoopState, hyper: Any) -> Callable[..., Any]:
        """``train_chunk(loop, hyper)`` for arguments like these, of which it is given the first for good."""
        if self.mesh is None:
            return jax.jit(train_chunk, donate_argnums=0)
        sharding = self._of_loop(), self._sharding()
        program = jax.jit(train_chunk, donate_argnums=0, in_shardings=sharding, out_shardings=sharding)
        program = program.lower(loop, hyper).compile()
        # Processes that begin to sum up with each other have to do so within half a minute (gloo), and one may compile
        # for longer than the other.
        everybodys(0)
        return program

    def place(self, loop: LoopState) -> LoopState:
        """``loop`` from the host's memory, whole in every process, on the devices."""
        if self.mesh is None:
            return jax.tree.map(jnp.asarray, loop)
        shardings = jax.tree.broadcast(self._of_loop(), loop, is_leaf=lambda leaf: isinstance(leaf, NamedSharding))
        return jax.tree.map(_placed, loop, shardings)

    def gather(self, loop: LoopState) -> LoopState:
        """``loop`` whole in the memory of each host. All processes have to ask for it at once."""
        return loop if self.mesh is None else jax.tree.map(_gathered, loop)

    def local(self, tree: Any) -> Any:
        """Replicated arrays as arrays of this process's first device alone, for computing on that device."""
        return tree if self.mesh is None else jax.tree.map(lambda leaf: leaf.addressable_data(0), tree)

    @property
    def share_in_memory(self) -> float:
        """Which part of all shards lies in one memory: a device's own, or the one that all of a process share."""
        if self.mesh is None:
            return 1.0
        return 1.0 / (jax.process_count() if jax.default_backend() == "cpu" else self.mesh.size)

    def _of_loop(self):
        return LoopState(
            counter=self._sharding(),
            key=self._sharding(),
            scene=self._sharding(),
            learner=self._sharding(),
            replay=self._sharding(None, _AXIS),
            states=self._sharding(_AXIS),
            ended=self._sharding(_AXIS),
        )

    def _sharding(self, *axes):
        assert self.mesh is not None
        return NamedSharding(self.mesh, PartitionSpec(*axes))


def layout_on(devices: int) -> Layout:
    """`SHARDS` shards on that many devices, as many of each process; 0: a run that is not parted, on one device.

    UserError: devices don't part the shards evenly, or there are fewer.
    """
    if devices == 0:
        return Layout()
    if devices < 0 or SHARDS % devices:
        divisors = [str(n) for n in range(1, SHARDS + 1) if SHARDS % n == 0]
        raise UserError(
            f"--devices is {devices}: give {', '.join(divisors[:-1])} or {divisors[-1]}, which part the {SHARDS} "
            "shards of a run evenly"
        )
    processes, kind = jax.process_count(), jax.default_backend()
    if devices % processes:
        raise UserError(f"--devices is {devices}: there are {processes} processes: give a multiple of them")
    of_process = [[d for d in jax.devices() if d.process_index == process] for process in range(processes)]
    fewest = min(map(len, of_process))
    if devices > processes * fewest:
        most = max(n for n in range(1, SHARDS + 1) if SHARDS % n == 0 and n <= processes * fewest)
        where = f" in each of {processes} processes" if processes > 1 else ""
        each = devices // processes
        cpu = f", or set XLA_FLAGS=--xla_force_host_platform_device_count={each}" if kind == "cpu" else ""
        raise UserError(f"--devices is {devices}: there are {fewest} {kind} devices{where}: give at most {most}{cpu}")
    chosen = [device for of_one in of_process for device in of_one[: devices // processes]]
    return Layout(SHARDS, Mesh(np.array(chosen), (_AXIS,)))


def check_shards(config: RunConfig, shards: int) -> None:
    """UserError: episodes or batch of this `RunConfig` can't be parted into that many shards."""
    sizes = {"train.episodes": config.train.episodes, "agent.batch": getattr(config.agent, "batch", shards)}
    for name, size in sizes.items():
        if size % shards:
            raise UserError(f"{name} is {size}: give a multiple of {shards}, the shards of a run with --devices")


def join_processes() -> None:
    """Become one of the processes that train together, as the environment tells; before JAX's first computation.

    UserError: it tells of none, or they don't answer.
    """
    # It would have SIGTERM do nothing: a run agrees by itself when to stop.
    jax.config.update("jax_enable_preemption_service", False)
    numbers = {}
    for name in ("num_processes", "process_id"):  # JAX itself reads the address alone
        text = os.environ.get(f"JAX_{name.upper()}")
        if text is not None and not text.isdecimal():
            raise UserError(f"JAX_{name.upper()} is {text!r}: give a whole number")
        if text is not None:
            numbers[name] = int(text)
    address = os.environ.get("JAX_COORDINATOR_ADDRESS")
    if address is not None and not re.search(r":\d+$", address):
        raise UserError(f"JAX_COORDINATOR_ADDRESS is {address!r}: give HOST:PORT of the first process")
    try:
        jax.distributed.initialize(**numbers)
    except (ValueError, RuntimeError) as error:
        raise UserError(
            f"--distributed finds no other processes ({str(error).splitlines()[0][:200]}): start jaxnav by Slurm, or "
            "in each process set JAX_COORDINATOR_ADDRESS to HOST:PORT of the first, JAX_NUM_PROCESSES, and "
            "JAX_PROCESS_ID from 0"
        ) from error


def is_first() -> bool:
    """Whether this process is the one that evaluates, prints and writes."""
    return jax.process_index() == 0


@contextlib.contextmanager
def together() -> Iterator[None]:
    """All processes end well here, or all with the `UserError` of one of them: nobody waits for one that has gone."""
    failure = None
    try:
        yield
    except UserError as error:
        failure = error
    told = everybodys(np.frombuffer(str(failure or "").encode()[:_TEXT].ljust(_TEXT, b"\0"), np.uint8))
    if failure:
        raise failure
    for text in filter(None, (row.tobytes().rstrip(b"\0").decode(errors="ignore") for row in told)):
        raise UserError(text)


def everybodys(value: Any) -> np.ndarray:
    """``value``, small and on every process of the same shape, of all processes: numpy `[processes, ...]`."""
    return multihost_utils.process_allgather(np.asarray(value))


def _placed(leaf, sharding):
    if jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key):
        return jax.random.wrap_key_data(_placed(jax.random.key_data(leaf), sharding), impl=jax.random.key_impl(leaf))
    host = np.asarray(leaf)
    return jax.make_array_from_callback(host.shape, sharding, lambda index: host[index])


def _gathered(leaf):
    if jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key):
        return jax.random.wrap_key_data(_gathered(jax.random.key_data(leaf)), impl=jax.random.key_impl(leaf))
    return multihost_utils.process_allgather(leaf, tiled=True)
