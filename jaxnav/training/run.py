"""A run: its folder, and the Python loop around the training chunk that logs, evaluates, checkpoints and resumes."""

import contextlib
import dataclasses
import importlib.metadata
import json
import os
import pathlib
import platform
import signal
import subprocess
import threading
import time

import chex
import jax
import jax.numpy as jnp
import numpy as np

from ..agents.hsac import HSAC
from ..errors import UserError
from .checkpoint import Checkpoints
from .config import RunConfig, differences, from_json, to_json
from .evaluation import Evaluator, make_policy
from .loop import LoopState, Trainer
from .rollout import record

# The seed of evaluations during training; those that count use the seed of the run or of the command.
VALIDATION_SEED = 2**31

# Fields that may differ between a run and the command that resumes it: they don't change what is computed.
_FREE_FIELDS = ("out", "resume")


@chex.dataclass(frozen=True)
class Best:
    """The actor that did best in an evaluation during training, by its worst scene; score -1 before the first."""

    actor: chex.ArrayTree
    score: jax.Array
    step: jax.Array


@chex.dataclass(frozen=True)
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

    config.json, metrics.jsonl, checkpoints/, evaluation.json and the pictures lie in ``folder``.
    """

    def __init__(self, config: RunConfig):
        self.config = config
        self.folder = pathlib.Path(config.out)
        self.params = config.world.params
        self.world = config.world.world()
        self.agent = HSAC(config.agent)
        self.trainer = Trainer(self.world, self.agent, self.params, config.train)
        self.evaluator = Evaluator(self.world, self.agent, self.params)
        self._hyper = jax.tree.map(jnp.float32, config.hyper)
        self._compared = {name: value for name, value in to_json(config).items() if name not in _FREE_FIELDS}

    @classmethod
    def open(cls, folder):
        """The run that lies in ``folder``; UserError if there is none."""
        path = pathlib.Path(folder) / "config.json"
        try:
            config = from_json(RunConfig, json.loads(path.read_text())["config"])
        except FileNotFoundError:
            raise UserError(f"{folder} holds no run: there is no {path}") from None
        except (ValueError, KeyError, TypeError) as error:
            raise UserError(f"{path} can't be read ({error}): train anew with another --out") from error
        return cls(dataclasses.replace(config, out=str(folder)))

    def prepare_folder(self):
        """Make the run's folder, or check that it holds the run to resume; UserError if it holds something else."""
        config_path = self.folder / "config.json"
        if self.config.resume:
            if not config_path.exists():
                raise UserError(f"--out {self.folder} holds no run to resume: leave out --resume to start one")
            stored = Run.open(self.folder)._compared
            changed = differences(stored, self._compared)
            if changed:
                raise UserError(
                    f"--out {self.folder} holds a run with another {', '.join(changed)}: "
                    f"give the same values to resume it, or another --out"
                )
            return
        if self.folder.exists() and not self.folder.is_dir():
            raise UserError(f"--out {self.folder} is a file: give a folder")
        if self.folder.exists() and any(self.folder.iterdir()):
            holds = "already holds a run" if config_path.exists() else "is not empty"
            raise UserError(f"--out {self.folder} {holds}: go on with --resume, or give another --out")
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise UserError(f"--out {self.folder} can't be made ({error.strerror}): give another --out") from error
        self.write_json("config.json", {"config": to_json(self.config), **provenance()})

    def train(self, report, started):
        """Train to the end, from the newest checkpoint if the configuration says resume. Returns `Progress`.

        Call `prepare_folder` first.

        report: called with each line of metrics.jsonl; started: ``time.monotonic()`` at the start of the process.
        """
        checkpoints = Checkpoints(self.folder / "checkpoints")
        metrics_path = self.folder / "metrics.jsonl"
        progress, before, offset = self._start(checkpoints)
        if metrics_path.exists() and metrics_path.stat().st_size < offset:
            raise UserError(f"{metrics_path} is shorter than its checkpoint says: train anew with another --out")
        chunk = jax.jit(self.trainer.train_chunk, donate_argnums=0)
        steps, every = self.config.train.total_steps, self.config.train.steps_per_chunk
        saved = time.monotonic()

        def save(progress, line_end):
            wall = before + time.monotonic() - started
            meta = {"config": self._compared, "metrics_bytes": line_end, "wall_seconds": wall}
            checkpoints.save(int(progress.loop.counter), progress, meta)

        with _stop_signals() as stop, open(metrics_path, "a+b") as metrics_file:
            metrics_file.truncate(offset)
            while int(progress.loop.counter) < steps:
                loop, metrics = chunk(progress.loop, self._hyper)
                metrics, done = jax.device_get((metrics, loop.counter))
                self._check_finite(metrics, int(done))
                progress = progress.replace(loop=loop)
                line = self._line(metrics, int(done))
                if (int(done) // every) % self.config.train.evaluate_every == 0 or int(done) == steps:
                    line["evaluation"] = self.evaluator.success(loop.learner.actor, VALIDATION_SEED)
                    progress = progress.replace(best=_better(progress, min(line["evaluation"].values())))
                line["wall_seconds"] = round(before + time.monotonic() - started, 3)
                self._write_line(metrics_file, line)
                report(line)
                last = int(done) == steps or stop.number is not None
                if last or time.monotonic() - saved >= self.config.train.checkpoint_seconds:
                    save(progress, metrics_file.tell())
                    saved = time.monotonic()
                if stop.number is not None and int(done) < steps:
                    raise Interrupted(stop.number)
        return progress

    def restore(self):
        """The newest `Progress` of the run."""
        return Checkpoints(self.folder / "checkpoints").restore(self._like(), self._compared)[0]

    def actor(self, progress, which):
        """Actor parameters: ``which`` is last or best."""
        return progress.best.actor if which == "best" else progress.loop.learner.actor

    def record(self, actor, episodes, seed, voice=True):
        """``episodes`` recorded episodes of each scene."""
        indices = jnp.repeat(jnp.arange(len(self.world.scenes)), episodes)
        keys = jax.random.split(jax.random.key(seed), len(indices))
        limit = int(np.ceil(float(self.params.max_steps)))
        return record(self.world, self.params, make_policy(self.agent), (actor, voice), keys, indices, limit)

    def metrics(self):
        """The lines of metrics.jsonl."""
        return [json.loads(line) for line in (self.folder / "metrics.jsonl").read_text().splitlines()]

    def write_json(self, name, value):
        """Write a file of the run whole or not at all."""
        path = self.folder / name
        temporary = path.with_suffix(".tmp")
        try:
            temporary.write_text(json.dumps(value, indent=1) + "\n")
            temporary.replace(path)
        except OSError as error:
            raise UserError(f"{path} can't be written ({error.strerror}): free some space and run again") from error

    def _start(self, checkpoints):
        """(progress, wall seconds before, bytes of metrics.jsonl that belong to it)."""
        if self.config.resume and checkpoints.latest_step() is not None:
            progress, meta = checkpoints.restore(self._like(), self._compared)
            return progress, meta["wall_seconds"], meta["metrics_bytes"]
        return jax.jit(self._init)(), 0.0, 0

    def _init(self):
        loop = self.trainer.init(jax.random.key(self.config.seed), self._hyper)
        # A copy, since the loop's own arrays are donated to the next chunk.
        actor = jax.tree.map(jnp.copy, loop.learner.actor)
        return Progress(loop=loop, best=Best(actor=actor, score=jnp.float32(-1.0), step=jnp.int32(0)))

    def _like(self):
        return jax.eval_shape(self._init)

    def _line(self, metrics, counter):
        ended, arrived = metrics.pop("episodes_ended"), metrics.pop("episodes_arrived")
        scenes = [scene.name for scene in self.world.scenes]
        return {
            "env_steps": counter * self.config.train.episodes,
            "updates": counter * self.config.agent.updates_per_step,
            "success": {name: float(a / n) if n else None for name, a, n in zip(scenes, arrived, ended, strict=True)},
            "episodes": int(ended.sum()),
            **{name: float(value) for name, value in metrics.items()},
        }

    def _check_finite(self, metrics, counter):
        broken = [name for name, value in metrics.items() if not np.all(np.isfinite(value))]
        if broken:
            raise UserError(
                f"{', '.join(broken)} turned non-finite by update {counter * self.config.agent.updates_per_step}: "
                f"lower hyper.actor-lr and hyper.critic-lr; the last good checkpoint is kept in {self.folder}"
            )

    def _write_line(self, file, line):
        try:
            file.write(json.dumps(line).encode() + b"\n")
            file.flush()
        except OSError as error:
            raise UserError(
                f"{self.folder / 'metrics.jsonl'} can't be written ({error.strerror}): "
                f"free some space, then go on with --resume"
            ) from error


def _better(progress, score):
    """The `Best` after an evaluation with that score."""
    if score < float(progress.best.score):
        return progress.best
    actor = jax.tree.map(jnp.copy, progress.loop.learner.actor)
    return Best(actor=actor, score=jnp.float32(score), step=jnp.copy(progress.loop.counter))


def provenance():
    """Versions, git commit and device: what a result needs beside its configuration and seed."""
    packages = ("jaxnav", "jax", "jaxlib", "flax", "optax", "numpy")
    return {
        "versions": {"python": platform.python_version(), **{name: _version(name) for name in packages}},
        "git_commit": _git_commit(),
        "device": f"{jax.devices()[0].device_kind}, {os.cpu_count()} CPU cores",
    }


def _version(package):
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return None


def _git_commit():
    """The commit of this source tree, "+" appended if it has changes; None outside of git."""
    here = pathlib.Path(__file__).parent

    def git(*arguments):
        done = subprocess.run(["git", "-C", here, *arguments], capture_output=True, text=True, timeout=10)
        return done.stdout.strip() if done.returncode == 0 else None

    try:
        commit = git("rev-parse", "HEAD")
        # An installed copy may lie inside some other repository: only a tracked file speaks for its commit.
        if commit is None or not git("ls-files", pathlib.Path(__file__).name):
            return None
        return commit + ("+" if git("status", "--porcelain", "--untracked-files=no") else "")
    except (OSError, subprocess.TimeoutExpired):
        return None


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
