"""The search: who begins, who is stopped, who is confirmed. All of it follows from the store.

Each turn decides about the trials that have come to a rung, fills free slots, and takes every population a round
further. Populations wait for each other: so the same trials are drawn whatever engine trains them, and a sweep that
was killed draws them again. Halving is that of Li et al. 2020 ("A system for massively parallel hyperparameter
tuning", ASHA), decided for all at once that have come to a rung.
"""

import json
import math
import pathlib

from ..errors import UserError
from . import phases
from .results import PHASES, Results
from .spec import Sweep
from .store import Place, Store
from .worker import SlotFill


def run(sweep: Sweep, folder: pathlib.Path, store: Store, engine, report=lambda results, state: None):
    """Search, confirm and guard, from where the store is. Returns `Results`.

    report: called with `Results` and a line on what is going on, after each round.
    """
    for make in (phases.search, phases.confirm, phases.guard):
        phase = make(sweep, folder, store)
        if phase is not None and phase.units:
            study = store.open(phase.name, sweep)
            _play(sweep, phase, study, engine, lambda state: report(results(sweep, store), state))
    return results(sweep, store)


def results(sweep: Sweep, store: Store):
    """What is in the store."""
    budget = {field: getattr(sweep, field) for field in ("trials", "confirm", "seeds")}
    found = {phase: store.trials(phase) for phase in PHASES}
    return Results(store.name, json.loads(json.dumps(sweep.identity())), budget, found)


def _play(sweep, phase, study, engine, report):
    """Train all trials of a phase, in turns that all populations take together."""
    _check_members(sweep, study)
    while True:
        trials, places = study.trials(), study.places()
        # Trials that are behind are those that a kill kept from being told of: nothing is decided without them.
        turns = {places[t.number].turn + len(t.curve) for t in trials if t.state == "running"}
        if len(turns) < 2:
            _decide(sweep, phase, study, trials)
            _fill(sweep, phase, study)
            trials, places = study.trials(), study.places()
            turns = {places[t.number].turn + len(t.curve) for t in trials if t.state == "running"}
        if not turns:
            engine.forget([unit.name for unit, _ in phase.units])
            report(f"{phase.name}: done")
            return
        behind = {
            trial.number: trial for trial in trials
            if trial.state == "running" and places[trial.number].turn + len(trial.curve) == min(turns)
        }  # fmt: skip
        if not any(trial.curve for trial in trials):
            report(f"{phase.name}: the first round compiles")
        jobs = _jobs(phase, trials, places, behind)
        found = engine.advance(jobs, _counter(report, phase.name, len(jobs), len(trials), len(behind)))
        for (unit, _, _), result in zip(jobs, found, strict=True):
            there = [t for t in trials if t.state == "running" and places[t.number].unit == unit.name]
            for trial in there:
                if trial.number in behind:
                    study.report(trial, *_row(sweep, unit, trial, places[trial.number].slot, result, len(there)))


def _check_members(sweep, study):
    """UserError: a sweep goes on with fewer slots than trials still train in."""
    for trial, place in zip(study.trials(), study.places().values(), strict=True):
        if trial.state == "running" and place.slot >= sweep.members:
            raise UserError(
                f"members is {sweep.members}, but trial {trial.number} trains in slot {place.slot} of its population: "
                "give as many as before until it has ended"
            )


def _jobs(phase, trials, places, behind):
    """(unit, round, fills) of the populations of trials that are to go a round further."""
    jobs = []
    for unit, _ in phase.units:
        there = [trial for trial in trials if places[trial.number].unit == unit.name]
        rounds = {places[trial.number].round + len(trial.curve) for trial in there if trial.number in behind}
        if rounds:
            (round,) = rounds
            fills = [
                SlotFill(places[t.number].round, places[t.number].slot, t.seed, {n: t.values[n] for n in unit.floats})
                for t in there
                if places[t.number].slot < unit.members  # others have ended, when there were more slots
            ]
            jobs.append((unit, round, sorted(fills, key=lambda fill: fill.round)))
    return jobs


def _counter(report, name, populations, begun, training):
    """What an engine calls after each population."""
    back = 0

    def done():
        nonlocal back
        back += 1
        report(f"{name}: {begun} begun, {training} train; population {back} of {populations} is back")

    return done


def _row(sweep, unit, trial, slot, result, members):
    """(steps of all episodes since the trial began, row of its curve)."""
    step = (len(trial.curve) + 1) * unit.round_steps
    broken, scenes = result.broken[slot], result.scenes[slot]
    return step, {
        "env_steps": step * unit.config.train.episodes,
        "objective": None if broken else _objective(sweep, scenes),
        "scenes": scenes,
        "losses": result.losses[slot],
        "broken": broken,
        "seconds": round(result.seconds / members, 3),
        "device": result.device,
    }


def _objective(sweep, scenes):
    """A finite number. UserError: somebody's function gives none."""
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


def _decide(sweep, phase, study, trials):
    """End the trials that broke, have come to their end, or are not among the best at a rung."""
    episodes = sweep.base.train.episodes
    sign = 1 if sweep.direction == "maximize" else -1
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
                (-sign * row["objective"], other.number) for other in trials for row in other.curve
                if row["env_steps"] == last["env_steps"] and row["objective"] is not None
            ]  # fmt: skip
            better = sum(other < (-sign * last["objective"], trial.number) for other in came)  # of equals the earlier
            if better >= math.ceil(sweep.keep * len(came)):
                study.end(trial, "stopped")


def _fill(sweep, phase, study):
    """Begin trials in free slots, populations in turn."""
    trials, places = study.trials(), study.places()
    number = len(trials)
    taken = {(places[t.number].unit, places[t.number].slot) for t in trials if t.state == "running"}
    free = [
        (slot, unit, sizes) for slot in range(sweep.members) for unit, sizes in phase.units
        if (unit.name, slot) not in taken
    ]  # fmt: skip
    turn = max((places[t.number].turn + len(t.curve) for t in trials), default=0)
    if not free:
        return
    propose = phase.proposals(study, trials)
    for slot, unit, sizes in free:
        job = propose(sizes, number)
        if job is None:
            continue
        ages = [places[t.number].round + len(t.curve) for t in trials if places[t.number].unit == unit.name]
        study.add(job.values, phase.kinds, job.seed, job.of, Place(unit.name, slot, max(ages, default=0), turn))
        number += 1
