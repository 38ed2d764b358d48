"""Where populations train: a process that holds some of them on its device and takes them a round further.

What a population is after so many rounds follows from who began when, in which slot: its fills. So a process that has
lost it, or never had it, takes up its last checkpoint, or none, and plays the rounds since then again.
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
from ..training.config import RunConfig, make_agent
from ..training.dataclass_json import to_json
from ..training.population import Population
from .judge import PopulationEvaluator
from .spec import get

LOSSES = (
    "reward", "critic_loss", "actor_loss", "q", "twist_entropy", "request_entropy", "twist_temperature",
    "request_temperature",
)  # fmt: skip


@dataclasses.dataclass(frozen=True)
class PopulationJob:
    """A population of a sweep.

    name: of it in the sweep; config: of its members, seed and searched floats aside; members: slots; floats: dotted
    names of what each has of its own; round_steps: of all episodes between two looks; episodes: of each scene, seed
    and phrases: of the look; folder: of its checkpoints.
    """

    name: str
    config: RunConfig
    members: int
    floats: tuple[str, ...]
    round_steps: int
    episodes: int
    seed: int
    phrases: str
    folder: str

    def program(self):
        """What has to be the same for two populations to share what is compiled."""
        config = to_json(self.config)
        config["train"].pop("checkpoint_seconds")
        return json.dumps([config, self.members, self.floats, self.episodes], sort_keys=True)


@dataclasses.dataclass(frozen=True)
class SlotFill:
    """A learner that begins in a slot before a round. values: by dotted name, those of `PopulationJob.floats`."""

    round: int
    slot: int
    seed: int
    values: dict[str, float]


@dataclasses.dataclass(frozen=True)
class Round:
    """What a round came to: scenes: of each slot its metrics (`judge.metrics`); losses: of each slot; broken: whether
    the numbers of a slot are no longer finite; seconds: that it took, to train and to judge; device: which."""

    scenes: list[dict]
    losses: list[dict]
    broken: list[bool]
    seconds: float
    device: str


@dataclasses.dataclass
class _Held:
    """A population that this process holds: its state after ``round`` rounds, and what the last came to."""

    round: int
    loop: Any
    broken: tuple
    last: Round | None
    saved: float


class Worker:
    """Holds populations and takes them further. Programs are compiled once for all that are alike."""

    def __init__(self):
        self._programs: dict[str, tuple[Population, PopulationEvaluator]] = {}
        self._held: dict[str, _Held] = {}

    def advance(self, unit: PopulationJob, round: int, fills: list[SlotFill]) -> Round:
        """Round number ``round`` of a population, from 0. fills: all so far, those of this round included.

        Asked again, it answers again. UserError: the device's memory is too small, a checkpoint can't be written.
        """
        self.prepare([unit])
        held = self._held.get(unit.name)
        if held is None or held.round > round + 1:
            self._held.pop(unit.name, None)
            held = self._held[unit.name] = self._take_up(unit, round, fills)
        while held.round <= round:
            self._play(unit, held, fills)
        assert held.last is not None
        return held.last

    def prepare(self, units: list[PopulationJob]):
        """Compile what populations need, unless that is done: beside each other, where there are cores for it.

        UserError: memory is too small for those of them that aren't held yet.
        """
        programs = [self._program(unit) for unit in {unit.program(): unit for unit in units}.values()]
        with concurrent.futures.ThreadPoolExecutor() as pool:
            list(pool.map(lambda part: part.compile(), [part for program in programs for part in program]))
        new = [self._program(unit) for unit in units if unit.name not in self._held]
        if new:
            # One population trains at a time, and is judged when it doesn't.
            beside = sum(population.bytes_held for population, _ in new[1:])
            judging = max(0, new[0][1].bytes_needed - (new[0][0].bytes_needed - new[0][0].bytes_held))
            new[0][0].check_memory("members", beside + judging, len(new))

    def forget(self, name):
        """Free the memory of a population that is done."""
        self._held.pop(name, None)

    def _program(self, unit):
        key = unit.program()
        if key not in self._programs:
            config, agent = unit.config, make_agent(unit.config)
            own = tuple(name.rpartition(".")[2] for name in unit.floats if name.startswith("world."))
            population = Population(config, agent, unit.members, own)
            judge = PopulationEvaluator(
                population.world, config.world.params, agent, unit.episodes, population.policy_shapes()
            )
            self._programs[key] = population, judge
        return self._programs[key]

    def _take_up(self, unit, round, fills):
        """The population after the last checkpoint that is not ahead of ``round``, or at its start."""
        population, _ = self._program(unit)
        folder = pathlib.Path(unit.folder)
        if folder.is_dir():
            checkpoints = Checkpoints(folder)
            saved = checkpoints.latest_step()
            if saved is not None and saved <= round + 1:
                like = jax.eval_shape(lambda: population.start(range(unit.members), unit.config.hyper))
                loop, meta = checkpoints.restore(like, _identity(unit, fills, saved))
                last = Round(**meta["last"])
                return _Held(saved, loop, tuple(meta["broken"]), last, time.monotonic())
        loop = population.start(range(unit.members), unit.config.hyper)
        return _Held(0, loop, (None,) * unit.members, None, time.monotonic())

    def _play(self, unit, held, fills):
        """One round more."""
        population, judge = self._program(unit)
        began = time.monotonic()
        before = [fill for fill in fills if fill.round <= held.round]
        hyper, own, since, seeds = _floats(unit, before)
        new = [fill.slot for fill in before if fill.round == held.round]
        slots = np.isin(np.arange(unit.members), new)
        loop = population.refill(held.loop, slots, seeds, hyper) if slots.any() else held.loop
        broken = tuple(None if slots[i] else step for i, step in enumerate(held.broken))
        lines = []
        loop, trained = population.train(
            loop, hyper, (held.round + 1) * unit.round_steps, lambda steps, metrics: lines.append(metrics), broken,
            own, since,
        )  # fmt: skip
        scenes = judge(trained.policies, unit.seed, unit.phrases)
        losses = [
            {name: float(np.mean([line[name][i] for line in lines])) for name in LOSSES if name in lines[0]}
            for i in range(unit.members)
        ]
        held.round, held.loop, held.broken = held.round + 1, loop, trained.broken
        held.last = Round(
            scenes=scenes,
            losses=[{name: v if np.isfinite(v) else None for name, v in loss.items()} for loss in losses],
            broken=[step is not None for step in trained.broken],
            seconds=time.monotonic() - began,
            device=jax.devices()[0].device_kind,
        )
        if time.monotonic() - held.saved >= unit.config.train.checkpoint_seconds:
            meta = {
                "config": _identity(unit, fills, held.round), "broken": list(held.broken),
                "last": dataclasses.asdict(held.last),
            }  # fmt: skip
            Checkpoints(pathlib.Path(unit.folder)).save(held.round, loop, meta)
            held.saved = time.monotonic()


def _identity(unit, fills, rounds):
    """What a checkpoint after so many rounds is of, as JSON: the program, and who was there."""
    there = [dataclasses.asdict(fill) for fill in fills if fill.round < rounds]
    digest = hashlib.sha256(json.dumps(there, sort_keys=True).encode()).hexdigest()
    return {"population": unit.name, "program": json.loads(unit.program()), "trials": digest}


def _floats(unit, fills):
    """(`HSACHyperparameters` `[members]`, the world's floats `[members]`, counters at their start, seeds) of the slots."""
    latest = {fill.slot: fill for fill in fills}  # in order of their rounds: the last counts
    columns = {
        name: np.full(unit.members, get(unit.config, name), np.float32) for name in unit.floats
    }  # fmt: skip
    since, seeds = np.zeros(unit.members, np.int32), np.arange(unit.members, dtype=np.uint32)
    for slot, fill in latest.items():
        since[slot], seeds[slot] = fill.round * unit.round_steps, fill.seed
        for name in unit.floats:
            columns[name][slot] = fill.values[name]
    hyper = unit.config.hyper.replace(
        **{name.rpartition(".")[2]: column for name, column in columns.items() if name.startswith("hyper.")}
    )
    own = {name.rpartition(".")[2]: column for name, column in columns.items() if name.startswith("world.")}
    return hyper, own, since, seeds
