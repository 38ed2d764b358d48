"""A sweep's folder: sweep.json, the lock of the process that runs it, and its winner."""

import contextlib
import fcntl
import json
import pathlib
import uuid
from collections.abc import Iterator
from typing import Any

from ..errors import UserError, remedy
from ..files import write_json
from ..training.config import RunConfig, TrainConfig, run_from_json
from ..training.dataclass_json import differences
from ..training.provenance import provenance
from .spec import Sweep, put


def checked(folder: pathlib.Path, name: str, found: Sweep, storage: str = "", resume: bool = False) -> dict[str, Any]:
    """The contents of sweep.json. UserError: the folder holds something else."""
    path = folder / "sweep.json"
    # In a database there may be other sweeps of the same name.
    studies = f"{name}-{uuid.uuid4().hex[:8]}" if storage else name
    budget = {field: getattr(found, field) for field in ("trials", "confirm", "seeds")}
    value = {"name": name, "storage": storage, "identity": found.identity()}
    value = json.loads(json.dumps(value))
    if resume:
        before = read(path, "--resume starts nothing: leave it out to start one")
        changed = differences({n: before[n] for n in value}, value)
        if changed:
            raise UserError(
                f"--out {folder} holds another sweep ({', '.join(changed[:5])} differ): give the same values to resume "
                "it, or another --out"
            )
        return before | {"budget": budget}
    if path.exists():
        raise UserError(f"--out {folder} already holds a sweep: go on with --resume, or give another --out")
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise UserError(f"--out {folder} is not an empty folder: give another --out")
    return value | {"studies": studies, "budget": budget, "runs": []}


def keep(folder: pathlib.Path, kept: dict[str, Any]) -> None:
    """Write sweep.json, with the provenance of this start among its runs."""
    path, runs = folder / "sweep.json", list(kept["runs"])
    runs += [found for found in [provenance()] if found not in runs]
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UserError(f"{path} can't be written ({error.strerror}): {remedy(error)}") from error
    write_json(path, kept | {"runs": runs})


@contextlib.contextmanager
def alone(folder: pathlib.Path) -> Iterator[None]:
    """Lock the folder. UserError: another process runs its sweep; the lock of a killed process is gone."""
    with open(folder / "sweep.lock", "w") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise UserError(f"--out {folder} is the sweep of a process that still runs: stop it first") from None
        yield


def read(path: pathlib.Path, otherwise: str) -> dict[str, Any]:
    """A JSON file of a sweep. UserError: it can't be read; ``otherwise`` is the remedy where there is none."""
    try:
        return json.loads(path.read_text())
    except FileNotFoundError:
        raise UserError(f"{path.parent} holds no sweep: {otherwise}") from None
    except (OSError, ValueError) as error:
        raise UserError(f"{path} can't be read ({error}): search anew with another --out") from error


def winner(folder: str | pathlib.Path) -> RunConfig:
    """The configuration of a sweep's winner. UserError: there is none yet."""
    folder = pathlib.Path(folder)
    kept = read(folder / "sweep.json", "give the folder of one to --from-sweep")
    summary = read(folder / "summary.json", f"it isn't done: go on with jaxnav sweep FILE --resume --out {folder}")
    if summary["winner"] is None or summary["budget"] != kept["budget"]:
        raise UserError(
            f"--from-sweep {folder} has no winner yet: go on with jaxnav sweep FILE --resume --out {folder}"
        )
    base = kept["identity"]["base"]
    train = base["train"] | {"checkpoint_seconds": TrainConfig().checkpoint_seconds}  # of the machine, not of the sweep
    config = run_from_json(base | {"out": "", "resume": False, "train": train})
    for name, value in summary["winner"]["values"].items():
        config = put(config, name, tuple(value) if isinstance(value, list) else value)
    return config
