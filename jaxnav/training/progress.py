"""The progress of a training, as a terminal or a notebook shows it."""

import contextlib
from collections.abc import Callable, Iterator
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from .config import RunConfig


@contextlib.contextmanager
def training_progress(config: RunConfig, console: Console) -> Iterator[Callable[[dict[str, Any]], object]]:
    """Yields a function that shows a line of metrics: a bar on a terminal, elsewhere a line for each evaluation."""
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


def _progress_text(line: dict[str, Any]) -> str:
    success = line.get("evaluation") or line["success"]
    shares = ", ".join(f"{scene} {'-' if rate is None else f'{rate:.3f}'}" for scene, rate in success.items())
    return f"{line['env_steps'] / 1000:.0f}k steps, {line['updates']} updates, success {shares}"
