"""The worth of people's words to a learnt robot: how well it understands them, and the cost of a misunderstanding.

python -m experiments.language.understanding --help
"""

import dataclasses
import math
import pathlib

import jax
import jax.numpy as jnp
import numpy as np

from experiments import study
from experiments.language import report
from experiments.language.report import HEARD, MAIN
from experiments.tables import methods
from jaxnav import SUITES, preset
from jaxnav.language.phrases import KINDS, SPLITS
from jaxnav.language.table import default_table
from jaxnav.language.vocabulary import vocabulary
from jaxnav.statistics import packed, wilson_interval
from jaxnav.training import TrainConfig, resolve, to_json
from jaxnav.world.types import LEFT, MESSAGES, RIGHT

PROGRAM = "language.understanding"


@dataclasses.dataclass(frozen=True)
class Options:
    """Train robots that hear phrases and deaf ones, play them, and write how well they understand and arrive.

    Writes understanding.json, .md and .png. Trainings and plays that are there already are not done again: an
    interrupted study goes on where it was.

    Args:
        seeds: robots of each kind in the hard suite; in the parity suite, which saturates, at most two.
        episodes: of each scene, in pairs with test phrases and with the messages themselves, shared by the seeds; deaf
            robots and those that hear train phrases play a quarter of it, each sweep a tenth, with the first seed.
        steps: of training, of all episodes.
        seed: of the episodes that are played, the same for all robots.
        runs: folder of the trainings.
        out: folder of the results.
    """

    seeds: int = 5
    episodes: int = 10_000
    steps: int = 600
    seed: int = 7
    runs: pathlib.Path = pathlib.Path("runs/language")
    out: pathlib.Path = study.RESULTS

    def __post_init__(self):
        study.check_numbers(self, ("seeds", 1, 100), ("episodes", methods.BLOCK, 10**6), ("steps", 25, 10**5))
        study.check_multiples(self, ("steps", TrainConfig.steps_per_chunk))
        study.check_seed(self.seed)

    def seeds_of(self, suite):
        """The number of robots of each kind in a suite."""
        return min(self.seeds, 2) if suite == "parity" else self.seeds


def trainings(options):
    """(suite, robot, seed) of every robot: in the parity suite, where people can be seen in time, none is deaf."""
    kinds = (("hard", "phrases"), ("hard", "deaf"), ("parity", "phrases"))
    return [(*kind, seed) for seed in range(options.seeds) for kind in kinds if seed < options.seeds_of(kind[0])]


def shares(options, suite, robot, seed):
    """{what is heard: episodes of each scene} of a robot, in blocks."""
    seeds = options.seeds_of(suite)
    if robot == "deaf":
        parts = {"messages": 1 / (4 * seeds)}
    else:
        parts = {"messages": 1 / seeds, "test phrases": 1 / seeds, "train phrases": 1 / (4 * seeds)}
        if seed == 0:
            parts |= {heard: 0.1 for heard in HEARD if heard not in MAIN}
    return {heard: math.ceil(part * options.episodes / methods.BLOCK) * methods.BLOCK for heard, part in parts.items()}


def plays(options, suite, robot, seed):
    """{name of a row: (index of its scene, what is heard, episodes)} of a robot."""
    scenes = SUITES[suite]
    return {
        f"{suite}/{name}/{robot}/{heard}/{seed}": (scene, heard, episodes)
        for scene, name in enumerate(scenes)
        for heard, episodes in shares(options, suite, robot, seed).items()
    }


def configuration(options, suite, robot, seed):
    """The `RunConfig` of a robot."""
    base, folder = preset("quick", scenes=suite), options.runs / f"{suite}-{robot}-{seed}"
    agent, world = base.agent, base.world
    if robot == "deaf":
        agent, world = dataclasses.replace(agent, language="codes"), dataclasses.replace(world, hearing=False)
    return resolve(
        dataclasses.replace(
            base, seed=seed, out=str(folder), agent=agent, world=world,
            resume=(folder / "config.json").exists(), train=dataclasses.replace(base.train, total_steps=options.steps),
        )
    )  # fmt: skip


def trained_as(options, suite, robot):
    """All of a configuration but its name, seed and folder: it decides on the training of a robot."""
    whole = to_json(configuration(options, suite, robot, 0))
    return {name: value for name, value in whole.items() if name not in ("preset", "seed", "out", "resume")}


