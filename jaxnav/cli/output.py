"""The result of an evaluation, as the terminal shows it."""

from rich.table import Table


def print_result(console, result):
    """The evaluation as a table: a column a scene."""
    table = Table(title=f"{result['policy']} policy, {result['episodes']} episodes a scene, seed {result['seed']}")
    table.add_column("")
    for name in result["scenes"]:
        table.add_column(name, justify="right")
    requests = next(iter(result["scenes"].values()))["requests"]
    rows = {
        "success": lambda m: f"{m['success']:.3f}",
        "  95 % interval": lambda m: "{:.3f} - {:.3f}".format(*m["success_ci95"]),
        "collision": lambda m: f"{m['collision']:.3f}",
        "  with a pedestrian": lambda m: f"{m['human_collision']:.3f}",
        "time-out": lambda m: f"{m['timeout']:.3f}",
        "steps": lambda m: _number(m["steps"], 1),
        "minimum distance (m)": lambda m: _number(m["min_distance"], 2),
        "comfort space kept": lambda m: f"{m['comfort']:.3f}",
        "straight line: success": lambda m: f"{m['straight_line_success']:.3f}",
        "muted: success": lambda m: f"{m['muted_success']:.3f}",
        "muted: minimum distance (m)": lambda m: _number(m["muted_min_distance"], 2),
        **{f"asked: {request}": lambda m, request=request: f"{m['requests'][request]:.3f}" for request in requests},
        "pedestrian complied": lambda m: _number(m["complied"], 3),
    }
    for label, cell in rows.items():
        table.add_row(label, *(cell(metrics) for metrics in result["scenes"].values()))
    console.print(table)


def _number(value, digits):
    return "-" if value is None else f"{value:.{digits}f}"
