"""A run: its folder, and the Python loop around the training chunk that logs, evaluates, checkpoints and resumes."""

import contextlib
import dataclasses
import errno
import functools
import json
import os
import pathlib
import signal
import threading
import time

import chex
import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from ..errors import UserError, remedy
from ..language.table import default_table
from .checkpoint import Checkpoints
from .config import RunConfig, make_agent, resolve, run_from_json
from .dataclass_json import differences, to_json
from .devices import Layout, check_shards, everybodys, is_first, together
from .evaluation import VALIDATION_SEED, Evaluator
from .loop import LoopState, Trainer
from .memory import check_memory
from .policy import Policy
from .provenance import provenance

# Fields that may differ between a run and the command that resumes it: they don't change what is computed.
_FREE_FIELDS = ("out", "resume", "train.checkpoint_seconds")


@struct.dataclass
class Best:
    """The actor that did best in an evaluation during training, by its worst scene; score -1 before the first."""

    actor: chex.ArrayTree
    score: jax.Array
    step: jax.Array


@struct.dataclass
class Progress:
    """What a checkpoint holds."""

    loop: LoopState
    best: Best


class Interrupted(Exception):
    """Training stopped on request; a checkpoint is saved. ``signal`` is the signal's number."""

    def __init__(self, number):
        self.signal = number