def understanding(run, actor):
    """Predicted message `[N]`, its probability `[N]` and the predicted reply `[N]` of every phrase of the table."""
    words = jnp.asarray(default_table().vectors())
    message, reply = jax.device_get(run.agent.understand(actor, words))
    return message.argmax(axis=-1), np.exp(message.max(axis=-1)), reply.argmax(axis=-1)


def accuracy(predictions):
    """Share of phrases understood, by split and kind, confusion: `[meant, understood]` on the test split."""
    phrases = default_table().phrases
    meant = np.array([phrase.message for phrase in phrases])
    split = np.array([phrase.split for phrase in phrases])
    kind = np.array([phrase.kind for phrase in phrases])
    reply = np.array([phrase.reply for phrase in phrases])
    result = {}
    for name in SPLITS:
        here = split == name
        right = np.array([understood[here] == meant[here] for understood, _, _ in predictions])
        mixed = [np.isin(u, (RIGHT, LEFT)) & np.isin(meant, (RIGHT, LEFT)) & (u != meant) for u, _, _ in predictions]
        replies = here & (kind == "reply")
        result[name] = {
            "phrases": int(here.sum()), "patterns": len({p.pattern for p in phrases if p.split == name}),
            "overall": float(right.mean()), "per_seed": right.mean(axis=1).tolist(),
            "ci95": wilson_interval(round(float(right.mean()) * here.sum()), int(here.sum())),
            "left_right_confused": float(np.mean([m[here].mean() for m in mixed])),
            "reply": float(np.mean([(r[replies] == reply[replies]).mean() for _, _, r in predictions])),
            "kinds": {k: float(right[:, kind[here] == k].mean()) for k in KINDS},
        }  # fmt: skip
    test = split == "test"
    confusion = np.zeros((len(MESSAGES), len(MESSAGES)))
    for understood, _, _ in predictions:
        np.add.at(confusion, (meant[test], understood[test]), 1 / len(predictions))
    return result | {"confusion": confusion.tolist()}


class Player:
    """Plays robots of a suite through two compiled programs, whatever they hear."""

    def __init__(self, run):
        self._run, self._playing = run, methods.Playing(run.world, run.params)

    def __call__(self, actor, heard, scene, episodes, seed):
        """(arrived, hit a pedestrian), bool `[episodes]` each."""
        policy = self._run.policy_of(actor)
        if HEARD[heard] is None:
            player = methods.Told(policy.replace(vocabulary=None))
        else:
            split, share, noise = HEARD[heard]
            player = policy.replace(vocabulary=vocabulary(split, share, noise))
        played = self._playing(player, scene, seed, episodes)
        return played.arrived, played.hit_pedestrian


def run(options: Options) -> dict:
    """Train and play what is missing, and write all three files."""
    console = study.console()
    identity = {
        "seeds": options.seeds, "episodes": options.episodes, "steps": options.steps, "seed": options.seed,
        "phrases": default_table().phrases_hash, "embeddings": default_table().encoder,
        "configs": {f"{suite} {kind}": trained_as(options, suite, kind) for suite, kind, _ in trainings(options)},
    }  # fmt: skip
    begun = study.Study(
        PROGRAM, options.out, identity, [key for one in trainings(options) for key in plays(options, *one)]
    )
    robots = {
        one: study.trained(configuration(options, *one), " ".join(map(str, one)), console) for one in trainings(options)
    }
    predictions = [understanding(*robot) for (_, kind, _), robot in robots.items() if kind == "phrases"]
    begun.result["accuracy"] = accuracy(predictions)
    players = {}
    for (suite, kind, seed), (trained, actor) in robots.items():
        if (suite, kind) not in players:
            players[suite, kind] = Player(trained)
        wanted = plays(options, suite, kind, seed)
        for key in begun.missing(wanted):
            scene, heard, episodes = wanted[key]
            arrived, hit = players[suite, kind](actor, heard, scene, episodes, options.seed)
            row = {
                "episodes": episodes, "success": float(arrived.mean()), "human_collision": float(hit.mean()),
                "arrived": packed(arrived[None]),
            }  # fmt: skip
            begun.add(key, row)
            console.print(f"{key}: {arrived.mean():.4f}")
    return begun.finish(report.table, report.draw)


def main(arguments=None):
    """Entry point."""
    study.main(Options, run, report.table, PROGRAM, arguments)


if __name__ == "__main__":
    main()
