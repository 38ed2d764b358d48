"""What the three tables share: robots trained a scene at a time, all seeds at once, played, and put into rows.

Trainings and plays lie in a folder that all tables share: what one table has done, another does not do again, and a
table that was interrupted goes on where it was.
"""

import dataclasses
import json
import pathlib
import time

import jax
import numpy as np
from rich.console import Console

from experiments import study as scene_study
from experiments.paired import packed, pair
from experiments.tables import figure, report
from experiments.tables import methods as cells
from jaxnav.errors import UserError
from jaxnav.language.table import default_table
from jaxnav.training.config import PRESETS
from jaxnav.training.dataclass_json import differences, to_json
from jaxnav.training.population import member
from jaxnav.training.provenance import provenance
from jaxnav.training.rollout import EpisodeSummary
from jaxnav.world import SUITES, default_params

PAPER_STEPS, PAPER_EPISODES = 128_000, 500
TABLES = ("table1", "table2", "table3")
# Fields of a result's configuration that decide on what was played, beside its methods.
PLAYED = ("episodes", "episode_seed", "budgets", "embeddings", "worlds")
SUITE_OF = {scene: suite for suite in ("parity", "hard") for scene in SUITES[suite]}


@dataclasses.dataclass(frozen=True)
class Options:
    """Train robots, one for each scene, play them, and write the table.

    Writes TABLE.json, .md and .png and the trajectories of every method. What has been trained or played already is not
    done again.

    Args:
        seeds: robots of each method in each scene, trained at once.
        episodes: played with each of them; 500, as in the paper, with baselines after the first block.
        converged: environment steps of the second block; the first has the paper's 128,000.
        suite: parity, hard, both or none: what to train and play now; the table shows whatever is there.
        seed: of the episodes, the same for all robots; no training and no tuning has seen them.
        runs: folder of trainings and plays, which the tables share.
        out: folder of the results.
    """

    seeds: int = 5
    episodes: int = 2000
    converged: int = 256_000
    suite: str = "both"
    seed: int = 7
    runs: pathlib.Path = pathlib.Path("runs/tables")
    out: pathlib.Path = scene_study.RESULTS

    def __post_init__(self):
        limits = ("seeds", 1, 100), ("episodes", 1, 1_000_000), ("seed", 0, 2**32 - 1)
        scene_study.check_numbers(self, limits)
        scene_study.check_unseen(self.seed)
        if self.converged <= PAPER_STEPS or self.converged % PAPER_STEPS:
            raise UserError(f"--converged is {self.converged}: give a multiple of {PAPER_STEPS} above it")
        if self.suite not in ("both", "parity", "hard", "none"):
            raise UserError(f"--suite {self.suite!r} is unknown: choose both, parity, hard or none")

    @property
    def budgets(self):
        """Environment steps of each block."""
        return {"paper": PAPER_STEPS, "converged": self.converged}

    def blocks_of(self, method):
        """{block: (environment steps, episodes played)} of a method: ablations are compared at the paper's steps."""
        ablation = method.algo == "hsac" and method.training != cells.METHODS[cells.MAIN].training
        episodes = self.episodes if method.algo == "hsac" else min(self.episodes, PAPER_EPISODES)
        blocks = {"paper": (PAPER_STEPS, episodes), "converged": (self.converged, self.episodes)}
        return {"paper": blocks["paper"]} if ablation else blocks

    def asked(self, scene):
        """Whether a scene is to be trained and played now."""
        return self.suite in ("both", SUITE_OF[scene])


