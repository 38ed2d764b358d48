"""The common part of the three tables: options, and rows of robots, trained and played where they are missing."""

import dataclasses
import json
import pathlib

from experiments import study
from experiments.paired import pair
from experiments.tables import figure, methods, report, trajectories
from experiments.tables.runs import Runs
from jaxnav import SUITES, preset
from jaxnav.errors import UserError
from jaxnav.files import write_atomically, write_json
from jaxnav.language.table import default_table
from jaxnav.statistics import packed
from jaxnav.training import EpisodeSummary, differences, to_json
from jaxnav.world import default_params

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
    out: pathlib.Path = study.RESULTS

    def __post_init__(self):
        study.check_numbers(self, ("seeds", 1, 100), ("episodes", 1, 1_000_000))
        study.check_seed(self.seed)
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
        ablation = method.algo == "hsac" and method.training != methods.METHODS[methods.MAIN].training
        episodes = self.episodes if method.algo == "hsac" else min(self.episodes, PAPER_EPISODES)
        blocks = {"paper": (PAPER_STEPS, episodes), "converged": (self.converged, self.episodes)}
        return {"paper": blocks["paper"]} if ablation else blocks

    def asked(self, scene):
        """Whether a scene is to be trained and played now."""
        return self.suite in ("both", SUITE_OF[scene])


