"""How much replay a machine holds: told before training, not by the kernel when the first checkpoint is saved."""

import math
import pathlib

import jax
import psutil

from ..errors import UserError
from .config import RunConfig

_CONTAINER_LIMIT = pathlib.Path("/sys/fs/cgroup/memory.max")  # Linux, control groups version 2


def check_memory(config: RunConfig, bytes_per_transition: int, share: float = 1.0) -> None:
    """UserError if replay and the copy of it that a checkpoint takes are larger than memory.

    share: of replay that lies in the memory of a device, where there are several; the copy is a whole one.
    """
    train = config.train
    row, memory = math.ceil((1.0 + share) * bytes_per_transition * train.episodes), available_memory()
    if train.replay_rows * row <= memory:
        return
    fits = memory // row
    remedy = f"give at most {fits}" if fits else "give fewer train.episodes"
    if config.resume:
        remedy = "resume it where there is more"
    raise UserError(
        f"train.replay_rows is {train.replay_rows}: replay, and its copy in a checkpoint, would take "
        f"{train.replay_rows * row / 1e9:.1f} GB of {memory / 1e9:.1f} GB of memory: {remedy}"
    )


def free_memory() -> int:
    """Bytes of `available_memory` that nobody has yet."""
    stats = jax.devices()[0].memory_stats() or {}
    if "bytes_limit" in stats:
        return stats["bytes_limit"] - stats["bytes_in_use"]
    return min(available_memory(), psutil.virtual_memory().available)


def available_memory() -> int:
    """Bytes of the device that trains: of an accelerator its own, of a CPU the machine's or its container's."""
    stats = jax.devices()[0].memory_stats() or {}  # none of a CPU
    if "bytes_limit" in stats:
        return stats["bytes_limit"]
    memory = psutil.virtual_memory().total
    try:
        return min(memory, int(_CONTAINER_LIMIT.read_text()))
    except (OSError, ValueError):  # no such file, or "max"
        return memory
