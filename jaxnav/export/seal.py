"""The seal of a bundle: hashes of its files in its contract, and the contract's own checksum, show every change."""

import hashlib
import json
import pathlib
from typing import Any


def seal(folder: pathlib.Path, contract: dict[str, Any]) -> None:
    """Write contract.json: the contract with the hashes of all other files, and its own checksum."""
    names = sorted(path.name for path in folder.iterdir() if path.is_file() and path.name != "contract.json")
    contract = contract | {"files": {name: hash_of(folder / name) for name in names}}
    text = json.dumps(contract | {"checksum": checksum(contract)}, indent=1)
    (folder / "contract.json").write_text(text + "\n", encoding="utf-8")


def checksum(contract: dict[str, Any]) -> str:
    """SHA-256 of a contract without its own checksum; robot/policy.py computes the same."""
    text = json.dumps({k: v for k, v in contract.items() if k != "checksum"}, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()


def hash_of(path: pathlib.Path) -> str:
    """SHA-256 of a file."""
    return hashlib.sha256(path.read_bytes()).hexdigest()
