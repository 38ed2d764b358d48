"""The search: which trials begin, are stopped and are confirmed. All of it follows from the store.

Each turn decides on the trials that have come to a rung, fills free slots, and trains every population for a round.
Populations wait for each other: so the trials are the same whatever engine trains them, and a sweep that was killed
proposes the same ones again. Halving is that of Li et al. 2020 ("A system for massively parallel hyperparameter
tuning", ASHA), decided at once for all trials that have come to a rung.
"""

import json
import math
import pathlib
from collections.abc import Callable
from typing import Any

from ..errors import UserError
from . import phases
from .engines import Engine, Task
from .results import PHASES, Results, Trial
from .spec import Sweep
from .store import Place, Store, Study
from .worker import PopulationJob, Round, SlotFill


def run(
    sweep: Sweep,
    folder: pathlib.Path,
    store: Store,
    engine: Engine,
    report: Callable[[Results, str], None] = lambda results, state: None,
) -> Results:
    """Run search, confirmation and guard, from where the store is.

    report: called after each round with the results so far and a line on the current state.
    """
    for make in (phases.search, phases.confirm, phases.guard):
        phase = make(sweep, folder, store)
        if phase is not None and phase.populations:
            study = store.open(phase.name, sweep)
            _play(sweep, phase, study, engine, lambda state: report(results(sweep, store), state))
    return results(sweep, store)


def results(sweep: Sweep, store: Store) -> Results:
    """The results in the store."""
    budget = {field: getattr(sweep, field) for field in ("trials", "confirm", "seeds")}
    found = {phase: store.trials(phase) for phase in PHASES}
    return Results(store.name, json.loads(json.dumps(sweep.identity())), budget, found)


def _play(sweep: Sweep, phase: phases.Phase, study: Study, engine: Engine, report: Callable[[str], None]) -> None:
    """Train all trials of a phase, in turns that all populations take together."""
    _check_members(sweep, study)
    while True:
        trials, places = study.trials(), study.places()
        # Trials are behind where the sweep was killed before they were stored: nothing is decided without them.
        turns = {places[t.number].turn + len(t.curve) for t in trials if t.state == "running"}
        if len(turns) < 2:
            _decide(sweep, phase, study, trials)
            _fill(sweep, phase, study)
            trials, places = study.trials(), study.places()
            turns = {places[t.number].turn + len(t.curve) for t in trials if t.state == "running"}
        if not turns:
            engine.forget([job.name for job, _ in phase.populations])
            report(f"{phase.name}: done")
            return
        behind = {
            trial.number: trial for trial in trials
            if trial.state == "running" and places[trial.number].turn + len(trial.curve) == min(turns)
        }  # fmt: skip
        if not any(trial.curve for trial in trials):
            report(f"{phase.name}: the first round compiles")
        tasks = _tasks(phase, trials, places, behind)
        found = engine.advance(tasks, _counter(report, phase.name, len(tasks), len(trials), len(behind)))
        for (job, _, _), result in zip(tasks, found, strict=True):
            there = [t for t in trials if t.state == "running" and places[t.number].population == job.name]
            for trial in there:
                if trial.number in behind:
                    study.report(trial, *_row(sweep, job, trial, places[trial.number].slot, result, len(there)))


def _check_members(sweep: Sweep, study: Study) -> None:
    """UserError: a sweep goes on with fewer slots than its running trials need."""
    for trial, place in zip(study.trials(), study.places().values(), strict=True):
        if trial.state == "running" and place.slot >= sweep.members:
            raise UserError(
                f"members is {sweep.members}, but trial {trial.number} trains in slot {place.slot} of its population: "
                "give as many as before until it has ended"
            )


