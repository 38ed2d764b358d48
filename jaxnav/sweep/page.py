"""The summary of a sweep as Markdown, to be read in a minute."""

import pathlib
import re
import shlex
from collections.abc import Sequence
from typing import Any

from .numbers import name_of, number, searched, with_interval

Summary = dict[str, Any]


def markdown(summary: Summary, folder: str | pathlib.Path) -> str:
    """The text of summary.md. summary: of `report.summarise`; folder: the sweep's, as commands name it."""
    sections = (_confirmed, _importance, _best, _counts, _provenance)
    lines = [f"# Sweep {_text(summary['name'])}", "", _text(summary["answer"]), "", "![What was found](summary.png)"]
    for section in sections:
        lines += ["", *section(summary)]
    where = shlex.quote(str(folder))
    lines += ["", "## What to do with it", "", "Train with the winner, and write this report anew:", ""]
    lines += [f"    jaxnav train --from-sweep {where}", f"    jaxnav sweep --report {where}"]
    return "\n".join(lines) + "\n"


def _text(text: object) -> str:
    """The text escaped for Markdown, on one line and for one cell."""
    text = " ".join(str(text).split())
    return re.sub(r"([\\`*{}\[\]<>|~#&!$]|(?<![0-9A-Za-z])_|_(?![0-9A-Za-z]))", r"\\\1", text)


def _table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    return [f"| {' | '.join(cells)} |" for cells in (header, ["---"] * len(header), *rows)]


def _values(row: dict[str, Any], names: Sequence[str]) -> list[str]:
    return [_text(searched(row["values"][name])) if name in row["values"] else "-" for name in names]


def _names(rows: Sequence[dict[str, Any]]) -> list[str]:
    """The names of all values in the rows."""
    return list(dict.fromkeys(name for row in rows for name in row["values"]))


def _confirmed(summary: Summary) -> list[str]:
    rows, seeds = summary["confirmed"], summary["budget"]["seeds"]
    if not rows:
        return ["## Confirmed", "", "Nothing was trained again yet." if summary["budget"]["confirm"] else
                "Nothing was trained again: the sweep asks for no confirmation."]  # fmt: skip
    names, scenes = _names(rows), list(dict.fromkeys(scene for row in rows for scene in row["success"]))
    best = "highest" if summary["direction"] == "maximize" else "lowest"
    header = ["", *(f"`{name}`" for name in names), _text(summary["objective"]), "difference to base"]
    header += [f"success in {_text(scene)}" for scene in scenes]
    header += ["steps in the guard"] * bool(summary["guard"])
    lines = [
        "## Confirmed", "",
        f"Trained again from the beginning with {seeds} fresh seed{'s' * (seeds != 1)} each, the same for all, and "
        f"judged on episodes that the search never saw. The {best} mean wins. In brackets: 95 % bootstrap intervals of "
        "means over seeds; differences are paired by seed.",
        "",
    ]  # fmt: skip
    lines += _table(header, [_candidate(row, names, scenes, summary["guard"]) for row in rows])
    lines += [f"\n{_broken(row)}" for row in rows if row["broken"]]
    return lines + _guard(summary)


def _candidate(
    row: dict[str, Any], names: Sequence[str], scenes: Sequence[str], guard: dict[str, Any] | None
) -> list[str]:
    cells = [name_of(row["trial"]), *_values(row, names), with_interval(*_mean(row["objective"]))]
    cells.append("" if row["trial"] is None else with_interval(*_mean(row["difference"]), signed=True))
    cells += [with_interval(*_mean(row["success"].get(scene))) for scene in scenes]
    return cells + ([_steps(row["guard"])] if guard else [])


def _mean(measure: dict[str, Any] | None) -> tuple[float | None, Sequence[float] | None]:
    return (measure["mean"], measure["ci95"]) if measure else (None, None)


