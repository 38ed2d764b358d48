"""Write docs/configuration.md: every field of a run, with default, unit, range and meaning.

python .ci/configuration.py
"""

import dataclasses
import pathlib
from collections.abc import Iterator

import numpy as np

from jaxnav.agents import LEARNERS
from jaxnav.fields import Rule, rows
from jaxnav.training.config import PRESETS, RunConfig, preset, run_class

PATH = pathlib.Path(__file__).parent.parent / "docs" / "configuration.md"

_HEAD = """# Configuration

Written by `python .ci/configuration.py` from the fields themselves (`jaxnav/fields.py`); a test holds the two together.
Each is an option of `jaxnav train`, where `_` is `-`: `world.params.max_v` is `--world.params.max-v`. Defaults are
those of the preset quick; the presets change what the last table says. A part, such as a reward, is chosen by the name
under which it was registered, or by `file.py:NAME`.
"""


def text() -> str:
    """The whole page."""
    blocks = [_HEAD]
    for title, found in _groups().items():
        blocks.append(f"## {title}\n")
        blocks.append("| field | default | unit | range | meaning |\n|---|---|---|---|---|")
        blocks[-1] += "".join(
            f"\n| `{name}` | {_value(default)} | {rule.unit} | {rule.allowed} | {rule.doc} |"
            for name, default, rule in found
        )
        blocks[-1] += "\n"
    blocks.append("## What the presets change, beside quick\n")
    blocks.append("\n".join(_changes()) + "\n")
    return "\n".join(blocks)


def _groups() -> dict[str, list[tuple[str, object, Rule]]]:
    groups: dict[str, list[tuple[str, object, Rule]]] = {}
    titles = {"world.params": "World: floats", "world": "World: sizes and switches", "train": "Training loop"}
    for name, default, rule in rows(RunConfig):
        if name in ("agent", "hyper"):
            continue
        title = titles.get(name.rpartition(".")[0], "Run")
        groups.setdefault(title, []).append((name, default, rule))
    for algo, learner in LEARNERS.items():
        groups[f"Learner {algo}: sizes"] = list(rows(learner.config, "agent"))
        groups[f"Learner {algo}: floats"] = list(rows(learner.hyper, "hyper"))
    return groups


def _changes() -> Iterator[str]:
    """A line of each preset and learner with the fields that differ from quick's."""
    yield "| preset | learner | fields |\n|---|---|---|"
    for name in PRESETS:
        for algo in LEARNERS:
            usual = dict(_leaves(run_class(algo)())) if name == "quick" else dict(_leaves(preset("quick", algo)))
            changed = [
                f"`{field}` {_value(value)}"
                for field, value in _leaves(preset(name, algo))
                if field not in ("preset", "algo") and value != usual[field]
            ]
            if changed:
                yield f"| {name} | {algo} | {', '.join(changed)} |"


def _leaves(config, prefix: str = "") -> Iterator[tuple[str, object]]:
    for field in dataclasses.fields(config):
        value, name = getattr(config, field.name), f"{prefix}.{field.name}".lstrip(".")
        if dataclasses.is_dataclass(value):
            yield from _leaves(value, name)
        else:
            yield name, float(value) if isinstance(value, np.floating) else value


def _value(value: object) -> str:
    """A value as the command line takes it."""
    if isinstance(value, tuple):
        return " ".join(map(_value, value)) or "none"
    return str(value) or "none"


if __name__ == "__main__":
    PATH.write_text(text())
