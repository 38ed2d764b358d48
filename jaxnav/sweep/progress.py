"""How far a sweep has come: its trials in order, how many there are to be, and what is missing."""

import collections
import math
from typing import Any

from .results import PHASES

STATES = ("running", "stopped", "broken", "complete")


def is_measured(trial):
    """Whether it has an objective that can be compared."""
    return trial.objective is not None and math.isfinite(trial.objective)


def better_first(trial, sign):
    """A key that sorts trials of the same length, the best first: of equals, who has been as good sooner."""
    known = [row["objective"] for row in trial.curve if row["objective"] is not None]
    return -sign * trial.objective, -sign * sum(known) / max(1, len(known)), trial.number


def sign(results):
    """1 where most of the objective is best, -1 where least of it is."""
    return 1 if results.identity["direction"] == "maximize" else -1


def plain(values):
    """Values as JSON gives them back."""
    return {name: list(value) if isinstance(value, tuple) else value for name, value in values.items()}


def base_values(identity):
    """Values of base by the names that are searched."""
    found = {}
    for name in (*identity["sizes"], *identity["space"]):
        value = identity["base"]
        for part in name.split("."):
            value = value[part]
        found[name] = value
    return found


def env_steps(trial):
    """How far it was trained."""
    return trial.curve[-1]["env_steps"] if trial.curve else 0


def ranked(results) -> list[Any]:
    """Trials of the search with an objective, the furthest first, and of those as far the best; no broken ones."""
    known = [trial for trial in _trials(results, "search") if trial.state != "broken" and is_measured(trial)]
    return sorted(
        known, key=lambda trial: (-env_steps(trial), trial.state != "complete", better_first(trial, sign(results)))
    )


def completed(results):
    """Complete trials of the search, the best first."""
    return [trial for trial in ranked(results) if trial.state == "complete"]


def by_candidate(results, phase):
    """Trials of a phase: {number of the candidate, None for base: {seed: trial}}."""
    found = collections.defaultdict(dict)
    for trial in _trials(results, phase):
        found[trial.of][trial.seed] = trial
    return found


def counts(results, phase):
    """Trials of a phase: asked for, begun, and in each state; the states add up to those begun."""
    states = collections.Counter(trial.state for trial in _trials(results, phase))
    asked = _places(results, phase) * results.budget["seeds"] if phase != "search" else results.budget["trials"]
    return {"asked": asked, "begun": states.total(), **dict.fromkeys(STATES, 0), **states}


def missing(results) -> list[str]:
    """What is unfinished, in words; nothing if nothing is."""
    begun, asked, seeds = len(_trials(results, "search")), results.budget["trials"], results.budget["seeds"]
    found = [f"{asked - begun} of {asked} trials of the search have not begun"] if begun < asked else []
    for phase, words in zip(
        PHASES, ("trials of the search", "confirming trainings", "trainings of the guard"), strict=True
    ):
        if phase != "search" and not _places(results, phase):
            continue  # begun when it was still asked for
        running = sum(trial.state == "running" for trial in _trials(results, phase))
        found += [f"{running} {words} still run"] if running else []
    for phase, words in (("confirm", "confirmed"), ("guard", "seen by the guard")):
        places = _places(results, phase)
        done = _done(results, phase) if places else 0
        if done < places:
            found.append(f"{done} of {places} candidates, base among them, were {words} with all of {seeds} seeds")
    return found


def _trials(results, phase):
    return results.phases.get(phase, [])


def _places(results, phase):
    """How many a phase after the search is to train, base among them: fewer than asked for where fewer are complete."""
    asked = results.budget["confirm"]
    if not asked or (phase == "guard" and not results.identity["guard"]):
        return 0
    search = _trials(results, "search")
    is_over = len(search) >= results.budget["trials"] and all(trial.state != "running" for trial in search)
    return 1 + (min(asked, len(_eligible(results))) if is_over else asked)


def _eligible(results):
    """Complete trials, the best first; not those that have the values of base, which is confirmed anyway."""
    base = base_values(results.identity)
    return [trial for trial in completed(results) if plain(trial.values) != base]


def _done(results, phase):
    """How many have ended with all of their seeds. Others, from before the search was given more trials, don't make up
    for those that have to be there now."""
    ended = {
        of
        for of, trials in by_candidate(results, phase).items()
        if sum(trial.state != "running" for trial in trials.values()) >= results.budget["seeds"]
    }
    due = {None} | _due(results)
    return len(ended & due) + min(len(ended - due), _places(results, phase) - len(due))


def _due(results):
    """Numbers of the trials that have to be confirmed, whichever of equal ones has the last place."""
    eligible, asked = _eligible(results), results.budget["confirm"]
    if len(eligible) <= asked:
        return {trial.number for trial in eligible}
    better, last = sign(results), eligible[asked - 1].objective
    return {trial.number for trial in eligible if better * trial.objective > better * last}