def _broken(row: dict[str, Any]) -> str:
    name = name_of(row["trial"]).capitalize()
    text = f"The numbers of {row['broken']} of the {len(row['seeds'])} trainings of {name.lower()} turned non-finite: "
    return text + ("the others speak for it." if row["trial"] is None else "it can't win.")


def _steps(measure: dict[str, Any]) -> str:
    if measure["mean"] is None:
        return "-"
    seeds = len(measure["per_seed"])
    text = f"{measure['mean']:,.0f}"
    if measure["ci95"]:
        text += " ({:,.0f} to {:,.0f})".format(*measure["ci95"])
    if measure["reached"] < seeds:
        text = f"at least {text}; {measure['reached']} of {seeds} seeds reached it"
    return text + {True: "", False: "; fails", None: ""}[measure["passes"]]


def _guard(summary: Summary) -> list[str]:
    guard = summary["guard"]
    if not guard:
        return []
    text = (
        f"The guard: env steps after which every scene of {_text(guard['scene'])} has a success of "
        f"{guard['reaches']:g}, in a training of its own for each candidate and seed. "
        f"One that needs more than {guard['slack']:g} times the mean of base"
    )
    text += f", {guard['limit']:,.0f}, " if guard["limit"] is not None else " "
    text += "can't win."
    if any(row["guard"]["reached"] < len(row["guard"]["per_seed"]) for row in summary["confirmed"]):
        text += " A seed that never reached it counts with all of its steps, so that its mean is a lower bound."
    return ["", text]


def _importance(summary: Summary) -> list[str]:
    found = summary["importance"]
    lines = ["## What mattered", ""]
    if found["shares"] is None:
        return [*lines, f"Not known: {found['why']}."]
    lines += [
        f"Optuna's PED-ANOVA over {found['trials']} trials: how far the values of the {found['better']} better ones "
        f"stand out from those of all. Trials are compared after {found['env_steps']:,} env steps, which stopped ones "
        "have, too; broken ones, and those with values outside of the space, are left out. A share says that a value "
        "mattered, not which way.",
        "",
    ]
    return lines + _table(["", "share"], [[f"`{name}`", f"{share:.0%}"] for name, share in found["shares"].items()])


def _best(summary: Summary) -> list[str]:
    rows, names = summary["best"], _names(summary["best"])
    lines = ["## Best of the search", ""]
    if not rows:
        return [*lines, "No trial has been judged yet."]
    lines += ["One seed each; those first that came furthest. The best of many single seeds is partly luck.", ""]
    header = ["", "state", *(f"`{name}`" for name in names), _text(summary["objective"]), "env steps"]
    return lines + _table(
        header,
        [
            [str(row["trial"]), row["state"], *_values(row, names), number(row["objective"]), f"{row['env_steps']:,}"]
            for row in rows
        ],
    )


def _counts(summary: Summary) -> list[str]:
    counts, hours = summary["counts"], summary["device_hours"]
    states = list(dict.fromkeys(state for found in counts.values() for state in found))
    rows = [
        [phase, *(str(found.get(state, 0)) for state in states), f"{hours[phase]:.2f}"]
        for phase, found in counts.items()
        if found["asked"] or found["begun"]
    ]
    total = sum(hours.values())
    return [
        "## Trials and cost",
        "",
        f"{total:.2f} device-hours, compilation aside.",
        "",
        *_table(["", *states, "device-hours"], rows),
    ]


def _provenance(summary: Summary) -> list[str]:
    lines = ["## Made with", ""]
    for run in summary["runs"]:
        versions = ", ".join(f"{name} {version}" for name, version in run["versions"].items() if version)
        commit = _text(run["git_commit"] or "unknown")
        lines.append(f"- {_text(run['device'])}; commit {commit}; {_text(versions)}")
    lines.append("")
    for phase, devices in summary["devices"].items():
        counts = ", ".join(f"{count} ended on {_text(device)}" for device, count in devices.items())
        lines.append(f"- {phase}: {counts}")
    return lines