class Table:
    """The rows of one table: a scene, method and budget each, trained and played as far as they are missing."""

    def __init__(self, options, names):
        self.options = options
        self.methods = {name: methods.METHODS[name] for name in names}
        self.runs = Runs(options.runs, options.seeds, options.seed)
        self.played = set()  # (method, group of scenes) in this call
        study.make_folder(options.out)

    def run(self, name, pairs):
        """Train and play what is missing and write the table's files; returns the result.

        pairs: (one, other) methods, or one and a scripted robot, whose success is compared over the same episodes.
        """
        path, source = self.options.out / f"{name}.json", self.runs.source
        config = self._config()
        study.stored(path, {"config": config}, "rows", [])  # refuses those of another configuration
        result = {
            "table": name, "command": study.command(f"tables.{name}"), "rows": [], "pairs": [], "config": config,
            "commit": source["git_commit"], "device": source["device"], "versions": source["versions"],
        }  # fmt: skip
        self._kept, rows = self._rows_kept(name), {}
        for row in self._all_rows():
            rows[row["scene"], row["method"], row["budget"]] = row
            # An interruption leaves what is known: rows that this call has not come to yet, too.
            result["rows"] = list((self._kept | rows).values())
            result["train_seconds"] = self.train_seconds(result["rows"])
            write_json(path, result)
        if not rows:
            raise UserError("nothing was played yet: give --suite both, parity or hard")
        result["rows"] = list(rows.values())
        result["train_seconds"] = self.train_seconds(result["rows"])
        wanted = [
            (rows.get((scene, one, budget)), rows.get((scene, other, "none" if other in methods.SCRIPTED else budget)))
            for one, other in pairs
            for scene in SUITE_OF
            for budget in self.options.budgets
        ]
        result["pairs"] = [found for one, other in wanted if one and other and (found := pair(one, other))]
        write_json(path, result)
        write_atomically(path.with_suffix(".md"), report.markdown(result))
        figure.draw(result, path.with_suffix(".png"))
        return result

    def train_seconds(self, rows):
        """Seconds of all trainings of a table: budgets, and methods that differ only in play, share a training."""
        longest = {}
        for row in rows:
            if row["budget"] != "none":
                training = self.methods[row["method"]].training, row["scene"]
                longest[training] = max(longest.get(training, 0.0), row["train_seconds"])
        return round(sum(longest.values()), 1)

    def _all_rows(self):
        for group in methods.GROUPS:
            for method in self.methods:
                yield from self._cells(method, group)
            yield from (row for robot in methods.SCRIPTED for scene in group if (row := self._scripted(robot, scene)))

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
                same = all(stored["config"][field] == study.plain(config)[field] for field in PLAYED)
                rows = [row for row in stored["rows"] if "arrived" in row] if same else []
                found = [(row, row["method"], row["scene"], row["budget"]) for row in rows]
            except (OSError, ValueError, KeyError, TypeError) as error:
                raise UserError(f"{path} is no result of a table ({error!r}): move it away") from None
            for row, method, scene, budget in found:
                theirs, ours = (c["methods"].get(method) for c in (stored["config"], config))
                if method in methods.SCRIPTED or (
                    method in self.methods and not differences(theirs, study.plain(ours))
                ):
                    kept[scene, method, budget] = row
        return kept

    def _config(self):
        options = self.options
        return {
            "episodes": options.episodes, "episode_seed": options.seed, "budgets": options.budgets,
            "embeddings": default_table().fingerprint,
            "worlds": [to_json(preset("quick").world.of_scenes(group)) for group in methods.GROUPS],
            "methods": {
                name: self.runs.identity(methods.configuration(method, methods.GROUPS[0], options.converged))
                for name, method in self.methods.items()
            },
        }  # fmt: skip

    def _cells(self, name, group):
        """The rows of a method in each scene and budget of a group."""
        options, runs, method = self.options, self.runs, self.methods[name]
        blocks = options.blocks_of(method)
        config = methods.configuration(method, group, options.converged)
        programs = None
        for index, scene in enumerate(group):
            for budget, (_, episodes) in blocks.items():
                folder = runs.of(method, scene, budget)
                played = folder / f"{method.plays}.npz"
                if not played.exists():
                    if (scene, name, budget) in self._kept:
                        yield self._kept[scene, name, budget]
                        continue
                    if not options.asked(scene):
                        continue
                    programs = programs or methods.Programs(config, options.seeds, method.told)
                    if not (folder / "training.json").exists():
                        budgets = {block: env_steps for block, (env_steps, _) in blocks.items()}
                        runs.train(programs, method, scene, index, budgets)
                    runs.training(folder, config)
                    runs.play(programs, folder, method, index, episodes)
                    self.played.add((name, group))
                meta = runs.training(folder, config)
                summary, _ = runs.load(played, (options.seeds, episodes))
                good = [seed for seed in range(options.seeds) if meta["broken"][seed] is None]
                summary = EpisodeSummary(*(leaf[good] for leaf in summary))
                yield {
                    "suite": SUITE_OF[scene], "scene": scene, "method": name, "budget": budget,
                    "env_steps": meta["env_steps"], "seeds": good, "encoder": config.agent.encoder,
                    "excluded": {str(i): step for i, step in enumerate(meta["broken"]) if step is not None},
                    "episodes": episodes, **methods.measures(summary), "train_seconds": meta["seconds"],
                    "commit": meta["commit"], "device": meta["device"], "arrived": packed(summary.arrived),
                }  # fmt: skip

    def _scripted(self, robot, scene):
        """The row of a scripted robot in a scene; None where it was not to be played."""
        options, path = self.options, self.options.runs / f"{robot}-{scene}.npz"
        if not path.exists():
            if (scene, robot, "none") in self._kept:
                return self._kept[scene, robot, "none"]
            if not options.asked(scene):
                return None
            world = preset("quick").world.of_scenes((scene,))
            playing = methods.Playing(world.world(), default_params((scene,)))
            summary = playing(methods.SCRIPTED[robot], 0, options.seed, options.seeds * options.episodes)
            self.runs.save(path, summary)
            self.runs.console.print(f"{robot} {scene}: success {summary.arrived.mean():.4f}")
        summary, source = self.runs.load(path, (options.seeds * options.episodes,))
        summary = EpisodeSummary(*(leaf[None] for leaf in summary))
        return {
            "suite": SUITE_OF[scene], "scene": scene, "method": robot, "budget": "none", "env_steps": 0, "seeds": [],
            "excluded": {}, "episodes": summary.arrived.shape[1], **methods.measures(summary), "train_seconds": 0,
            **source, "arrived": packed(summary.arrived),
        }  # fmt: skip


def main(name, names, pairs, arguments=None, options_class=Options):
    """Entry point of a table's program. names: of its methods; pairs: as for `Table.run`."""

    def run(options):
        table = Table(options, names)
        result = table.run(name, pairs)
        trajectories.draw(table)
        return result

    study.main(options_class, run, report.markdown, f"tables.{name}", arguments)
