"""The folder of trainings and plays that the tables share: what one table has done, another does not do again."""

import json
import pathlib
import time

import jax
import numpy as np

from experiments import study
from experiments.tables import methods
from jaxnav.errors import UserError
from jaxnav.files import write_atomically, write_json
from jaxnav.language.table import default_table
from jaxnav.training import EpisodeSummary, differences, to_json
from jaxnav.training.provenance import provenance


class Runs:
    """Trainings, each of all seeds of a method in a scene until the end of a budget, and what was played with them.

    seeds: how many of each training; seed: of the episodes that are played.
    """

    def __init__(self, folder: pathlib.Path, seeds: int, seed: int):
        self.folder, self.seeds, self.seed = folder, seeds, seed
        self.console = study.console()
        self.source = provenance()  # of the code that runs, whatever is committed meanwhile
        study.make_folder(folder, "--runs")

    def identity(self, config):
        """All of a configuration but names and folders: it decides on the training."""
        whole = to_json(config)
        for name in ("preset", "seed", "out", "resume"):
            whole.pop(name)
        return whole | {"seeds": list(range(self.seeds)), "embeddings": default_table().fingerprint}

    def of(self, method, scene, budget):
        """The folder of a training."""
        return self.folder / f"{method.training}-{scene}-{budget}"

    def train(self, programs, method, scene, index, budgets):
        """Train all seeds of a method in a scene, and keep their policies at the end of each budget.

        budgets: {name: environment steps}, in the order of training.
        """
        population = programs.population
        hyper = population.config.hyper
        start, broken = time.monotonic(), ()
        loop = population.start(range(self.seeds), hyper, index)
        show = methods.reporter(self.console, f"{method.training} {scene}", population.config.train.episodes)
        for budget, env_steps in budgets.items():
            steps = env_steps // population.config.train.episodes
            loop, trained = population.train(loop, hyper, steps, show, broken)
            broken, seconds = trained.broken, time.monotonic() - start
            folder = self.of(method, scene, budget)
            if (folder / "training.json").exists():
                continue  # whole, and perhaps played: an interruption came later
            folder.mkdir(parents=True, exist_ok=True)
            leaves = jax.device_get(jax.tree.leaves(trained.policies))
            arrays = {f"{i:03d}": leaf for i, leaf in enumerate(leaves)}
            write_atomically(folder / "policies.npz", lambda path, arrays=arrays: np.savez(path, **arrays))
            write_json(
                folder / "training.json",
                {
                    "config": self.identity(population.config), "scene": scene, "env_steps": trained.env_steps,
                    "broken": broken, "seconds": round(seconds, 1), "commit": self.source["git_commit"],
                    "device": self.source["device"],
                },
            )  # fmt: skip

    def training(self, folder, config):
        """The contents of a training's training.json; UserError: it had another configuration."""
        path = folder / "training.json"
        try:
            meta = json.loads(path.read_text())
            changed = differences(meta["config"], study.plain(self.identity(config)))
        except (OSError, ValueError, KeyError) as error:
            raise UserError(f"{path} can't be read ({error!r}): move {folder} away to train anew") from None
        if changed:
            raise UserError(
                f"{path} is of another configuration ({', '.join(changed)} differ): give another --runs, "
                "or move it away"
            )
        return meta

    def play(self, programs, folder, method, index, episodes):
        """Play all seeds of a training and keep the plays."""
        found = programs.play(programs.policies(folder), method, index, self.seed, episodes)
        self.save(folder / f"{method.plays}.npz", found)
        rates = " ".join(f"{rate:.4f}" for rate in found.arrived.mean(1))
        self.console.print(f"{folder.name}, {method.plays}: success {rates}")

    def save(self, path, summary):
        """Keep plays and where they were played."""
        arrays = {name: str(self.source[name]) for name in ("git_commit", "device")} | summary._asdict()
        write_atomically(path, lambda path: np.savez(path, episode_seed=self.seed, **arrays))

    def load(self, path, shape):
        """(plays of that shape, {commit, device} of theirs); UserError: others lie there."""
        arrays = dict(np.load(path))
        seed, commit, device = (arrays.pop(name).item() for name in ("episode_seed", "git_commit", "device"))
        if (seed, arrays["arrived"].shape) != (self.seed, shape):
            raise UserError(
                f"{path} holds plays of other --episodes, --seeds or --seed: give the same, or another --runs"
            )
        return EpisodeSummary(**arrays), {"commit": commit, "device": device}
