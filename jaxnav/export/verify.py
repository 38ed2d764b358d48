"""Verification: is a bundle whole, and does its policy still compute the recorded outputs?"""

import importlib.util
import json
import pathlib
import subprocess
import sys
from typing import Any

from ..errors import UserError
from .bundle import travelling
from .contract import SCHEMA
from .seal import checksum, hash_of

_ENTRIES = (
    "inputs", "outputs", "network", "laser", "control", "robot", "people", "encounter", "safety", "dialogue",
    "requests", "hearing", "messages", "replies", "sentences", "language", "origin", "files",
)  # fmt: skip
_FIELDS = ("name", "shape", "dtype", "unit", "frame", "order", "range", "meaning")
_FILES = {"README.md", "requirements-jetson.txt", "weights.npz", "golden.npz"} | {path.name for path in travelling()}


def verify(folder: str | pathlib.Path) -> str:
    """Check a bundle's contract and hashes, and replay golden.npz with its own policy.py. Returns its message.

    The replay runs in a process of its own, with the torch at hand. UserError: something is wrong, or torch is missing.
    """
    folder = pathlib.Path(folder)
    _check_files(folder, _read_contract(folder))
    if importlib.util.find_spec("torch") is None:
        raise UserError(
            'files and contract are right, but there is no torch to replay golden.npz: pip install "jaxnav[export]"'
        )
    return run_policy(folder, sys.executable, "--selftest")


def run_policy(folder: str | pathlib.Path, python: str | pathlib.Path, *arguments: object) -> str:
    """The output of a bundle's ``policy.py arguments`` under that Python. UserError: it fails, with its last line."""
    # -B leaves no cache behind in the bundle.
    command = [str(python), "-B", str(pathlib.Path(folder).resolve() / "policy.py"), *map(str, arguments)]
    try:
        done = subprocess.run(command, capture_output=True, text=True)
    except OSError as error:
        raise UserError(f"{python} can't be run ({error.strerror}): give a Python that has torch") from error
    if done.returncode:
        lines = done.stderr.strip().splitlines() or [f"exit code {done.returncode}"]
        raise UserError(f"{folder}: {lines[-1].removeprefix('error: ')}")
    return done.stdout.strip()


def _read_contract(folder: pathlib.Path) -> dict[str, Any]:
    path = folder / "contract.json"
    try:
        contract = json.loads(path.read_text(encoding="utf-8"))
    except (FileNotFoundError, NotADirectoryError):
        raise UserError(f"{folder} holds no bundle: there is no {path}") from None
    except (OSError, ValueError) as error:
        raise UserError(f"{path} can't be read ({error}): copy the bundle again") from error
    if not isinstance(contract, dict) or contract.get("schema") != SCHEMA:
        found = contract.get("schema") if isinstance(contract, dict) else None
        raise UserError(f"{path} has schema {found!r}, this jaxnav knows {SCHEMA}: verify it with the one that made it")
    if contract.get("checksum") != checksum(contract):
        raise UserError(f"{path} was edited: it no longer fits its checksum; export the bundle again")
    missing = [name for name in _ENTRIES if name not in contract]
    for kind in ("inputs", "outputs"):
        for entry in contract.get(kind, ()):
            missing += [f"{kind}.{entry.get('name')}.{field}" for field in _FIELDS if field not in entry]
    heard = {"embeddings.npz", "phrases.csv"} if contract.get("language") else set()
    twin = {f"{contract['network'].get('encoder_module')}.py"} if "network" in contract else set()
    missing += [f"files.{name}" for name in sorted((_FILES | heard | twin) - contract.get("files", {}).keys())]
    if missing:
        raise UserError(f"{path} lacks {', '.join(missing)}: export the bundle again")
    return contract


def _check_files(folder: pathlib.Path, contract: dict[str, Any]) -> None:
    for name, stated in contract["files"].items():
        path = folder / name
        if not path.is_file():
            raise UserError(f"{path} is missing: copy the bundle again")
        if hash_of(path) != stated:
            raise UserError(f"{path} has changed since the export: copy the bundle again, or export anew")
