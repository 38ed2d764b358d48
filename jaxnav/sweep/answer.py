"""The answer of a sweep in a sentence or two: a candidate only beats base if the interval excludes 0."""

from typing import Any

from ..statistics import sign
from .numbers import name_of, number, with_interval


def answer(summary: dict[str, Any]) -> str:
    """The answer in plain words. summary: of `report.summarise`."""
    winner, name = summary["winner"], summary["objective"]
    if summary["missing"]:
        return f"No winner yet: {'; '.join(summary['missing'])}."
    if winner is None:
        phase = "confirmation" if summary["budget"]["confirm"] else "search"
        return f"No winner: nothing in the {phase} came to its end."
    if not summary["budget"]["confirm"]:
        return (
            f"{_name(winner['trial'])} has the best {name} of the search, {number(winner['objective'])}. "
            "One seed chose it, and nothing was trained again: expect less of other seeds."
        )
    rows = {row["trial"]: row for row in summary["confirmed"]}
    found = f"{with_interval(winner['objective'], winner['ci95'])} over {_seeds(winner['seeds'])}"
    sentences = [
        f"Nothing better than base was found among {len(rows) - 1} candidates: the {name} of base is {found}."
        if winner["trial"] is None
        else f"{_name(winner['trial'])} wins: its {name} is {found}. {_against_base(rows, winner)}"
        + " It passes the guard." * bool(summary["guard"])
    ]
    better = sign(summary["direction"])
    for row in rows.values():
        mean = row["objective"]["mean"]
        if mean is not None and better * mean > better * winner["objective"]:
            sentences.append(f"{_name(row['trial'])} has {number(mean)}, but {unfit(row)}.")
    return " ".join(sentences)


def _name(trial: int | None) -> str:
    return name_of(trial).capitalize()


def _seeds(count: int) -> str:
    return "one fresh seed" if count == 1 else f"{count} fresh seeds"


def _against_base(rows: dict[int | None, Any], winner: dict[str, Any]) -> str:
    difference, base = rows[winner["trial"]]["difference"], rows[None]["objective"]["mean"]
    if base is None or difference["mean"] is None:
        return "Whether it is better than base is open: no seed of base came to its end."
    delta = with_interval(difference["mean"], difference["ci95"], signed=True)
    if winner["beats_base"]:
        return f"It beats base, which has {number(base)}: the difference over the same seeds is {delta}."
    if difference["ci95"] is None:
        why = "one seed has no interval"
    else:
        low, high = difference["ci95"]
        why = "the interval holds 0" if low <= 0 <= high else "base lacks seeds"
    return f"Base has {number(base)}; the difference over the same seeds, {delta}, is open, since {why}."


def unfit(row: dict[str, Any]) -> str:
    """The reason why a candidate can't win, "" if it can."""
    if row["trial"] is None:
        return ""
    if row["broken"]:
        return f"its numbers turned non-finite with {row['broken']} of {len(row['seeds'])} seeds"
    if row["lacks"]:
        return f"it lacks {row['lacks']} of the seeds"
    if row["guard"] and not row["guard"]["passes"]:
        mean = row["guard"]["mean"]
        return "the guard hasn't seen it" if mean is None else f"fails the guard, in which it takes {mean:,.0f} steps"
    return ""
