"""Does an exported policy do what the trained one does, and is its safety layer any good?

python -m experiments.exporting.exported --help
"""

import dataclasses
import functools
import math
import pathlib
import re
import shutil
import subprocess
import sys
import tempfile
import time

import jax
import jax.numpy as jnp
import numpy as np
from rich.console import Console

from experiments import study as scene_study
from experiments.exporting import navigated
from jaxnav.agents.encoders import ENCODERS, PARTS
from jaxnav.agents.hsac import HEADS, LANGUAGES
from jaxnav.errors import UserError
from jaxnav.export.bundle import write_bundle
from jaxnav.export.contract import origin_of
from jaxnav.export.modules import modules
from jaxnav.export.reference import Reference
from jaxnav.language.table import default_table
from jaxnav.training.config import preset, resolve
from jaxnav.training.evaluation import wilson_interval
from jaxnav.training.provenance import provenance
from jaxnav.training.run import Run

PROGRAM = "exported"
SUITES = {"parity": "all", "hard": "hard"}  # what --scene calls them
# Of hybrid SAC every encoder, head and language; of the others one each, since only what makes a twist differs.
CONFIGURATIONS = {
    f"{encoder}, {heads}, {language}": ("hsac", encoder, {"heads": heads, "language": language})
    for encoder in ENCODERS
    for heads in HEADS
    for language in LANGUAGES
} | {"lidar, td3": ("td3", "lidar", {}), "lidar-approach, ppo": ("ppo", "lidar-approach", {})}
_STEPS = 40  # of the episodes from which states of untrained robots are drawn
_STATES_SEED = 3
_BLOCK = 500  # states at once: what a convolution makes of them must fit into memory


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
    out: pathlib.Path = scene_study.RESULTS

    def __post_init__(self):
        scene_study.check_names(self.suites, "--suites", SUITES)
        for python in self.pythons:
            if shutil.which(python) is None:
                raise UserError(
                    f"--pythons names {python}, which is no program: give Pythons that have torch and numpy"
                )
        most = 1_000_000
        limits = ("states", 1, most), ("episodes", 1, most), ("drives", 1, most), ("worlds", 1, most)
        scene_study.check_numbers(self, (*limits, ("seed", 0, 2**32 - 1)))
        scene_study.check_unseen(self.seed)


def untrained(name):
    """(run, actor) of a configuration: random weights, none of them as a fresh start leaves it."""
    algo, encoder, sizes = CONFIGURATIONS[name]
    base = preset("quick", algo)
    agent = dataclasses.replace(base.agent, encoder=encoder, **sizes)
    params = base.world.params.replace(max_steps=float(_STEPS))
    world = dataclasses.replace(base.world, observation=PARTS[encoder], pedestrians=3, params=params)
    run = Run(resolve(dataclasses.replace(base, agent=agent, world=world, out=f"runs/{PROGRAM}/none")))
    return run, random_actor(run, _STATES_SEED)


def random_actor(run, seed):
    """Actor parameters of a run, of which no bias is 0 and no scale 1."""
    rng = np.random.default_rng(seed)
    hyper = jax.tree.map(jnp.float32, run.config.hyper)
    state = jax.eval_shape(run.world.reset, jax.random.key(0), run.params)
    observation = jax.eval_shape(run.world.observe, state, run.params)
    learner = jax.eval_shape(run.agent.init, jax.random.key(0), observation, hyper)

    def draw(path, leaf):
        values, name = rng.normal(size=leaf.shape), jax.tree_util.keystr(path)
        if len(leaf.shape) > 1:  # large enough that what goes in decides what comes out
            return np.float32(2.0 * values / math.sqrt(math.prod(leaf.shape[:-1])))
        return np.float32(0.2 * values + ("scale" in name))

    return jax.tree_util.tree_map_with_path(draw, run.agent.policy(learner))


@functools.cache
def drawn(count):
    """`[count]` states, drawn from episodes of the first configuration: a state has no memory of who drove there."""
    episodes = Reference(*untrained(next(iter(CONFIGURATIONS)))).play(_STATES_SEED, math.ceil(count / 30))
    states = jax.tree.map(lambda *leaves: np.concatenate(leaves), *(episode.states for episode in episodes))
    rows = np.random.default_rng(_STATES_SEED).choice(len(states.t), count, replace=False)
    return jax.tree.map(lambda leaf: leaf[rows], states)


def compare(name, options, console):
    """What `Policy` computes beside the JAX policy, in states drawn from episodes, and replayed in every Python."""
    run, actor = untrained(name)
    states, voice = drawn(options.states), np.random.default_rng(_STATES_SEED).random(options.states) < 0.75
    with tempfile.TemporaryDirectory() as folder:
        bundle = pathlib.Path(folder) / "bundle"
        write_bundle(run, actor, bundle, origin_of(run, "last", {}, None))
        reference, found = Reference(run, actor), []
        with modules(bundle, "policy") as (policy,):
            exported = policy.Policy(str(bundle))
            for block in (slice(i, i + _BLOCK) for i in range(0, options.states, _BLOCK)):
                inputs, outputs = reference.both(
                    jax.tree.map(lambda leaf, block=block: leaf[block], states), voice[block]
                )
                found.append(difference(policy, exported, inputs, outputs))
        replays = [_replay(bundle, python) for python in (sys.executable, *options.pythons)]
    found = {"states": options.states} | {
        key: function(part[key] for part in found)
        for key, function in (("v", max), ("w", max), ("codes", sum), ("ties", sum))
    }
    console.print(f"{name}: {found}")
    return found | {"replays": replays}


