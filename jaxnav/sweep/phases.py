"""The phases of a sweep: which populations each has, which trial begins next, and where trials are stopped."""

import dataclasses
import pathlib
import re
from collections.abc import Callable, Sequence
from typing import Any

from ..training.config import HSACRunConfig
from .progress import better_first
from .results import Trial
from .spec import FRESH_SEED, Sweep
from .store import Store, Study, distributions
from .worker import PopulationJob

SEARCH_SEED, CONFIRM_SEED = 2**31 + 1, 2**31 + 2  # of the episodes; apart, so that no winner is chosen on its own exam

Sizes = dict[str, Any]  # values of static fields by dotted name


@dataclasses.dataclass(frozen=True)
class TrialProposal:
    """A trial that is to begin.

    values: by dotted name, sizes included; seed: of its training; of: the trial whose values these are, None for base.
    """

    values: dict[str, Any]
    seed: int
    of: int | None = None


# (sizes, number of the next trial) -> the trial that begins, None where none is to begin with these sizes.
Proposer = Callable[[Sizes, int], TrialProposal | None]


@dataclasses.dataclass(frozen=True)
class Phase:
    """A phase of a sweep.

    name:        search, confirm or guard.
    populations: its populations, each with its sizes.
    total_steps: steps of a trial.
    kinds:       Optuna's distributions of the values.
    proposer:    the study and its trials -> a `Proposer`.
    rungs:       steps after which the worst trials are stopped.
    reaches:     success in every scene at which a trial ends.
    """

    name: str
    populations: list[tuple[PopulationJob, Sizes]]
    total_steps: int
    kinds: dict[str, Any]
    proposer: Callable[[Study, list[Trial]], Proposer]
    rungs: tuple[int, ...] = ()
    reaches: float | None = None


def search(sweep: Sweep, folder: pathlib.Path, store: Store) -> Phase:
    """Trials that the sampler proposes, base among them; the worst are stopped."""
    base = sweep.base_values()
    allowed = all(found.low <= base[name] <= found.high for name, found in sweep.space.items())

    def proposer(study: Study, trials: list[Trial]) -> Proposer:
        sampler = study.sampler(sweep.seed, startup=max(10, sweep.members))
        had = any(trial.values == base for trial in trials)

        def propose(sizes: Sizes, number: int) -> TrialProposal | None:
            nonlocal had
            if number >= sweep.trials:
                return None
            fixed = sizes
            if allowed and not had and sizes == {name: base[name] for name in sizes}:
                fixed, had = base, True  # base, with which all are compared, is one of the trials
            return TrialProposal(sampler.ask(number, kinds, fixed), sweep.base.seed + number)

        return propose

    kinds = distributions(sweep)
    found = populations(
        sweep, folder, "search", sweep.base, sweep.combinations, sweep.populations, SEARCH_SEED, "validation"
    )
    return Phase("search", found, sweep.base.train.total_steps, kinds, proposer, sweep.rungs)


def confirm(sweep: Sweep, folder: pathlib.Path, store: Store) -> Phase | None:
    """The best trials of the search and base, with fresh seeds and judged on other episodes; None if not asked for."""
    if not sweep.confirm:
        return None
    proposals = _again(sweep, store)
    sizes = _sizes(sweep, proposals, store.trials("confirm"))
    found = populations(sweep, folder, "confirm", sweep.base, sizes, 1, CONFIRM_SEED, "test")
    kinds = distributions(sweep, proposals)
    return Phase("confirm", found, sweep.base.train.total_steps, kinds, _listed(proposals))


def guard(sweep: Sweep, folder: pathlib.Path, store: Store) -> Phase | None:
    """The same in the guard's scenes, until its success; None if the sweep has no guard."""
    asked = sweep.guard
    if asked is None or not sweep.confirm:
        return None
    proposals = _again(sweep, store)
    train = dataclasses.replace(sweep.base.train, total_steps=asked.total_steps)
    config: Any = dataclasses.replace(sweep.base.of_scenes(asked.scene), train=train)
    sizes = _sizes(sweep, proposals, store.trials("guard"))
    found = populations(sweep, folder, "guard", config, sizes, 1, CONFIRM_SEED, "test", asked.every)
    kinds = distributions(sweep, proposals)
    return Phase("guard", found, asked.total_steps, kinds, _listed(proposals), reaches=asked.reaches)


def populations(
    sweep: Sweep, folder: pathlib.Path, phase: str, base: HSACRunConfig, combinations: Sequence[Sizes], each: int,
    seed: int, phrases: str, steps: int | None = None,
) -> list[tuple[PopulationJob, Sizes]]:  # fmt: skip
    """The populations of a phase and their sizes.

    base:         configuration of their members.
    combinations: combinations of sizes.
    each:         number of populations of a combination.
    seed, phrases: of the episodes that judge them.
    steps:        length of a round, by default the sweep's.
    """
    found = []
    for sizes in combinations:
        config = dataclasses.replace(sweep, base=base).configuration(sizes)
        # Named by its sizes, not by its place among others: a sweep that goes on may have others.
        label = "".join(f"-{name}={value}" for name, value in sizes.items())
        for i in range(each):
            name = re.sub(r"[^\w.=-]+", "_", f"{phase}{label}-{i}")
            where = str((folder / "populations" / f"{name}-of-{sweep.members}").resolve())
            job = PopulationJob(
                name, config, sweep.members, tuple(sweep.space), steps or sweep.round_steps, sweep.episodes, seed,
                phrases, where,
            )  # fmt: skip
            found.append((job, sizes))
    return found


def _again(sweep: Sweep, store: Store) -> list[TrialProposal]:
    """The trainings with fresh seeds: of base and of the best trials of the search."""
    base = sweep.base_values()
    done = [trial for trial in store.trials("search") if trial.state == "complete" and trial.values != base]
    best = sorted(done, key=lambda trial: better_first(trial, sweep.sign))[: sweep.confirm]
    candidates = [(None, base), *((trial.number, trial.values) for trial in best)]
    return [TrialProposal(values, FRESH_SEED + i, of) for i in range(sweep.seeds) for of, values in candidates]


def _sizes(sweep: Sweep, proposals: list[TrialProposal], trials: list[Trial]) -> list[Sizes]:
    """Sizes of the trials that are to begin and of those that train, even if nobody would propose the latter now."""
    found = []
    for each in [*proposals, *(trial for trial in trials if trial.state == "running")]:
        sizes = {name: each.values[name] for name in sweep.sizes}
        if sizes not in found:
            found.append(sizes)
    return found


def _listed(proposals: list[TrialProposal]) -> Callable[[Study, list[Trial]], Proposer]:
    """A `Phase.proposer` of trials that are known beforehand."""

    def proposer(study: Study, trials: list[Trial]) -> Proposer:
        begun = {(trial.of, trial.seed) for trial in trials}
        waiting = [proposal for proposal in proposals if (proposal.of, proposal.seed) not in begun]

        def propose(sizes: Sizes, number: int) -> TrialProposal | None:
            for proposal in waiting:
                if all(proposal.values[name] == value for name, value in sizes.items()):
                    waiting.remove(proposal)
                    return proposal
            return None

        return propose

    return proposer
