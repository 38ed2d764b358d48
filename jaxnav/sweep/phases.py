"""The phases of a sweep: in which populations they train, who comes next, and when a trial ends."""

import dataclasses
import pathlib
import re
from collections.abc import Callable
from typing import Any

from .judge import CONFIRM_SEED, SEARCH_SEED
from .progress import better_first
from .spec import FRESH_SEED
from .store import Store, distributions
from .worker import PopulationJob


@dataclasses.dataclass(frozen=True)
class Job:
    """A trial that is to begin: its values by dotted name, sizes included, its seed, and whose values they are."""

    values: dict[str, Any]
    seed: int
    of: int | None = None


@dataclasses.dataclass(frozen=True)
class Phase:
    """One of the sweep's.

    units: its populations, with the sizes that each is compiled for; total_steps: of a trial; rungs: where the worst
    are stopped; reaches: success in every scene, with which a trial ends; kinds: distributions of the values;
    proposals: a function (study, trials) -> a function (sizes, number of the next trial) -> `Job`, or None if nobody
    is to begin with these sizes.
    """

    name: str
    units: list[tuple[PopulationJob, dict]]
    total_steps: int
    kinds: dict
    proposals: Callable
    rungs: tuple[int, ...] = ()
    reaches: float | None = None


def search(sweep, folder: pathlib.Path, store: Store) -> Phase:
    """Trials that the sampler proposes, base among them; the worst are stopped."""
    base = sweep.base_values()
    allowed = all(found.low <= base[name] <= found.high for name, found in sweep.space.items())

    def proposals(study, trials):
        sampler = study.sampler(sweep.seed, startup=max(10, sweep.members))
        had = any(trial.values == base for trial in trials)

        def propose(sizes, number):
            nonlocal had
            if number >= sweep.trials:
                return None
            fixed = sizes
            if allowed and not had and sizes == {name: base[name] for name in sizes}:
                fixed, had = base, True  # what everything is compared with is one of the trials
            return Job(sampler.ask(number, kinds, fixed), sweep.base.seed + number)

        return propose

    kinds = distributions(sweep)
    config, steps = sweep.base, sweep.base.train.total_steps
    units = populations(
        sweep, folder, "search", config, sweep.combinations, sweep.populations, SEARCH_SEED, "validation"
    )
    return Phase("search", units, steps, kinds, proposals, sweep.rungs)


def confirm(sweep, folder: pathlib.Path, store: Store) -> Phase | None:
    """The best of the search and base with fresh seeds, judged on other episodes; None if the sweep asks for none."""
    if not sweep.confirm:
        return None
    jobs = _again(sweep, store)
    sizes = _sizes(sweep, jobs, store.trials("confirm"))
    units = populations(sweep, folder, "confirm", sweep.base, sizes, 1, CONFIRM_SEED, "test")
    return Phase("confirm", units, sweep.base.train.total_steps, distributions(sweep, jobs), _listed(jobs))


def guard(sweep, folder: pathlib.Path, store: Store) -> Phase | None:
    """The same in the guard's scenes, until its success; None if the sweep has none."""
    asked = sweep.guard
    if asked is None or not sweep.confirm:
        return None
    jobs = _again(sweep, store)
    train = dataclasses.replace(sweep.base.train, total_steps=asked.total_steps)
    config = dataclasses.replace(sweep.base, scene=asked.scene, train=train)
    units = populations(
        sweep, folder, "guard", config, _sizes(sweep, jobs, store.trials("guard")), 1, CONFIRM_SEED, "test", asked.every
    )  # fmt: skip
    kinds = distributions(sweep, jobs)
    return Phase("guard", units, asked.total_steps, kinds, _listed(jobs), reaches=asked.reaches)


def populations(sweep, folder, phase, base, combinations, each, seed, phrases, steps=None):
    """(`PopulationJob`, sizes) of a phase. combinations: of sizes; each: how many populations they have; steps: of a round."""
    units = []
    for sizes in combinations:
        config = dataclasses.replace(sweep, base=base).configuration(sizes)
        # By what it is, not by its place among others: whoever goes on may have others.
        label = "".join(f"-{name}={value}" for name, value in sizes.items())
        for i in range(each):
            name = re.sub(r"[^\w.=-]+", "_", f"{phase}{label}-{i}")
            where = str((folder / "populations" / f"{name}-of-{sweep.members}").resolve())
            unit = PopulationJob(
                name, config, sweep.members, tuple(sweep.space), steps or sweep.round_steps, sweep.episodes, seed,
                phrases, where,
            )  # fmt: skip
            units.append((unit, sizes))
    return units


def _again(sweep, store):
    """Who is trained again with fresh seeds: base, and the best of the search."""
    sign = 1 if sweep.direction == "maximize" else -1
    base = sweep.base_values()
    done = [trial for trial in store.trials("search") if trial.state == "complete" and trial.values != base]
    best = sorted(done, key=lambda trial: better_first(trial, sign))[: sweep.confirm]
    candidates = [(None, base), *((trial.number, trial.values) for trial in best)]
    return [Job(values, FRESH_SEED + i, of) for i in range(sweep.seeds) for of, values in candidates]


def _sizes(sweep, jobs, trials):
    """Those of who is to begin, and of who trains already, also if nobody would ask for them today."""
    found = []
    for job in [*jobs, *(trial for trial in trials if trial.state == "running")]:
        sizes = {name: job.values[name] for name in sweep.sizes}
        if sizes not in found:
            found.append(sizes)
    return found


def _listed(jobs):
    """Proposals that are known beforehand."""

    def proposals(study, trials):
        waiting = [job for job in jobs if (job.of, job.seed) not in {(trial.of, trial.seed) for trial in trials}]

        def propose(sizes, number):
            for job in waiting:
                if all(job.values[name] == value for name, value in sizes.items()):
                    waiting.remove(job)
                    return job
            return None

        return propose

    return proposals