def difference(module, policy, inputs, outputs):
    """Largest differences of an exported `Policy` from what the JAX policy computed, and how many requests differ where
    the likeliest two are not tied."""
    found = dict(zip(module.Decision._fields, map(np.asarray, policy.actor(*policy.tensors(inputs))), strict=True))
    best = np.sort(outputs["log_p"], axis=-1)
    tied = best[:, -1] - best[:, -2] < 1e-5 if best.shape[1] > 1 else np.zeros(len(best), bool)
    differs = found["request"] != outputs["request"]
    return {
        **{name: float(np.abs(found[name] - outputs[name])[~differs].max()) for name in ("v", "w")},
        "requests": int((differs & ~tied).sum()), "ties": int((differs & tied).sum()),
    }  # fmt: skip


def _replay(bundle, python):
    done = subprocess.run([python, "-B", bundle / "policy.py", "--selftest"], capture_output=True, text=True)
    if done.returncode:
        raise UserError(f"{python} fails: {(done.stderr.strip() or done.stdout).splitlines()[-1]}")
    error, where = re.search(r"error (\S+),.*\((.*)\)", done.stdout).groups()
    return {"error": float(error), "where": where}


def trained(suite, options, console):
    """(run, actor) of preset quick on a suite, trained now if it isn't yet."""
    base, folder = preset("quick"), options.runs / suite
    config = dataclasses.replace(base, scene=SUITES[suite], out=str(folder), resume=(folder / "config.json").exists())
    run = Run(resolve(config))
    run.prepare_folder()

    def report(line):
        if "evaluation" in line:
            console.print(f"{suite}: {line['env_steps'] / 1000:.0f}k steps")

    return run, run.actor(run.train(report, time.monotonic()), "last")


def drive(suite, options, console):
    """How the same episodes of a suite end, whoever drives."""
    run, actor = trained(suite, options, console)
    scenes = len(run.world.scenes)
    each, many, worlds = (math.ceil(n / scenes) for n in (options.episodes, options.drives, options.worlds))
    with tempfile.TemporaryDirectory() as folder:
        bundle = pathlib.Path(folder) / "bundle"
        write_bundle(run, actor, bundle, origin_of(run, "last", {}, None))
        with modules(bundle, "policy", "navigator", "scans") as (policy, navigator, scans):
            result = {"policy": _by_policy(run, actor, policy.Policy(str(bundle)), options.seed, each)}
            console.print(f"{suite}, exported policy: {result['policy']}")
            summaries = run.evaluator.summaries(actor, many, options.seed)
            result["jax"] = {"success": float(summaries.arrived.mean()), "episodes": many * scenes}
            arrived = {}
            for name, safety in (("navigator", True), ("unsafe", False)):
                ends, share = navigated.by_navigators(
                    navigated.Worlds(run, options.seed, many),
                    lambda safety=safety: navigator.Navigator(str(bundle), safety=safety), laser(scans, run),
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
                laser(scans, run), adversary(policy, run),
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
    played = run.evaluator.summaries(actor, episodes, seed)
    alike = (ends.arrived == played.arrived.ravel()) & (ends.collided == played.collided.ravel())
    return {
        "episodes": worlds.count,
        "alike": int(alike.sum()),
        "same_steps": int((ends.steps == played.steps.ravel()).sum()),
    }


def adversary(policy, run):
    """A decision for every observation: full speed, turning toward the nearest obstacle."""
    angles = np.linspace(-np.pi / 2, np.pi / 2, run.world.config.beams)
    turn, fast = float(run.params.max_w), float(run.params.max_v)

    def act(observation):
        toward = angles[np.argmin(observation["scan"])] / float(run.params.dt)
        return policy.Decision(fast, float(np.clip(toward, -turn, turn)), 0, None, None, None)

    return act


def laser(scans, run):
    """A function (ranges) -> the scan that a laser driver reports: nothing comes back from where nothing is."""
    longest, beams = float(run.params.scan_range), run.world.config.beams

    def report(ranges):
        return scans.Scan(np.where(ranges >= longest, np.inf, ranges), -np.pi / 2, np.pi / (beams - 1))

    return report


def _paired(before, after):
    """Difference of two success rates over the same episodes, in points, and its 95 % interval."""
    change = 100.0 * (after.astype(float) - before.astype(float))
    half = 1.96 * change.std() / math.sqrt(len(change))
    return [float(change.mean()), float(change.mean() - half), float(change.mean() + half)]


def study(options):
    """Do what is missing, and write both files."""
    scene_study.make_folder(options.out)
    console, path = Console(stderr=True, soft_wrap=True, markup=False), options.out / f"{PROGRAM}.json"
    numbers = {name: getattr(options, name) for name in ("states", "episodes", "drives", "worlds", "seed")}
    identity = numbers | {"embeddings": default_table().fingerprint}
    result = {"command": f"python experiments/{PROGRAM}.py", **identity, **provenance()}
    rows = {name: (compare, name) for name in CONFIGURATIONS} | {
        f"drive {suite}": (drive, suite) for suite in options.suites
    }
    for field in ("rows", "commits"):
        result[field] = scene_study.stored(path, identity, field, {})
    for row, (function, name) in rows.items():
        if row not in result["rows"]:
            result["rows"][row] = function(name, options, console)
            result["commits"][row] = result["git_commit"]
            scene_study.write(path, result)
    scene_study.write(path, result)
    path.with_suffix(".md").write_text(table(result))
    return result


def table(result):
    """The result as Markdown."""
    commits = ", ".join(sorted(set(map(str, result["commits"].values()))))
    lines = [
        f"Exported policies beside those in JAX. Device: {result['device']}; commits: {commits}; seed "
        f"{result['seed']}.",
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
    scene_study.main(Options, study, table, PROGRAM, arguments)


if __name__ == "__main__":
    main()
