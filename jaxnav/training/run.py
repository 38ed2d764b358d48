"""A run: its configuration, its folder, and what is built of them to train and to play."""

import dataclasses
import functools
import pathlib
from typing import Any

import jax
import jax.numpy as jnp
from flax import struct

from .. import plugins
from ..errors import UserError
from ..language.table import default_table
from ..world import Params
from .checkpoint import Checkpoints
from .config import RunConfig, make_agent, resolve, run_from_json
from .dataclass_json import differences, to_json
from .devices import Layout, check_shards, is_first, together
from .evaluation import evaluator_of
from .folder import RunFolder
from .loop import LoopState, Trainer
from .memory import check_memory
from .policy import Policy
from .provenance import provenance

# Fields that may differ between a run and the command that resumes it: they don't change what is computed.
_FREE_FIELDS = ("out", "resume", "train.checkpoint_seconds")


class Best(struct.PyTreeNode):
    """The actor that did best in an evaluation during training, by its worst scene; score -1 before the first."""

    actor: Any
    score: jax.Array
    step: jax.Array


class Progress(struct.PyTreeNode):
    """The contents of a checkpoint."""

    loop: LoopState
    best: Best


class Run:
    """A run's folder, and what its configuration stands for.

    config:    every value of it.
    layout:    the devices on which it trains.
    folder:    its path; files: the `RunFolder` there.
    params:    floats of the world; world: where it trains.
    agent:     the learner; hyper: its floats.
    trainer:   the training chunk.
    evaluator: plays its policies in its world.

    Where several processes train together, all of them prepare the folder and train, and the first one alone writes.
    UserError: episodes or batch can't be parted into the shards of ``layout``.
    """

    def __init__(self, config: RunConfig, layout: Layout = Layout()):
        check_shards(config, layout.shards)
        self.config, self.layout = config, layout
        self.folder = pathlib.Path(config.out)
        self.files = RunFolder(self.folder)
        self.params: Params = config.world.params
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
        self.evaluator = evaluator_of(self.world, self.params)
        self.hyper = jax.tree.map(jnp.float32, config.hyper)
        # As JSON: the copies that it names need not be there yet.
        compared, sources = plugins.described(to_json(config))
        for *path, name in (field.split(".") for field in _FREE_FIELDS):
            functools.reduce(dict.get, path, compared).pop(name)
        if layout.shards > 1:  # runs from before there were any have one
            compared["shards"] = layout.shards
        if sources:
            compared["sources"] = sources
        self._compared = compared

    @classmethod
    def open(cls, folder: str | pathlib.Path) -> "Run":
        """The run that lies in ``folder``; UserError if there is none."""
        files = RunFolder(folder)
        default_table()  # what is wrong with it is not the run's fault
        try:
            stored = files.read_config()
        except (OSError, ValueError) as error:
            raise _unreadable(files, error) from error
        try:
            named = plugins.check(stored["config"], stored.get("sources", {}), folder)
            config = resolve(dataclasses.replace(run_from_json(named), out=str(folder)))
            run = cls(config, Layout(stored.get("shards", 1)))
        except plugins.Changed:
            raise
        except (UserError, OSError, ValueError, KeyError, TypeError, AttributeError) as error:
            raise _unreadable(files, error) from error
        if stored.get("embeddings") != run._embeddings():
            raise UserError(
                f"{folder} was trained with another table of embeddings than this jaxnav has: use the version that "
                "trained it, or train anew with another --out"
            )
        return run

    def _embeddings(self):
        """The fingerprint of the table of embeddings that it hears; None if it hears codes."""
        return default_table().fingerprint if self.agent.can_hear else None

    def prepare_folder(self) -> None:
        """Make the run's folder, or check that it holds the run to resume.

        UserError: it holds something else, or replay is larger than memory.
        """
        with together():
            if is_first():
                if self.config.resume:
                    self._check_resumable()
                check_memory(self.config, self.trainer.bytes_per_transition, self.layout.share_in_memory)
                if not self.config.resume:
                    self.files.create()
                    named, sources = plugins.keep(to_json(self.config), self.folder)
                    stored = {"config": named, "sources": sources, "shards": self.layout.shards}
                    self.files.write_config(stored | {"embeddings": self._embeddings()} | provenance())

    def _check_resumable(self):
        if not self.files.config_path.exists():
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

    def start(self, checkpoints: Checkpoints) -> tuple[Progress, float, int]:
        """(progress, wall seconds before, bytes of metrics.jsonl that belong to it) from which training goes on."""
        if self.config.resume and checkpoints.latest_step() is not None:
            progress, meta = self._restore(checkpoints)
            return progress, meta["wall_seconds"], meta["metrics_bytes"]
        loop, best = self.layout.start(self._init)
        return Progress(loop=loop, best=best), 0.0, 0

    def meta(self, metrics_bytes: int, wall_seconds: float) -> dict[str, Any]:
        """The JSON that a checkpoint holds beside its `Progress`."""
        return {"config": self._compared, "metrics_bytes": metrics_bytes, "wall_seconds": wall_seconds}

    def restore(self) -> Progress:
        """The newest `Progress` of the run. UserError: there is none, or it is damaged."""
        if not self.files.checkpoints_path.is_dir():
            raise UserError(f"{self.folder} holds no checkpoint: train with --resume --out {self.folder} first")
        return self._restore(Checkpoints(self.files.checkpoints_path))[0]

    def _restore(self, checkpoints):
        loop, best = jax.eval_shape(self._init)
        progress, meta = checkpoints.restore(Progress(loop=loop, best=best), self._compared)
        return progress.replace(loop=self.layout.place(progress.loop)), meta

    def _init(self):
        loop = self.trainer.init(jax.random.key(self.config.seed), self.hyper)
        # A copy, since the loop's own arrays are donated to the next chunk.
        actor = jax.tree.map(jnp.copy, self.agent.policy(loop.learner))
        return loop, Best(actor=actor, score=jnp.float32(-1.0), step=jnp.int32(0))

    def policy(self, which: str = "last", progress: Progress | None = None) -> Policy:
        """The policy that is last or best in ``progress``, in the newest checkpoint if that is not given.

        UserError: there is no checkpoint, or was no evaluation yet to be best in.
        """
        progress = self.restore() if progress is None else progress
        if which == "last":
            return self.policy_of(self.layout.local(self.agent.policy(progress.loop.learner)))
        if progress.best.score < 0:
            raise UserError(f"{self.folder} has no best policy before its first evaluation: give --policy last")
        return self.policy_of(progress.best.actor)

    def policy_of(self, parameters: Any) -> Policy:
        """The `Policy` with these parameters, among people who speak phrases of the test split."""
        vocabulary = self.agent.vocabulary("test")
        return Policy(parameters, True, vocabulary, learner=self.agent, world=self.world, config=self.config)


def _unreadable(files: RunFolder, error: Exception) -> UserError:
    return UserError(f"{files.config_path} can't be read ({error}): train anew with another --out")
