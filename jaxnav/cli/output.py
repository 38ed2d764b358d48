"""What the terminal shows: how training goes, and what an evaluation came to."""

import contextlib

from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Table


@contextlib.contextmanager
def training_progress(config, console):
    """Yields the function that shows a line of metrics: a bar on a terminal, else a line an evaluation."""
    total = config.train.total_steps * config.train.episodes
    if not console.is_terminal:

        def print_line(line):
            if "evaluation" in line:
                left = (total / line["env_steps"] - 1.0) * line["wall_seconds"]
                text = f"{line['env_steps'] / total:4.0%}  {_progress_text(line)}, {left:.0f} s left"
                console.print(text, soft_wrap=True)

        yield print_line
        return
    columns = (
        TextColumn("{task.description}"), BarColumn(), TextColumn("{task.fields[state]}"), TimeElapsedColumn(),
        TextColumn("left"), TimeRemainingColumn(),
    )  # fmt: skip
    with Progress(*columns, console=console) as bar:
        task = bar.add_task("training", total=total, state="compiling")
        yield lambda line: bar.update(task, completed=line["env_steps"], state=_progress_text(line))


def _progress_text(line):
    success = line.get("evaluation") or line["success"]
    shares = ", ".join(f"{scene} {'-' if rate is None else f'{rate:.3f}'}" for scene, rate in success.items())
    return f"{line['env_steps'] / 1000:.0f}k steps, {line['updates']} updates, success {shares}"


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