class Run:
    """A run's folder with what is needed to train, evaluate and draw it.

    config.json, metrics.jsonl, checkpoints/, evaluation.json and the pictures lie in ``folder``. Where several
    processes train together, all of them prepare the folder and train, and the first one alone writes.

    UserError: episodes or batch can't be parted into the shards of ``layout``.
    """

    def __init__(self, config: RunConfig, layout: Layout = Layout()):
        check_shards(config, layout.shards)
        self.config, self.layout = config, layout
        self.folder = pathlib.Path(config.out)
        self.params = config.world.params
        self.world = config.world.world()
        self.agent = make_agent(config)
        self.trainer = Trainer(
            self.world,
            self.agent,
            self.params,
            config.train,
            config.world.randomise,
            shards=layout.shards,
            vmap=layout.vmap,
        )
        self.evaluator = Evaluator(self.world, self.params)
        self._hyper = jax.tree.map(jnp.float32, config.hyper)
        compared = to_json(config)
        for *path, name in (field.split(".") for field in _FREE_FIELDS):
            functools.reduce(dict.get, path, compared).pop(name)
        if layout.shards > 1:  # runs from before there were any have one
            compared["shards"] = layout.shards
        self._compared = compared

    @classmethod
    def open(cls, folder):
        """The run that lies in ``folder``; UserError if there is none."""
        path = pathlib.Path(folder) / "config.json"
        default_table()  # what is wrong with it is not the run's fault
        try:
            stored = json.loads(path.read_text())
            config = resolve(dataclasses.replace(run_from_json(stored["config"]), out=str(folder)))
            run = cls(config, Layout(stored.get("shards", 1)))
        except (FileNotFoundError, NotADirectoryError):
            raise UserError(f"{folder} holds no run: there is no {path}") from None
        except (UserError, OSError, ValueError, KeyError, TypeError, AttributeError) as error:
            raise UserError(f"{path} can't be read ({error}): train anew with another --out") from error
        if stored.get("embeddings") != run._embeddings():
            raise UserError(
                f"{folder} was trained with another table of embeddings than this jaxnav has: use the version that "
                "trained it, or train anew with another --out"
            )
        return run

    def _embeddings(self):
        """What tells the table of embeddings it hears; None if it hears codes."""
        return None if self.agent.vocabulary("train") is None else default_table().fingerprint

    def prepare_folder(self):
        """Make the run's folder, or check that it holds the run to resume.

        UserError: it holds something else, or replay is larger than memory.
        """
        with together():
            if is_first():
                self._prepare_folder()

    def _prepare_folder(self):
        config_path = self.folder / "config.json"
        if self.config.resume:
            if not config_path.exists():
                raise UserError(f"--out {self.folder} holds no run to resume: leave out --resume to start one")
            stored = Run.open(self.folder)
            if stored.layout.shards != self.layout.shards:
                remedy = "leave --devices out" if stored.layout.shards == 1 else "give --devices, 1 or more,"
                raise UserError(
                    f"--out {self.folder} holds a run of {stored.layout.shards} shards, not of {self.layout.shards}: "
                    f"{remedy} to resume it, or another --out"
                )
            changed = differences(stored._compared, self._compared)
            if changed:
                raise UserError(
                    f"--out {self.folder} holds a run with another {', '.join(changed)}: "
                    f"give the same values to resume it, or another --out"
                )
        check_memory(self.config, self.trainer.bytes_per_transition, self.layout.share_in_memory)
        if self.config.resume:
            return
        if self.folder.exists() and not self.folder.is_dir():
            raise UserError(f"--out {self.folder} is a file: give a folder")
        if self.folder.exists() and any(self.folder.iterdir()):
            if config_path.exists():
                raise UserError(f"--out {self.folder} already holds a run: go on with --resume, or give another --out")
            raise UserError(f"--out {self.folder} is not empty: give another --out")
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise UserError(f"--out {self.folder} can't be made ({error.strerror}): give another --out") from error
        stored = {"config": to_json(self.config), "shards": self.layout.shards, "embeddings": self._embeddings()}
        self.write_json("config.json", stored | provenance())

    def train(self, report, started):
        """Train to the end, from the newest checkpoint if the configuration says resume. Returns `Progress`.

        Call `prepare_folder` first.

        report: called with each line of metrics.jsonl; started: ``time.monotonic()`` at the start of the process.
        """
        metrics_path = self.folder / "metrics.jsonl"
        with together():
            checkpoints = Checkpoints(self.folder / "checkpoints")
            progress, before, offset = self._start(checkpoints)
            if is_first() and (metrics_path.stat().st_size if metrics_path.exists() else 0) < offset:
                raise UserError(f"{metrics_path} is shorter than its checkpoint says: train anew with another --out")
            metrics_file = self._open(metrics_path)
        chunk = self.layout.chunk(self.trainer.train_chunk, progress.loop, self._hyper)
        steps = self.config.train.total_steps
        saved = time.monotonic()

        def save(progress, line_end):
            wall = before + time.monotonic() - started
            meta = {"config": self._compared, "metrics_bytes": line_end, "wall_seconds": wall}
            checkpoints.save(int(progress.loop.counter), progress, meta)

        with _stop_signals() as stop, metrics_file:
            if is_first():
                metrics_file.truncate(offset)
            while int(progress.loop.counter) < steps:
                began = time.monotonic()
                loop, metrics = chunk(progress.loop, self._hyper)
                metrics, done = jax.device_get((metrics, loop.counter))
                self._check_finite(metrics, int(done), checkpoints.latest_step())
                progress = progress.replace(loop=loop)
                with together():
                    if is_first():
                        line = self._line(metrics, int(done))
                        progress = self._evaluated(progress, line, int(done))
                        line["wall_seconds"] = round(before + time.monotonic() - started, 3)
                        self._write_line(metrics_file, line)
                        report(line)
                # Another chunk as long as this one must still fit into what a kill may cost.
                now = time.monotonic()
                due = 2 * now - began - saved >= self.config.train.checkpoint_seconds
                # Clocks and signals are each process's own: the first one's clock counts, and anybody's signal.
                votes = everybodys([due, stop.number or 0])
                due, number = votes[0, 0], votes[:, 1].max()
                if int(done) == steps or due or number:
                    whole = progress.replace(loop=self.layout.gather(loop))
                    with together():
                        if is_first():
                            save(whole, metrics_file.tell())
                    saved = time.monotonic()
                if number:
                    raise Interrupted(int(number))
            if number := everybodys(stop.number or 0).max():  # while the last checkpoint was saved
                raise Interrupted(int(number))
        return progress

    def _evaluated(self, progress, line, counter):
        """``progress`` after the evaluation that is due, if one is, which ``line`` is then told."""
        chunks = counter // self.config.train.steps_per_chunk
        if chunks % self.config.train.evaluate_every and counter < self.config.train.total_steps:
            return progress
        actor = self.layout.local(self.agent.policy(progress.loop.learner))
        line["evaluation"] = self.evaluator.success(self.policy_of(actor), VALIDATION_SEED)
        return progress.replace(best=self._better(progress, actor, counter, min(line["evaluation"].values())))

    def _better(self, progress, actor, counter, score):
        """The `Best` after an evaluation of ``actor`` with that score."""
        if np.float32(score) < progress.best.score:
            return progress.best
        # A copy, since the loop's own arrays are donated to the next chunk.
        return Best(actor=jax.tree.map(jnp.copy, actor), score=jnp.float32(score), step=jnp.int32(counter))

    def restore(self):
        """The newest `Progress` of the run."""
        folder = self.folder / "checkpoints"
        if not folder.is_dir():
            raise UserError(f"{self.folder} holds no checkpoint: train with --resume --out {self.folder} first")
        progress, _ = Checkpoints(folder).restore(self._like(), self._compared)
        return progress.replace(loop=self.layout.place(progress.loop))

    def policy(self, which: str = "last", progress: Progress | None = None) -> Policy:
        """The policy that is last or best in ``progress``, in the newest checkpoint if that is not given.

        UserError: there is no checkpoint, or was no evaluation yet to be best in.
        """
        return self.policy_of(self.actor(self.restore() if progress is None else progress, which))

    def policy_of(self, parameters) -> Policy:
        """The `Policy` with these parameters, among people who speak phrases of the test split."""
        vocabulary = self.agent.vocabulary("test")
        return Policy(parameters, True, vocabulary, learner=self.agent, world=self.world, config=self.config)

    def actor(self, progress, which):
        """Actor parameters: ``which`` is last or best; UserError if there was no evaluation yet to be best in."""
        if which == "best" and progress.best.score < 0:
            raise UserError(f"{self.folder} has no best policy before its first evaluation: give --policy last")
        return progress.best.actor if which == "best" else self.layout.local(self.agent.policy(progress.loop.learner))

    def metrics(self):
        """The lines of metrics.jsonl; one that a kill cut off at the end is left out."""
        path = self.folder / "metrics.jsonl"
        try:
            whole = path.read_text().rpartition("\n")[0]
            return [json.loads(line) for line in whole.splitlines()]
        except (OSError, ValueError) as error:
            raise UserError(f"{path} can't be read ({error}): train anew with another --out") from error

    def write_json(self, name, value):
        """Write a file of the run whole or not at all."""
        path = self.folder / name
        temporary = path.with_suffix(".tmp")
        try:
            temporary.write_text(json.dumps(value, indent=1) + "\n")
            temporary.replace(path)
        except OSError as error:
            temporary.unlink(missing_ok=True)
            raise UserError(f"{path} can't be written ({error.strerror}): {remedy(error)}") from error

    def _start(self, checkpoints):
        """(progress, wall seconds before, bytes of metrics.jsonl that belong to it)."""
        if self.config.resume and checkpoints.latest_step() is not None:
            progress, meta = checkpoints.restore(self._like(), self._compared)
            progress = progress.replace(loop=self.layout.place(progress.loop))
            return progress, meta["wall_seconds"], meta["metrics_bytes"]
        loop, best = self.layout.start(self._init)
        return Progress(loop=loop, best=best), 0.0, 0

    def _init(self):
        loop = self.trainer.init(jax.random.key(self.config.seed), self._hyper)
        # A copy, since the loop's own arrays are donated to the next chunk.
        actor = jax.tree.map(jnp.copy, self.agent.policy(loop.learner))
        return loop, Best(actor=actor, score=jnp.float32(-1.0), step=jnp.int32(0))

    def _like(self):
        loop, best = jax.eval_shape(self._init)
        return Progress(loop=loop, best=best)

    def _line(self, metrics, counter):
        ended, arrived = metrics.pop("episodes_ended"), metrics.pop("episodes_arrived")
        scenes = [scene.name for scene in self.world.scenes]
        return {
            "env_steps": counter * self.config.train.episodes,
            "updates": self.config.agent.updates(counter),
            "success": {name: float(a / n) if n else None for name, a, n in zip(scenes, arrived, ended, strict=True)},
            "episodes": int(ended.sum()),
            **{name: float(value) for name, value in metrics.items()},
        }

    def _check_finite(self, metrics, counter, saved):
        broken = [name for name in ("critic_loss", "actor_loss", "q") if not np.isfinite(metrics[name])]
        if not metrics.pop("finite"):
            broken = broken or ["the learner"]
        if broken:
            kept = "none was saved yet" if saved is None else f"that of step {saved} is kept"
            raise UserError(
                f"{', '.join(broken)} turned non-finite by step {counter} (update "
                f"{self.config.agent.updates(counter)}): train anew with lower hyper.actor_lr and "
                f"hyper.critic_lr and another --out; of the good checkpoints {kept} in {self.folder}"
            )

    def _open(self, path):
        """metrics.jsonl, to be appended to; what other processes than the first append goes nowhere."""
        try:
            # Without a buffer, so that closing it after a failure can't fail again.
            return open(path if is_first() else os.devnull, "ab", buffering=0)
        except OSError as error:
            raise UserError(f"{path} can't be opened ({error.strerror}): {remedy(error)}") from error

    def _write_line(self, file, line):
        try:
            data = json.dumps(line).encode() + b"\n"
            if file.write(data) < len(data):  # what still fitted
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        except OSError as error:
            raise UserError(
                f"{self.folder / 'metrics.jsonl'} can't be written ({error.strerror}): "
                f"{remedy(error)}, then go on with --resume"
            ) from error


class _Stop:
    number = None


@contextlib.contextmanager
def _stop_signals():
    """Note SIGINT and SIGTERM instead of dying of them; a second one has its usual effect."""
    stop, before = _Stop(), {}
    if threading.current_thread() is not threading.main_thread():
        yield stop  # only the main thread may handle signals
        return

    def note(number, frame):
        stop.number = number
        signal.signal(number, before[number])

    for number in (signal.SIGINT, signal.SIGTERM):
        before[number] = signal.signal(number, note)
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