def _tasks(phase: phases.Phase, trials: list[Trial], places: dict[int, Place], behind: dict[int, Trial]) -> list[Task]:
    """The tasks of a turn. behind: the trials that it trains."""
    tasks = []
    for job, _ in phase.populations:
        there = [trial for trial in trials if places[trial.number].population == job.name]
        rounds = {places[trial.number].round + len(trial.curve) for trial in there if trial.number in behind}
        if rounds:
            (round,) = rounds
            fills = [
                SlotFill(places[t.number].round, places[t.number].slot, t.seed, {n: t.values[n] for n in job.floats})
                for t in there
                if places[t.number].slot < job.members  # the others have ended, when there were more slots
            ]
            tasks.append((job, round, sorted(fills, key=lambda fill: fill.round)))
    return tasks


def _counter(
    report: Callable[[str], None], name: str, populations: int, begun: int, training: int
) -> Callable[[], None]:
    """A function for an engine to call after each population."""
    back = 0

    def done():
        nonlocal back
        back += 1
        report(f"{name}: {begun} begun, {training} train; population {back} of {populations} is back")

    return done


def _row(
    sweep: Sweep, job: PopulationJob, trial: Trial, slot: int, result: Round, members: int
) -> tuple[int, dict[str, Any]]:
    """(steps of every episode since the trial began, row of its curve)."""
    step = (len(trial.curve) + 1) * job.round_steps
    broken, scenes = result.broken[slot], result.scenes[slot]
    return step, {
        "env_steps": step * job.config.train.episodes,
        "objective": None if broken else _objective(sweep, scenes),
        "scenes": scenes,
        "losses": result.losses[slot],
        "broken": broken,
        "seconds": round(result.seconds / members, 3),
        "device": result.device,
    }


def _objective(sweep: Sweep, scenes: dict[str, Any]) -> float:
    """The objective, a finite number. UserError: the sweep's function fails or gives none."""
    name = sweep.objective.__name__
    try:
        value = float(sweep.objective(scenes))
    except Exception as error:  # whatever it may raise
        raise UserError(
            f"objective {name} failed ({type(error).__name__}: {error}): mend it in the sweep's file, then go on with "
            "--resume"
        ) from error
    if not math.isfinite(value):
        raise UserError(f"objective {name} is {value}: have it give a finite number, then go on with --resume")
    return value


def _decide(sweep: Sweep, phase: phases.Phase, study: Study, trials: list[Trial]) -> None:
    """End the trials that broke, have come to their end, or are not among the best at a rung."""
    episodes = sweep.base.train.episodes
    for trial in trials:
        if trial.state != "running" or not trial.curve:
            continue
        last = trial.curve[-1]
        step = last["env_steps"] // episodes
        if last["broken"]:
            study.end(trial, "broken")
        elif step >= phase.total_steps or (
            phase.reaches and min(metrics["success"] for metrics in last["scenes"].values()) >= phase.reaches
        ):
            study.end(trial, "complete")
        elif step in phase.rungs:
            came = [
                (-sweep.sign * row["objective"], other.number) for other in trials for row in other.curve
                if row["env_steps"] == last["env_steps"] and row["objective"] is not None
            ]  # fmt: skip
            own = -sweep.sign * last["objective"], trial.number  # of equally good trials the earlier is better
            better = sum(other < own for other in came)
            if better >= math.ceil(sweep.keep * len(came)):
                study.end(trial, "stopped")


def _fill(sweep: Sweep, phase: phases.Phase, study: Study) -> None:
    """Begin trials in free slots, populations in turn."""
    trials, places = study.trials(), study.places()
    number = len(trials)
    taken = {(places[t.number].population, places[t.number].slot) for t in trials if t.state == "running"}
    free = [
        (slot, population, sizes) for slot in range(sweep.members) for population, sizes in phase.populations
        if (population.name, slot) not in taken
    ]  # fmt: skip
    turn = max((places[t.number].turn + len(t.curve) for t in trials), default=0)
    if not free:
        return
    propose = phase.proposer(study, trials)
    for slot, population, sizes in free:
        proposal = propose(sizes, number)
        if proposal is None:
            continue
        name = population.name
        ages = [places[t.number].round + len(t.curve) for t in trials if places[t.number].population == name]
        place = Place(name, slot, max(ages, default=0), turn)
        study.add(proposal.values, phase.kinds, proposal.seed, proposal.of, place)
        number += 1
