"""A process that holds populations on its device and trains them a round at a time.

The state of a population after a number of rounds follows from its fills: which learner began when, in which slot. So a
process that has lost a population, or never had it, loads its last checkpoint, if there is one, and plays the rounds
since then again.
"""

import concurrent.futures
import dataclasses
import hashlib
import json
import pathlib
import time
from typing import Any

import jax
import numpy as np

from ..training.checkpoint import Checkpoints
from ..training.config import HSACRunConfig, make_agent
from ..training.dataclass_json import to_json
from ..training.evaluation import Evaluator, scene_metrics
from ..training.policy import Policy
from ..training.population import Population
from .spec import get

LOSSES = (
    "reward", "critic_loss", "actor_loss", "q", "twist_entropy", "request_entropy", "twist_temperature",
    "request_temperature",
)  # fmt: skip


@dataclasses.dataclass(frozen=True)
class PopulationJob:
    """A population that a sweep has trained.

    name:        its name in the sweep.
    config:      the members' configuration, but for their seeds and searched floats.
    members:     number of slots.
    floats:      dotted names of the floats that differ between members.
    round_steps: steps of every episode in a round, after which the members are judged.
    episodes:    episodes of each scene that judge them.
    seed:        seed of those episodes.
    phrases:     the split of phrases that people speak there.
    folder:      where its checkpoints are.
    """

    name: str
    config: HSACRunConfig
    members: int
    floats: tuple[str, ...]
    round_steps: int
    episodes: int
    seed: int
    phrases: str
    folder: str

    def program(self) -> str:
        """A text that is equal for populations that share a compiled program."""
        config = to_json(self.config)
        config["train"].pop("checkpoint_seconds")
        return json.dumps([config, self.members, self.floats, self.episodes], sort_keys=True)


@dataclasses.dataclass(frozen=True)
class SlotFill:
    """A learner that begins in a slot before a round. values: the floats of `PopulationJob.floats` by name."""

    round: int
    slot: int
    seed: int
    values: dict[str, float]


@dataclasses.dataclass(frozen=True)
class Round:
    """The result of a round.

    scenes:  for each slot the metrics of every scene (`jaxnav.training.evaluation.scene_metrics`).
    losses:  for each slot its mean losses by name.
    broken:  for each slot whether its numbers are no longer finite.
    seconds: the time it took to train and to judge.
    device:  the kind of device.
    """

    scenes: list[dict]
    losses: list[dict]
    broken: list[bool]
    seconds: float
    device: str


@dataclasses.dataclass
class _Held:
    """A population that this process holds: its state after ``round`` rounds, and the result of the last one."""

    round: int
    loop: Any
    broken: tuple
    last: Round | None
    saved: float


class _PopulationEvaluator:
    """Plays all members of a population at once, through one program that is compiled ahead of its first use."""

    def __init__(self, population: Population, params: Any, agent: Any, episodes: int) -> None:
        self._evaluator = Evaluator(population.world, params, episodes, members=True)
        self._policy = Policy(population.policy_shapes(), True, learner=agent, world=population.world)
        self._episodes = episodes

    def compile(self) -> None:
        self._evaluator.compile(self._policy.hearing("validation"))

    @property
    def bytes_needed(self) -> int:
        self.compile()
        return self._evaluator.bytes_needed

    def __call__(self, parameters: Any, seed: int, phrases: str) -> list[dict[str, Any]]:
        """The metrics of each member, by scene."""
        policies = self._policy.replace(parameters=parameters).hearing(phrases)
        self.compile()
        played = self._evaluator.summaries(policies, self._episodes, seed)
        world = self._evaluator.world
        members = range(played.arrived.shape[0])
        return [scene_metrics(world, jax.tree.map(lambda leaf, i=i: leaf[i], played)) for i in members]


