"""Tables on the terminal: the result of an evaluation, and that of a comparison."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from rich.console import Console
from rich.table import Table

_MOST_COLUMNS = 5  # scenes that stand side by side; more are rows

# From the metrics of a scene to the text of a cell.
_Cell = Callable[[Mapping[str, Any]], str]


def print_result(console: Console, result: Mapping[str, Any]) -> None:
    """An evaluation as a table: one column per scene, or one row where there are more than five."""
    title = f"{result['policy']} policy, {result['episodes']} episodes per scene, seed {result['seed']}"
    if "trained_in" in result:
        title += f"; trained in {', '.join(result['trained_in'])}"
    scenes = result["scenes"]
    cells = _cells(scenes)
    if len(scenes) <= _MOST_COLUMNS:
        table = Table("", title=title)
        for name in scenes:
            table.add_column(name, justify="right")
        for label, (_, cell) in cells.items():
            table.add_row(label, *(cell(metrics) for metrics in scenes.values()))
        console.print(table)
        return
    # Two tables, so that each fits into 80 columns.
    shown = list(cells.values())
    for heading, part in ((title, shown[:8]), ("robots beside it, and its requests", shown[8:])):
        table = Table(title=heading, box=None, padding=(0, 1, 0, 0), pad_edge=False)
        table.add_column("scene", overflow="fold", vertical="bottom")
        for label, _ in part:
            table.add_column(label, justify="right", vertical="bottom")
        for name, metrics in scenes.items():
            table.add_row(name, *(cell(metrics) for _, cell in part))
        console.print(table)


def print_comparison(console: Console, result: Mapping[str, Any]) -> None:
    """Print the result of `jaxnav.compare` as a table: a row per scene, with success and how far the first is ahead.

    "(open)" stands where the interval of the paired difference to the second includes 0.
    """
    names = result["players"]
    title = f"success, {result['episodes']} episodes per scene, seed {result['seed']}; the same episodes for each"
    table = Table(title=title, box=None, padding=(0, 1, 0, 0), pad_edge=False)
    table.add_column("scene", no_wrap=True)
    for name in names:
        table.add_column(name, justify="right", overflow="fold")
    table.add_column("first", overflow="fold")
    if len(names) > 2:
        table.add_column("ahead of", overflow="fold")
    table.add_column("by", justify="right")
    table.add_column("95 % interval", justify="right", no_wrap=True)
    any_open = False
    for scene, found in result["scenes"].items():
        success = {name: found["players"][name]["success"] for name in names}
        first, second, difference, (low, high) = lead(success, found["differences"])
        is_open = low <= 0 <= high
        any_open |= is_open
        table.add_row(
            scene,
            *(f"{success[name]:.3f}" for name in names),
            first + (" (open)" if is_open else ""),
            *([second] if len(names) > 2 else []),
            f"{difference:+.3f}",
            f"{low:+.3f} to {high:+.3f}",
        )
    console.print(table)
    if any_open:
        console.print(f"open: the interval includes 0, so {result['episodes']} episodes don't say which is first")


def lead(
    success: Mapping[str, float], differences: Sequence[Mapping[str, Any]]
) -> tuple[str, str, float, tuple[float, float]]:
    """(first, second, paired difference of their success, its interval) of a scene; of equals the first named."""
    first, second, *_ = sorted(success, key=lambda name: -success[name])
    for found in differences:
        low, high = found["ci95"]
        if (found["one"], found["other"]) == (first, second):
            return first, second, found["difference"], (low, high)
        if (found["one"], found["other"]) == (second, first):
            return first, second, -found["difference"], (-high, -low)
    raise ValueError(f"differences say nothing of {first} and {second}")


def _cells(scenes: Mapping[str, Any]) -> dict[str, tuple[str, _Cell]]:
    """Cells by their label in a column of labels, each with its heading where scenes are rows."""
    requests = next(iter(scenes.values()))["requests"]
    return {
        "success": ("success", lambda m: f"{m['success']:.3f}"),
        "  95 % interval": ("95 %\ninterval", lambda m: "{:.3f}-{:.3f}".format(*m["success_ci95"])),
        "collision": ("collided", lambda m: f"{m['collision']:.3f}"),
        "  with a pedestrian": ("with\nperson", lambda m: f"{m['human_collision']:.3f}"),
        "time-out": ("time\nout", lambda m: f"{m['timeout']:.3f}"),
        "steps": ("steps", lambda m: _number(m["steps"], 1)),
        "minimum distance (m)": ("distance\n(m)", lambda m: _number(m["min_distance"], 2)),
        "comfort space kept": ("comfort", lambda m: f"{m['comfort']:.3f}"),
        "straight line: success": ("straight\nline", lambda m: f"{m['straight_line_success']:.3f}"),
        "muted: success": ("muted", lambda m: f"{m['muted_success']:.3f}"),
        "muted: minimum distance (m)": ("muted\n(m)", lambda m: _number(m["muted_min_distance"], 2)),
        **{
            f"asked: {request}": (f"asked:\n{request}", lambda m, request=request: f"{m['requests'][request]:.3f}")
            for request in requests
        },
        "pedestrian complied": ("complied", lambda m: _number(m["complied"], 3)),
    }


def _number(value: float | None, digits: int) -> str:
    return "-" if value is None else f"{value:.{digits}f}"