class Study:
    """The trainings and plays of one table, done as far as they are missing."""

    def __init__(self, options, methods):
        self.options = options
        self.methods = {name: cells.METHODS[name] for name in methods}
        self.console = Console(stderr=True)
        self._played = set()  # (method, group of scenes) in this call
        self._where = provenance()  # of the code that runs, whatever is committed meanwhile
        scene_study.make_folder(options.runs, "--runs")
        scene_study.make_folder(options.out)

    def run(self, name, pairs):
        """Train and play what is missing and write the table's files; returns the result.

        pairs: (one, other) methods, or one and a scripted robot, whose success is compared over the same episodes.
        """
        path = self.options.out / f"{name}.json"
        result = {"table": name, "command": f"python experiments/{name}.py", "rows": [], "pairs": []}
        result |= {"config": self._config()}
        scene_study.stored(path, {"config": result["config"]}, "rows", [])  # refuses those of another configuration
        self._kept, where = self._rows_kept(name), self._where
        result |= {"commit": where["git_commit"], "device": where["device"], "versions": where["versions"]}
        rows = {}
        for row in self._all_rows():
            rows[row["scene"], row["method"], row["budget"]] = row
            # An interruption leaves what is known: rows that this call has not come to yet, too.
            result["rows"] = list((self._kept | rows).values())
            result["train_seconds"] = self._train_seconds(result["rows"])
            scene_study.write(path, result)
        if not rows:
            raise UserError("nothing was played yet: give --suite both, parity or hard")
        result["rows"] = list(rows.values())
        result["train_seconds"] = self._train_seconds(result["rows"])
        wanted = [
            (rows.get((scene, one, budget)), rows.get((scene, other, "none" if other in cells.SCRIPTED else budget)))
            for one, other in pairs
            for scene in SUITE_OF
            for budget in self.options.budgets
        ]
        result["pairs"] = [found for one, other in wanted if one and other and (found := pair(one, other))]
        scene_study.write(path, result)
        path.with_suffix(".md").write_text(report.markdown(result))
        figure.draw(result, path.with_suffix(".png"))
        return result

    def _train_seconds(self, rows):
        """Of all trainings of a table: both budgets are one, and so are methods that differ in how they are played."""
        longest = {}
        for row in rows:
            if row["budget"] != "none":
                training = self.methods[row["method"]].training, row["scene"]
                longest[training] = max(longest.get(training, 0.0), row["train_seconds"])
        return round(sum(longest.values()), 1)

    def _all_rows(self):
        for group in cells.GROUPS:
            for method in self.methods:
                yield from self._cells(method, group)
            yield from (row for robot in cells.SCRIPTED for scene in group if (row := self._scripted(robot, scene)))

    def _rows_kept(self, name):
        """Rows of all tables in the folder of results that were played by the same methods in the same way."""
        config, kept = self._config(), {}
        for path in [
            *(self.options.out / f"{table}.json" for table in TABLES if table != name),
            self.options.out / f"{name}.json",
        ]:
            if not path.exists():
                continue
            try:
                stored = json.loads(path.read_text())
                same = all(stored["config"][field] == _plain(config)[field] for field in PLAYED)
                rows = [row for row in stored["rows"] if "arrived" in row] if same else []
                found = [(row, row["method"], row["scene"], row["budget"]) for row in rows]
            except (OSError, ValueError, KeyError, TypeError) as error:
                raise UserError(f"{path} is no result of a table ({error!r}): move it away") from None
            for row, method, scene, budget in found:
                theirs, ours = (c["methods"].get(method) for c in (stored["config"], config))
                if method in cells.SCRIPTED or (method in self.methods and not differences(theirs, _plain(ours))):
                    kept[scene, method, budget] = row
        return kept

    def _config(self):
        options = self.options
        return {
            "episodes": options.episodes, "episode_seed": options.seed, "budgets": options.budgets,
            "embeddings": default_table().fingerprint,
            "worlds": [to_json(PRESETS["quick"].world.of_scenes(group)) for group in cells.GROUPS],
            "methods": {
                name: self._identity(cells.configuration(method, cells.GROUPS[0], options.converged))
                for name, method in self.methods.items()
            },
        }  # fmt: skip

    def _identity(self, config):
        """What decides on what is trained: all of a configuration but names and folders."""
        whole = to_json(config)
        for name in ("preset", "scene", "seed", "out", "resume"):
            whole.pop(name)
        return whole | {"seeds": list(range(self.options.seeds)), "embeddings": default_table().fingerprint}

    def _save(self, path, summary):
        """Keep plays and where they were played, whole or not at all."""
        new = path.with_name(f"new-{path.name}")
        where = {name: str(self._where[name]) for name in ("git_commit", "device")}
        np.savez(new, episode_seed=self.options.seed, **where, **summary._asdict())
        new.replace(path)

    def _load(self, path, shape):
        """(Plays of that shape, {commit, device} of theirs); UserError: others lie there."""
        arrays = dict(np.load(path))
        seed, commit, device = (arrays.pop(name).item() for name in ("episode_seed", "git_commit", "device"))
        if (seed, arrays["arrived"].shape) != (self.options.seed, shape):
            raise UserError(
                f"{path} holds plays of other --episodes, --seeds or --seed: give the same, or another --runs"
            )
        return EpisodeSummary(**arrays), {"commit": commit, "device": device}

    def _cells(self, name, group):
        """The rows of a method in each scene and budget of a group."""
        options, method = self.options, self.methods[name]
        config = cells.configuration(method, group, options.converged)
        programs = None
        for index, scene in enumerate(group):
            for budget, (_, episodes) in options.blocks_of(method).items():
                folder = options.runs / f"{method.training}-{scene}-{budget}"
                played = folder / f"{method.plays}.npz"
                if not played.exists():
                    if (scene, name, budget) in self._kept:
                        yield self._kept[scene, name, budget]
                        continue
                    if not options.asked(scene):
                        continue
                    programs = programs or cells.Programs(config, options.seeds, method.told)
                    if not (folder / "training.json").exists():
                        self._train(programs, method, scene, index)
                    _training(folder, self._identity(config))
                    self._play(programs, folder, method, index, episodes)
                    self._played.add((name, group))
                meta = _training(folder, self._identity(config))
                summary, _ = self._load(played, (options.seeds, episodes))
                good = [seed for seed in range(options.seeds) if meta["broken"][seed] is None]
                summary = EpisodeSummary(*(leaf[good] for leaf in summary))
                yield {
                    "suite": SUITE_OF[scene], "scene": scene, "method": name, "budget": budget,
                    "env_steps": meta["env_steps"], "seeds": good, "encoder": config.agent.encoder,
                    "excluded": {str(i): step for i, step in enumerate(meta["broken"]) if step is not None},
                    "episodes": episodes, **cells.measures(summary), "train_seconds": meta["seconds"],
                    "commit": meta["commit"], "device": meta["device"], "arrived": packed(summary.arrived),
                }  # fmt: skip

    def _train(self, programs, method, scene, index):
        """Train all seeds of a method in a scene, and keep their policies at the end of each budget."""
        options, population = self.options, programs.population
        hyper = population.config.hyper
        start, broken, seconds = time.monotonic(), (), 0.0
        loop = population.start(range(options.seeds), hyper, index)
        show = cells.reporter(self.console, f"{method.training} {scene}", population.config.train.episodes)
        for budget, (env_steps, _) in options.blocks_of(method).items():
            steps = env_steps // population.config.train.episodes
            loop, trained = population.train(loop, hyper, steps, show, broken)
            broken, seconds = trained.broken, time.monotonic() - start
            folder = options.runs / f"{method.training}-{scene}-{budget}"
            if (folder / "training.json").exists():
                continue  # whole, and perhaps played: an interruption came later
            folder.mkdir(parents=True, exist_ok=True)
            leaves = jax.device_get(jax.tree.leaves(trained.policies))
            np.savez(folder / "new-policies.npz", **{f"{i:03d}": leaf for i, leaf in enumerate(leaves)})
            (folder / "new-policies.npz").replace(folder / "policies.npz")
            scene_study.write(
                folder / "training.json",
                {
                    "config": self._identity(population.config), "scene": scene, "env_steps": trained.env_steps,
                    "broken": broken, "seconds": round(seconds, 1), "commit": self._where["git_commit"],
                    "device": self._where["device"],
                },
            )  # fmt: skip

    def _play(self, programs, folder, method, index, episodes):
        """Play all seeds of a training."""
        options = self.options
        whole = programs.play(programs.policies(folder), method, index, options.seed, episodes)
        self._save(folder / f"{method.plays}.npz", whole)
        self.console.print(
            f"{folder.name}, {method.plays}: success {' '.join(f'{rate:.4f}' for rate in whole.arrived.mean(1))}"
        )

    def _scripted(self, robot, scene):
        """The row of a scripted robot in a scene; None where it was not to be played."""
        options, path = self.options, self.options.runs / f"{robot}-{scene}.npz"
        if not path.exists():
            if (scene, robot, "none") in self._kept:
                return self._kept[scene, robot, "none"]
            if not options.asked(scene):
                return None
            policy, policy_params = cells.SCRIPTED[robot]
            world = PRESETS["quick"].world.of_scenes((scene,))
            player = cells.Player(world.world(), default_params((scene,)), policy)
            summary = player(policy_params, 0, options.seed, options.seeds * options.episodes)
            self._save(path, summary)
            self.console.print(f"{robot} {scene}: success {summary.arrived.mean():.4f}")
        summary, where = self._load(path, (options.seeds * options.episodes,))
        summary = EpisodeSummary(*(leaf[None] for leaf in summary))
        return {
            "suite": SUITE_OF[scene], "scene": scene, "method": robot, "budget": "none", "env_steps": 0, "seeds": [],
            "excluded": {}, "episodes": summary.arrived.shape[1], **cells.measures(summary), "train_seconds": 0,
            **where, "arrived": packed(summary.arrived),
        }  # fmt: skip

    def trajectories(self):
        """Draw what each method drives after its last block, with its first good seed, and what scripted robots drive:
        a figure for each and each group of scenes."""
        folder = self.options.out / "trajectories"
        scene_study.make_folder(folder)
        for group in cells.GROUPS:
            world, params = PRESETS["quick"].world.of_scenes(group).world(), default_params(group)
            for name, method in self.methods.items():
                drawn = _figure(folder, name, group).exists() and (name, group) not in self._played
                if not drawn and (episodes := self._recorded(method, group)):
                    _draw(folder, name, world, params, episodes)
            for name, (policy, policy_params) in cells.SCRIPTED.items():
                asked = [i for i, scene in enumerate(group) if self.options.asked(scene)]
                if asked and not _figure(folder, name, group).exists():
                    player = cells.Player(world, params, policy)
                    episodes = [e for i in asked for e in player.record(policy_params, i, self.options.seed)]
                    _draw(folder, name, world, params, episodes)

    def _recorded(self, method, group):
        """Episodes of a method in those scenes of a group for which its trainings are at hand."""
        config, episodes, programs = cells.configuration(method, group, self.options.converged), [], None
        for index, scene in enumerate(group):
            folder = self.options.runs / f"{method.training}-{scene}-{list(self.options.blocks_of(method))[-1]}"
            if not (folder / "training.json").exists():
                continue
            broken = _training(folder, self._identity(config))["broken"]
            if None in broken:
                programs = programs or cells.Programs(config, self.options.seeds, method.told)
                actor = member(programs.policies(folder), broken.index(None))
                policy_params = actor, method.voice, programs.spoken
                episodes += programs.player.record(policy_params, index, self.options.seed)
        return episodes


