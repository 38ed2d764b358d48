"""Does an exported policy do what the trained one does, and is its safety layer any good?

python -m experiments.exporting.exported --help
"""

import dataclasses
import math
import pathlib
import shutil
import tempfile

import numpy as np

from experiments import study
from experiments.exporting import navigated
from experiments.exporting.single_states import CONFIGURATIONS, compare
from jaxnav import preset
from jaxnav.errors import UserError
from jaxnav.export.bundle import write_bundle
from jaxnav.export.contract import origin_of
from jaxnav.export.modules import modules
from jaxnav.export.reference import Reference
from jaxnav.language.table import default_table
from jaxnav.statistics import wilson_interval
from jaxnav.training import resolve

PROGRAM = "exporting.exported"
SUITES = {"parity": "all", "hard": "hard"}  # what --scene calls them
NUMBERS = ("states", "episodes", "drives", "worlds")


@dataclasses.dataclass(frozen=True)
class Options:
    """Export policies and compare them with those in JAX: in single states, and by how the same episodes end.

    Every configuration with random weights; then two policies that are trained first, preset quick on the parity and on
    the hard suite, driven by the exported network, by the bundle's Navigator with and without its safety layer, and by
    an adversary at full speed toward the nearest obstacle. Writes exported.json and .md; what is done already is
    not done again.

    Args:
        states: drawn from episodes, of every configuration.
        episodes: of each suite, rounded up to a multiple of its scenes, for the exported network.
        drives: the same for Navigator, with and without its safety layer.
        worlds: of each suite for the adversary.
        seed: of the episodes; training has not seen them.
        suites: on which policies are trained and driven: parity, hard.
        pythons: more Pythons with torch that replay every bundle's recorded outputs, as the robot's.
        runs: folder of the trainings.
        out: folder of the results.
    """

    states: int = 10_000
    episodes: int = 200
    drives: int = 2000
    worlds: int = 1000
    seed: int = 7
    suites: tuple[str, ...] = tuple(SUITES)
    pythons: tuple[str, ...] = ()
    runs: pathlib.Path = pathlib.Path("runs/exported")
    out: pathlib.Path = study.RESULTS

    def __post_init__(self):
        study.check_names(self.suites, "--suites", SUITES)
        for python in self.pythons:
            if shutil.which(python) is None:
                raise UserError(
                    f"--pythons names {python}, which is no program: give Pythons that have torch and numpy"
                )
        study.check_numbers(self, *((name, 1, 1_000_000) for name in NUMBERS))
        study.check_seed(self.seed)


def configuration(options, suite):
    """The `RunConfig` of preset quick on a suite."""
    base, folder = preset("quick"), options.runs / suite
    return resolve(
        dataclasses.replace(base.of_scenes(SUITES[suite]), out=str(folder), resume=(folder / "config.json").exists())
    )


def drive(suite, options, console):
    """The ends of the same episodes of a suite, driven by each form of the policy and by an adversary."""
    run, actor = study.trained(configuration(options, suite), suite, console)
    scenes = len(run.world.scenes)
    each, many, worlds = (math.ceil(n / scenes) for n in (options.episodes, options.drives, options.worlds))
    with tempfile.TemporaryDirectory() as folder:
        bundle = pathlib.Path(folder) / "bundle"
        write_bundle(run, actor, bundle, origin_of(run, "last", {}, None))
        with modules(bundle, "policy", "navigator", "scans") as (policy, navigator, scans):
            result = {"policy": _by_policy(run, actor, policy.Policy(str(bundle)), options.seed, each)}
            console.print(f"{suite}, exported policy: {result['policy']}")
            summaries = run.evaluator.summaries(run.policy_of(actor), many, options.seed)
            result["jax"] = {"success": float(summaries.arrived.mean()), "episodes": many * scenes}
            arrived = {}
            for name, safety in (("navigator", True), ("unsafe", False)):
                ends, share = navigated.by_navigators(
                    navigated.Worlds(run, options.seed, many),
                    lambda safety=safety: navigator.Navigator(str(bundle), safety=safety), navigated.laser(scans, run),
                )  # fmt: skip
                arrived[name] = ends.arrived
                result[name] = {
                    "success": float(ends.arrived.mean()), "walls": int(ends.hit_wall.sum()), "interventions": share,
                    "steps": int(ends.steps.sum()),
                }  # fmt: skip
                console.print(f"{suite}, {name}: {result[name]}")
            result["cost"] = _paired(arrived["unsafe"], arrived["navigator"])
            result["from_jax"] = _paired(summaries.arrived.ravel(), arrived["unsafe"])
            ends, _ = navigated.by_navigators(
                navigated.Worlds(run, options.seed, worlds), lambda: navigator.Navigator(str(bundle)),
                navigated.laser(scans, run), navigated.adversary(policy, run),
            )  # fmt: skip
    result["adversary"] = {
        "worlds": len(ends.steps), "steps": int(ends.steps.sum()), "walls": int(ends.hit_wall.sum()),
        "people": int(ends.hit_pedestrian.sum()),
    }  # fmt: skip
    console.print(f"{suite}, adversary: {result['adversary']}")
    return result