class Worker:
    """Holds populations and trains them. Populations that are alike share a compiled program."""

    def __init__(self) -> None:
        self._programs: dict[str, tuple[Population, _PopulationEvaluator]] = {}
        self._held: dict[str, _Held] = {}

    def advance(self, job: PopulationJob, round: int, fills: list[SlotFill]) -> Round:
        """Round number ``round`` of a population, from 0. fills: all so far, those of this round included.

        The same call again gives the same result. UserError: the device's memory is too small, a checkpoint can't be
        written.
        """
        self.prepare([job])
        held = self._held.get(job.name)
        if held is None or held.round > round + 1:
            self._held.pop(job.name, None)
            held = self._held[job.name] = self._restore(job, round, fills)
        while held.round <= round:
            self._play(job, held, fills)
        assert held.last is not None
        return held.last

    def prepare(self, jobs: list[PopulationJob]) -> None:
        """Compile the programs of populations that have none yet, in parallel.

        UserError: memory is too small for the populations that aren't held yet.
        """
        programs = [self._program(job) for job in {job.program(): job for job in jobs}.values()]
        with concurrent.futures.ThreadPoolExecutor() as pool:
            list(pool.map(lambda part: part.compile(), [part for program in programs for part in program]))
        new = [self._program(job) for job in jobs if job.name not in self._held]
        if new:
            # One population trains at a time, and is judged when it doesn't.
            beside = sum(population.bytes_held for population, _ in new[1:])
            judging = max(0, new[0][1].bytes_needed - (new[0][0].bytes_needed - new[0][0].bytes_held))
            new[0][0].check_memory("members", beside + judging, len(new))

    def forget(self, name: str) -> None:
        """Free the memory of a population that is done."""
        self._held.pop(name, None)

    def _program(self, job: PopulationJob) -> tuple[Population, _PopulationEvaluator]:
        key = job.program()
        if key not in self._programs:
            config, agent = job.config, make_agent(job.config)
            own = tuple(name.rpartition(".")[2] for name in job.floats if name.startswith("world."))
            population = Population(config, agent, job.members, own)
            evaluate = _PopulationEvaluator(population, config.world.params, agent, job.episodes)
            self._programs[key] = population, evaluate
        return self._programs[key]

    def _restore(self, job: PopulationJob, round: int, fills: list[SlotFill]) -> _Held:
        """The population after the last checkpoint that is not ahead of ``round``, or at its start."""
        population, _ = self._program(job)
        folder = pathlib.Path(job.folder)
        if folder.is_dir():
            checkpoints = Checkpoints(folder)
            saved = checkpoints.latest_step()
            if saved is not None and saved <= round + 1:
                like = jax.eval_shape(lambda: population.start(range(job.members), job.config.hyper))
                loop, meta = checkpoints.restore(like, _identity(job, fills, saved))
                last = Round(**meta["last"])
                return _Held(saved, loop, tuple(meta["broken"]), last, time.monotonic())
        loop = population.start(range(job.members), job.config.hyper)
        return _Held(0, loop, (None,) * job.members, None, time.monotonic())

    def _play(self, job: PopulationJob, held: _Held, fills: list[SlotFill]) -> None:
        """Train one more round."""
        population, evaluate = self._program(job)
        began = time.monotonic()
        before = [fill for fill in fills if fill.round <= held.round]
        hyper, own, since, seeds = _floats(job, before)
        new = [fill.slot for fill in before if fill.round == held.round]
        slots = np.isin(np.arange(job.members), new)
        loop = population.refill(held.loop, slots, seeds, hyper) if slots.any() else held.loop
        broken = tuple(None if slots[i] else step for i, step in enumerate(held.broken))
        lines = []
        loop, trained = population.train(
            loop, hyper, (held.round + 1) * job.round_steps, lambda steps, metrics: lines.append(metrics), broken,
            own, since,
        )  # fmt: skip
        scenes = evaluate(trained.policies, job.seed, job.phrases)
        losses = [
            {name: float(np.mean([line[name][i] for line in lines])) for name in LOSSES if name in lines[0]}
            for i in range(job.members)
        ]
        held.round, held.loop, held.broken = held.round + 1, loop, trained.broken
        held.last = Round(
            scenes=scenes,
            losses=[{name: v if np.isfinite(v) else None for name, v in loss.items()} for loss in losses],
            broken=[step is not None for step in trained.broken],
            seconds=time.monotonic() - began,
            device=jax.devices()[0].device_kind,
        )
        if time.monotonic() - held.saved >= job.config.train.checkpoint_seconds:
            meta = {
                "config": _identity(job, fills, held.round), "broken": list(held.broken),
                "last": dataclasses.asdict(held.last),
            }  # fmt: skip
            Checkpoints(pathlib.Path(job.folder)).save(held.round, loop, meta)
            held.saved = time.monotonic()


def _identity(job: PopulationJob, fills: list[SlotFill], rounds: int) -> dict[str, Any]:
    """The identity of a checkpoint after so many rounds, as JSON: the program and the learners so far."""
    there = [dataclasses.asdict(fill) for fill in fills if fill.round < rounds]
    digest = hashlib.sha256(json.dumps(there, sort_keys=True).encode()).hexdigest()
    return {"population": job.name, "program": json.loads(job.program()), "trials": digest}


def _floats(job: PopulationJob, fills: list[SlotFill]) -> tuple[Any, dict[str, np.ndarray], np.ndarray, np.ndarray]:
    """(`HSACHyperparameters` `[members]`, the world's floats `[members]`, steps at their start, seeds) of the slots."""
    latest = {fill.slot: fill for fill in fills}  # in order of their rounds: the last counts
    columns = {name: np.full(job.members, get(job.config, name), np.float32) for name in job.floats}
    since, seeds = np.zeros(job.members, np.int32), np.arange(job.members, dtype=np.uint32)
    for slot, fill in latest.items():
        since[slot], seeds[slot] = fill.round * job.round_steps, fill.seed
        for name in job.floats:
            columns[name][slot] = fill.values[name]
    hyper = dataclasses.replace(
        job.config.hyper,
        **{name.rpartition(".")[2]: column for name, column in columns.items() if name.startswith("hyper.")},
    )
    own = {name.rpartition(".")[2]: column for name, column in columns.items() if name.startswith("world.")}
    return hyper, own, since, seeds