def _figure(folder, name, group):
    return folder / f"{name.lower().replace(',', '').replace(' ', '-')}-{group[0]}.png"


def _draw(folder, name, world, params, episodes):
    from jaxnav.render import figures

    path = _figure(folder, name, [scene.name for scene in world.scenes])
    figures.trajectories(world, episodes, path, params, cells.DRAWN)


def _plain(value):
    """What JSON makes of a value."""
    return json.loads(json.dumps(value))


def _training(folder, config):
    """What is known of a training; UserError: it had another configuration."""
    path = folder / "training.json"
    try:
        meta = json.loads(path.read_text())
        changed = differences(meta["config"], _plain(config))
    except (OSError, ValueError, KeyError) as error:
        raise UserError(f"{path} can't be read ({error!r}): move {folder} away to train anew") from None
    if changed:
        raise UserError(
            f"{path} is of another configuration ({', '.join(changed)} differ): give another --runs, or move it away"
        )
    return meta


def main(name, methods, pairs, arguments=None, options_class=Options):
    """Entry point of a table's program; exits with 2 after an error that the user can mend."""

    def study(options):
        begun = Study(options, methods)
        result = begun.run(name, pairs)
        begun.trajectories()
        return result

    scene_study.main(options_class, study, report.markdown, name, arguments)