def _by_policy(run, actor, policy, seed, episodes):
    reference = Reference(run, actor)
    worlds = navigated.Worlds(run, seed, episodes)
    ends = navigated.by_policy(worlds, policy, lambda state: reference.both(state, np.ones(worlds.count, bool))[0])
    played = run.evaluator.summaries(run.policy_of(actor), episodes, seed)
    alike = (ends.arrived == played.arrived.ravel()) & (ends.collided == played.collided.ravel())
    return {
        "episodes": worlds.count,
        "alike": int(alike.sum()),
        "same_steps": int((ends.steps == played.steps.ravel()).sum()),
    }


def _paired(before, after):
    """Difference of two success rates over the same episodes, in points, and its 95 % interval."""
    change = 100.0 * (after.astype(float) - before.astype(float))
    half = 1.96 * change.std() / math.sqrt(len(change))
    return [float(change.mean()), float(change.mean() - half), float(change.mean() + half)]


def run(options: Options) -> dict:
    """Do what is missing, and write both files."""
    console = study.console()
    identity = {name: getattr(options, name) for name in (*NUMBERS, "seed")}
    identity |= {"embeddings": default_table().fingerprint}
    work = {name: (compare, name) for name in CONFIGURATIONS} | {f"drive {suite}": (drive, suite) for suite in SUITES}
    begun = study.Study(PROGRAM, options.out, identity, work)
    for row in begun.missing((*CONFIGURATIONS, *(f"drive {suite}" for suite in options.suites))):
        function, name = work[row]
        begun.add(row, function(name, options, console))
    return begun.finish(table)


def table(result):
    """The result as Markdown."""
    lines = [
        f"Exported policies beside those in JAX, seed {result['seed']}. {study.sources(result['rows'].values())}",
        "",
        f"**In single states**: {result['states']:,} of each configuration, drawn from episodes; random weights, three "
        "people. Largest differences in m/s and rad/s; requests that differ though the likeliest two are no tie; the "
        "largest error of the 128 recorded outputs in each Python.",
        "",
    ]
    rows = {name: row for name, row in result["rows"].items() if not name.startswith("drive ")}
    wheres = [replay["where"] for replay in next(iter(rows.values()))["replays"]]
    lines += [
        f"| configuration | v | w | requests | {' | '.join(wheres)} |",
        f"|{'---|' * (4 + len(wheres))}",
    ]
    for name, row in rows.items():
        replays = " | ".join(f"{replay['error']:.1e}" for replay in row["replays"])
        lines.append(f"| {name} | {row['v']:.1e} | {row['w']:.1e} | {row['requests']} | {replays} |")
    driven = [suite for suite in SUITES if f"drive {suite}" in result["rows"]]
    lines += [
        "",
        "**The same episodes**, preset quick trained on each suite. The exported network is given what the JAX policy "
        "observes; a Navigator works out scans, pose history, dialogues and words for itself.",
        "",
        "| | " + " | ".join(driven) + " |",
        f"|{'---|' * (1 + len(driven))}",
    ]
    drives = [result["rows"][f"drive {suite}"] for suite in driven]

    def line(label, text):
        lines.append(f"| {label} | {' | '.join(text(d) for d in drives)} |")

    line("exported network: episodes that end alike", lambda d: f"{d['policy']['alike']} of {d['policy']['episodes']}")
    line("of these with the same number of steps", lambda d: f"{d['policy']['same_steps']}")
    line("success in JAX", lambda d: _rate(d["jax"]["success"], d["jax"]["episodes"]))
    line("success of Navigator, no safety layer", lambda d: _rate(d["unsafe"]["success"], d["jax"]["episodes"]))
    line("success of Navigator", lambda d: _rate(d["navigator"]["success"], d["jax"]["episodes"]))
    line("Navigator without layer minus JAX, points", lambda d: _points(d["from_jax"]))
    line("safety layer, points of success", lambda d: _points(d["cost"]))
    line("commands that the layer slowed", lambda d: f"{100 * d['navigator']['interventions']:.2f} %")
    line("contacts with walls, without and with it", lambda d: f"{d['unsafe']['walls']}, {d['navigator']['walls']}")
    line(
        "adversary with layer: contacts with walls",
        lambda d: f"{d['adversary']['walls']} in {d['adversary']['worlds']} worlds, {d['adversary']['steps']:,} steps",
    )
    return "\n".join(lines) + "\n"


def _rate(share, episodes):
    low, high = wilson_interval(round(share * episodes), episodes)
    return f"{share:.4f} ({low:.4f}-{high:.4f})"


def _points(change):
    return f"{change[0]:+.2f} ({change[1]:+.2f} to {change[2]:+.2f})"


def main(arguments=None):
    """Entry point."""
    study.main(Options, run, table, PROGRAM, arguments)


if __name__ == "__main__":
    main()
