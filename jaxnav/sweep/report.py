"""The report of a sweep: which values won, how certain that is, which mattered, and the cost."""

import collections
import io
import pathlib
from typing import Any

from ..files import write_atomically, write_json
from ..statistics import measure
from . import page, progress
from .answer import answer, unfit
from .figure import figure_of
from .importance import importance
from .results import PHASES, Results, Trial

BySeed = dict[int, Trial]


def write(results: Results, folder: str | pathlib.Path) -> dict[str, Any]:
    """Write summary.json, summary.md and summary.png into ``folder``, each whole or not at all. Returns the summary.

    UserError: one can't be written.
    """
    summary, folder, picture = summarise(results), pathlib.Path(folder), io.BytesIO()
    figure_of(results, summary).savefig(picture, format="png")
    write_json(folder / "summary.json", summary)
    write_atomically(folder / "summary.md", page.markdown(summary, folder))
    write_atomically(folder / "summary.png", picture.getvalue())
    return summary


def summarise(results: Results) -> dict[str, Any]:
    """The results in numbers, as plain JSON.

    Measurements are those of `statistics.measure`.

    answer:       a sentence or two.
    missing:      unfinished parts, in words.
    winner:       None while a part is missing, else trial (None for base), values, objective, ci95, seeds, and
                  beats_base (None without a confirmation).
    counts:       for each phase the trials asked for, begun, and in each state.
    confirmed:    base and the candidates, the best first.
    guard:        its limit in env steps.
    importance:   `importance.importance`.
    device_hours: by phase.
    best:         ten trials of the search, the longest first.
    """
    guard = results.identity["guard"] if results.budget["confirm"] else None
    confirmed = _confirmed(results, guard)
    missing = progress.missing(results)
    winner = None if missing else _winner(results, confirmed)
    summary = {
        "name": results.name,
        "objective": results.identity["objective"],
        "direction": results.identity["direction"],
        "missing": missing,
        "winner": winner,
        "counts": {phase: progress.counts(results, phase) for phase in PHASES},
        "confirmed": confirmed,
        "guard": guard and guard | {"limit": _limit(confirmed, guard)},
        "importance": importance(results),
        "device_hours": {
            phase: sum(trial.seconds for trial in results.phases.get(phase, ())) / 3600 for phase in PHASES
        },
        "best": [_searched(trial) for trial in progress.ranked(results)[:10]],
        "budget": dict(results.budget),
        "runs": results.runs,
        "devices": {
            phase: dict(collections.Counter(trial.device for trial in trials if trial.device))
            for phase, trials in results.phases.items()
            if trials
        },
    }
    return {"answer": answer(summary), **summary}


def _searched(trial: Trial) -> dict[str, Any]:
    found = {"trial": trial.number, "state": trial.state, "seed": trial.seed, "values": progress.plain(trial.values)}
    return found | {"objective": trial.objective, "env_steps": progress.env_steps(trial)}


def _confirmed(results: Results, guard: dict[str, Any] | None) -> list[dict[str, Any]]:
    """Base first, then the candidates, the best mean first."""
    confirm, guarded = (progress.by_candidate(results, phase) for phase in ("confirm", "guard"))
    base = confirm.get(None, {})
    rows = [_candidate(results, of, confirm[of], base, guarded.get(of, {}), guard) for of in confirm]
    if guard:
        limit = _limit(rows, guard)
        for row in rows:
            known = limit is not None and row["guard"]["mean"] is not None
            row["guard"]["passes"] = True if row["trial"] is None else row["guard"]["mean"] <= limit if known else None
    unknown = float("inf")
    return sorted(
        rows,
        key=lambda row: (
            row["trial"] is not None,
            unknown if row["objective"]["mean"] is None else -results.sign * row["objective"]["mean"],
        ),
    )


def _candidate(
    results: Results, of: int | None, trials: BySeed, base: BySeed, guarded: BySeed, guard: dict[str, Any] | None
) -> dict[str, Any]:
    seeds = sorted(trials)
    objectives, others = _objectives(trials), _objectives(base)
    scenes = list(dict.fromkeys(name for seed in seeds for name in _last(trials[seed])))
    values = progress.base_values(results.identity) if of is None else next(iter(trials.values())).values
    paired = [objectives[seed] - others[seed] for seed in seeds if seed in objectives and seed in others]
    return {
        "trial": of,
        "values": progress.plain(values),
        "seeds": seeds,
        "lacks": max(0, results.budget["seeds"] - len(seeds)),
        "broken": sum(trial.state == "broken" for trial in trials.values()),
        "objective": measure([objectives.get(seed) for seed in seeds]),
        "difference": None if of is None else measure(paired),
        "success": {
            name: measure([_last(trials[seed]).get(name, {}).get("success") for seed in seeds]) for name in scenes
        },
        "guard": guard and _steps(results, guarded, guard),
    }


def _objectives(trials: BySeed) -> dict[int, float]:
    ended = {seed: trial for seed, trial in trials.items() if trial.state == "complete"}
    return {seed: trial.score for seed, trial in ended.items() if progress.is_measured(trial)}


def _last(trial: Trial) -> dict[str, Any]:
    """Metrics by scene of a complete trial at its end."""
    rows = [row["scenes"] for row in trial.curve if row["scenes"]]
    return rows[-1] if rows and trial.state == "complete" else {}


def _steps(results: Results, trials: BySeed, guard: dict[str, Any]) -> dict[str, Any]:
    """Env steps to the guard's success; a seed that never reached it counts with all of its steps."""
    ended = [trials[seed] for seed in sorted(trials) if trials[seed].state != "running"]
    reached = [_reached(trial, guard["reaches"]) for trial in ended]
    most = guard["total_steps"] * results.identity["base"]["train"]["episodes"]
    found = measure([most if steps is None else steps for steps in reached])
    return found | {"per_seed": reached, "reached": sum(steps is not None for steps in reached), "passes": None}


def _reached(trial: Trial, success: float) -> int | None:
    for row in trial.curve:
        if row["scenes"] and all(metrics["success"] >= success for metrics in row["scenes"].values()):
            return row["env_steps"]
    return None


def _limit(rows: list[dict[str, Any]], guard: dict[str, Any]) -> float | None:
    """The most env steps with which a candidate passes; None before base has been measured."""
    means = [row["guard"]["mean"] for row in rows if row["trial"] is None]
    return guard["slack"] * means[0] if means and means[0] is not None else None


def _winner(results: Results, confirmed: list[dict[str, Any]]) -> dict[str, Any] | None:
    """The winner, None if no trial is complete."""
    if not results.budget["confirm"]:
        searched = [_searched(trial) for trial in progress.completed(results)[:1]]
        kept = ("trial", "values", "objective")
        one_seed = {"ci95": None, "seeds": 1, "beats_base": None}
        return {name: searched[0][name] for name in kept} | one_seed if searched else None
    fit = [row for row in confirmed if row["objective"]["mean"] is not None and not unfit(row)]
    if not fit:
        return None
    best = max(fit, key=lambda row: results.sign * row["objective"]["mean"])  # of equally good ones base, the first
    return {
        "trial": best["trial"],
        "values": best["values"],
        "objective": best["objective"]["mean"],
        "ci95": best["objective"]["ci95"],
        "seeds": len(best["seeds"]),
        "beats_base": _is_better(best["difference"], results.sign),
    }


def _is_better(difference: dict[str, Any] | None, sign: int) -> bool | None:
    """Whether the whole interval of the difference lies on the better side of 0; None for base itself."""
    if difference is None:
        return None
    return difference["ci95"] is not None and min(sign * end for end in difference["ci95"]) > 0
