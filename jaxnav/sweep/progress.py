"""The progress of a sweep: its trials in order, how many are planned, and what is missing."""

import collections
import math
from typing import Any

from .results import PHASES, Results, Trial

STATES = ("running", "stopped", "broken", "complete")


def is_measured(trial: Trial) -> bool:
    """Whether a trial has an objective that can be compared."""
    return trial.objective is not None and math.isfinite(trial.objective)


def better_first(trial: Trial, sign: int) -> tuple[float, float, int]:
    """A key that sorts trials of the same length, the best first; of equal ones the one that was as good sooner."""
    known = [row["objective"] for row in trial.curve if row["objective"] is not None]
    return -sign * trial.score, -sign * sum(known) / max(1, len(known)), trial.number


def plain(values: dict[str, Any]) -> dict[str, Any]:
    """Values as JSON returns them."""
    return {name: list(value) if isinstance(value, tuple) else value for name, value in values.items()}


def base_values(identity: dict[str, Any]) -> dict[str, Any]:
    """Values of base, by the searched names."""
    found = {}
    for name in (*identity["sizes"], *identity["space"]):
        value = identity["base"]
        for part in name.split("."):
            value = value[part]
        found[name] = value
    return found


def env_steps(trial: Trial) -> int:
    """Steps that a trial was trained for."""
    return trial.curve[-1]["env_steps"] if trial.curve else 0


def ranked(results: Results) -> list[Trial]:
    """Trials of the search with an objective but for broken ones, the longest first, of equally long ones the best."""
    known = [trial for trial in _trials(results, "search") if trial.state != "broken" and is_measured(trial)]
    return sorted(
        known, key=lambda trial: (-env_steps(trial), trial.state != "complete", better_first(trial, results.sign))
    )


def completed(results: Results) -> list[Trial]:
    """Complete trials of the search, the best first."""
    return [trial for trial in ranked(results) if trial.state == "complete"]


def by_candidate(results: Results, phase: str) -> dict[int | None, dict[int, Trial]]:
    """Trials of a phase: {number of the candidate, None for base: {seed: trial}}."""
    found = collections.defaultdict(dict)
    for trial in _trials(results, phase):
        found[trial.of][trial.seed] = trial
    return found


def counts(results: Results, phase: str) -> dict[str, int]:
    """Numbers of trials of a phase: asked for, begun, and in each state; the states add up to those begun."""
    states = collections.Counter(trial.state for trial in _trials(results, phase))
    asked = _places(results, phase) * results.budget["seeds"] if phase != "search" else results.budget["trials"]
    return {"asked": asked, "begun": states.total(), **dict.fromkeys(STATES, 0), **states}


def missing(results: Results) -> list[str]:
    """Unfinished parts, in words."""
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


def _trials(results: Results, phase: str) -> list[Trial]:
    return results.phases.get(phase, [])


def _places(results: Results, phase: str) -> int:
    """Number of candidates of a later phase, base among them: fewer than asked for where fewer trials are complete."""
    asked = results.budget["confirm"]
    if not asked or (phase == "guard" and not results.identity["guard"]):
        return 0
    search = _trials(results, "search")
    is_over = len(search) >= results.budget["trials"] and all(trial.state != "running" for trial in search)
    return 1 + (min(asked, len(_eligible(results))) if is_over else asked)


def _eligible(results: Results) -> list[Trial]:
    """Complete trials, the best first, without those that have the values of base, which is confirmed anyway."""
    base = base_values(results.identity)
    return [trial for trial in completed(results) if plain(trial.values) != base]


def _done(results: Results, phase: str) -> int:
    """Number of candidates that have ended with all of their seeds.

    Candidates from before the search was given more trials don't replace those that are due now.
    """
    ended = {
        of
        for of, trials in by_candidate(results, phase).items()
        if sum(trial.state != "running" for trial in trials.values()) >= results.budget["seeds"]
    }
    due = {None} | _due(results)
    return len(ended & due) + min(len(ended - due), _places(results, phase) - len(due))


def _due(results: Results) -> set[int]:
    """Numbers of the trials that have to be confirmed, whichever of equally good ones has the last place."""
    eligible, asked = _eligible(results), results.budget["confirm"]
    if len(eligible) <= asked:
        return {trial.number for trial in eligible}
    last = better_first(eligible[asked - 1], results.sign)[0]
    return {trial.number for trial in eligible if better_first(trial, results.sign)[0] < last}
