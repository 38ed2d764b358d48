"""The bundle of a run's policy, with what the run's folder knows of where it comes from."""

import json
import pathlib
from collections.abc import Callable, Sequence
from typing import Any

from ..training.policy import Policy
from ..training.run import Run
from .bundle import write_bundle
from .contract import origin_of


def export_run(
    run: Run,
    policy: Policy,
    which: str,
    folder: pathlib.Path,
    replace: bool = False,
    add: Sequence[Callable[[pathlib.Path], object]] = (),
) -> None:
    """Write the bundle of a run's policy into ``folder``, whole or not at all.

    which: last or best; replace: whether a bundle that is there may go; add: functions that add files to it.
    UserError: the folder holds something else, can't be written, or what is to be added can't be made.
    """
    stored, evaluation = (_read(run.folder / name) for name in ("config.json", "evaluation.json"))
    if evaluation and evaluation.get("policy") != which:
        evaluation = None  # it is the other policy's
    write_bundle(run, policy.parameters, folder, origin_of(run, which, stored or {}, evaluation), replace, add)


def _read(path: pathlib.Path) -> dict[str, Any] | None:
    """A JSON file of a run; None if there is none, or it can't be read: it tells of a policy, and is no part of it."""
    try:
        return json.loads(path.read_text())
    except (OSError, ValueError):
        return None
