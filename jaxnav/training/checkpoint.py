"""Checkpoints: all that training goes on from, and its configuration, saved whole or not at all.

The only user of Orbax.
"""

import contextlib
import gc
import json
import logging
import pathlib
import sys
import traceback
import warnings
import zlib
from collections.abc import Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import orbax.checkpoint as ocp

from ..errors import UserError, remedy
from .dataclass_json import differences
from .unraisable import without_orbax


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Keep Orbax and what is below it from printing: errors of a checkpoint are told by `Checkpoints` in one line.

    After a failure coroutines that were given up complain when they are collected. They are collected in here.
    """
    levels = {name: logging.getLogger(name).level for name in ("absl", "asyncio")}
    hook = sys.unraisablehook
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "coroutine .* was never awaited", RuntimeWarning)
        for name in levels:
            logging.getLogger(name).setLevel(logging.CRITICAL)
        sys.unraisablehook = without_orbax(hook)
        try:
            yield
        except Exception as error:
            _free_frames(error)
            gc.collect()
            raise
        finally:
            sys.unraisablehook = hook
            for name, level in levels.items():
                logging.getLogger(name).setLevel(level)


def _free_frames(error: BaseException | None) -> None:
    """Let go of what the frames of an error and of its causes hold; its traceback stays."""
    while error is not None:
        traceback.clear_frames(error.__traceback__)
        error = error.__cause__ or error.__context__


class Checkpoints:
    """The checkpoints in ``folder``; the two newest are kept."""

    def __init__(self, folder: pathlib.Path):
        self.folder = folder.resolve()
        # Of several processes that train together one saves, and each restores by itself: Orbax waits for no other.
        own = jax.process_index()
        options = ocp.CheckpointManagerOptions(
            max_to_keep=2,
            create=False,
            enable_async_checkpointing=False,
            step_prefix="step",
            multiprocessing_options=ocp.options.MultiprocessingOptions(own, {own}, f"process{own}"),
        )
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            with _quiet():
                self._manager = ocp.CheckpointManager(self.folder, options=options)
        except OSError as error:
            raise UserError(f"{self.folder} can't be used ({error.strerror}): {remedy(error)}") from error

    def save(self, step: int, state: Any, meta: dict[str, Any]) -> None:
        """Save ``state``, whole on this host, after env step ``step``.

        UserError: it can't be written, older checkpoints are kept.
        """
        key_impl = next(str(jax.random.key_impl(leaf)) for leaf in jax.tree.leaves(state) if _is_key(leaf))
        arrays = jax.device_get(_plain(state))
        meta = meta | {"key_impl": key_impl}
        meta = meta | {"checksum": _checksum(arrays, meta)}
        arguments = ocp.args.Composite(state=ocp.args.StandardSave(arrays), meta=ocp.args.JsonSave(meta))
        try:
            with _quiet():
                self._manager.save(step, args=arguments, force=True)
        except Exception as error:  # whatever Orbax and what is below it make of a file that can't be written
            raise UserError(
                f"{self.folder} could not take the checkpoint of step {step} ({_first_line(error)}): "
                f"{remedy(error)}, then go on with --resume"
            ) from error

    def latest_step(self) -> int | None:
        """The newest step saved, or None."""
        return self._manager.latest_step()

    def restore(self, like: Any, config: dict[str, Any]) -> tuple[Any, dict[str, Any]]:
        """(state, meta) of the newest checkpoint, on the host. like: its shapes; config: the run's, as JSON.

        UserError: none there, damaged, or of another configuration.
        """
        step = self.latest_step()
        if step is None:
            raise UserError(f"{self.folder} holds no checkpoint: train with --resume --out {self.folder.parent} first")
        where = self.folder / f"step_{step}"
        damaged = UserError(f"{where} is damaged: delete it to fall back to the one before, or train anew")
        try:
            with _quiet():
                found: Any = self._manager.restore(step, args=ocp.args.Composite(meta=ocp.args.JsonRestore()))
            meta = found.meta
            checksum = meta.pop("checksum")
            changed, state = differences(meta["config"], config), None
            if not changed:
                shapes = jax.eval_shape(_plain, like)
                # Numpy arrays are what Orbax then makes: the devices of who saved it may not be there, or too small.
                arrays = {name: np.empty(shape.shape, shape.dtype) for name, shape in shapes.items()}
                arguments = ocp.args.Composite(state=ocp.args.StandardRestore(arrays))
                with _quiet():
                    found = self._manager.restore(step, args=arguments)
                state = found.state
                if _checksum(state, meta) != checksum:
                    raise ValueError("changed bytes")
        except Exception as error:  # Orbax raises bare exceptions for damaged files
            raise damaged from error
        if changed:
            raise UserError(
                f"{where} is from another configuration ({', '.join(changed)} differ): "
                f"give the same values again, or another --out"
            )
        return _typed(state, like, meta["key_impl"]), meta


def _plain(tree):
    """``tree`` as a flat dict of arrays by their path, typed random keys as their data."""
    leaves = jax.tree_util.tree_flatten_with_path(tree)[0]
    return {jax.tree_util.keystr(path): jax.random.key_data(leaf) if _is_key(leaf) else leaf for path, leaf in leaves}


def _checksum(arrays, meta):
    """CRC-32 of everything in a checkpoint, since Orbax lets some changed bytes pass."""
    crc = zlib.crc32(json.dumps(meta, sort_keys=True).encode())
    for name in sorted(arrays):
        crc = zlib.crc32(np.ascontiguousarray(arrays[name]).reshape(-1).view(np.uint8).data, crc)
    return crc


def _typed(arrays, like, key_impl):
    """The inverse of `_plain`, shaped like ``like``."""
    leaves, treedef = jax.tree_util.tree_flatten_with_path(like)
    restored = [
        jax.random.wrap_key_data(arrays[name], impl=key_impl) if _is_key(model) else arrays[name]
        for name, model in ((jax.tree_util.keystr(path), model) for path, model in leaves)
    ]
    return jax.tree.unflatten(treedef, restored)


def _is_key(leaf):
    return jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key)


def _first_line(error):
    return (str(error).strip() or type(error).__name__).splitlines()[0][:200]
