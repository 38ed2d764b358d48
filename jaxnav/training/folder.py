"""A run's folder: config.json, metrics.jsonl, checkpoints/, and what is drawn and exported beside them."""

import contextlib
import errno
import json
import os
import pathlib
from typing import Any, BinaryIO

from ..errors import UserError, remedy
from ..files import write_json


class RunFolder:
    """The files of a run in the folder ``path``, made by `create`."""

    def __init__(self, path: str | pathlib.Path):
        self.path = pathlib.Path(path)
        self.config_path = self.path / "config.json"
        self.metrics_path = self.path / "metrics.jsonl"
        self.checkpoints_path = self.path / "checkpoints"

    def read_config(self) -> dict[str, Any]:
        """The contents of config.json. UserError: there is none. ValueError, OSError: it can't be read."""
        try:
            return json.loads(self.config_path.read_text())
        except (FileNotFoundError, NotADirectoryError):
            raise UserError(f"{self.path} holds no run: there is no {self.config_path}") from None

    def create(self) -> None:
        """Make the folder of a new run. UserError: it holds something, or can't be made."""
        if self.path.exists() and not self.path.is_dir():
            raise UserError(f"--out {self.path} is a file: give a folder")
        if self.path.exists() and any(self.path.iterdir()):
            if self.config_path.exists():
                raise UserError(f"--out {self.path} already holds a run: go on with --resume, or give another --out")
            raise UserError(f"--out {self.path} is not empty: give another --out")
        try:
            self.path.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise UserError(f"--out {self.path} can't be made ({error.strerror}): give another --out") from error

    def write_config(self, stored: dict[str, Any]) -> None:
        """Write config.json, the last file of a new run."""
        write_json(self.config_path, stored)

    def metrics(self) -> list[dict[str, Any]]:
        """The lines of metrics.jsonl; one that a kill cut off at the end is left out."""
        try:
            whole = self.metrics_path.read_text().rpartition("\n")[0]
            return [json.loads(line) for line in whole.splitlines()]
        except (OSError, ValueError) as error:
            raise UserError(f"{self.metrics_path} can't be read ({error}): train anew with another --out") from error

    def metrics_size(self) -> int:
        """Bytes of metrics.jsonl, 0 where there is none."""
        with contextlib.suppress(FileNotFoundError):
            return self.metrics_path.stat().st_size
        return 0

    def open_metrics(self, writes: bool = True) -> BinaryIO:
        """metrics.jsonl, to be appended to; without ``writes`` what is appended goes nowhere."""
        try:
            # Without a buffer, so that closing it after a failure can't fail again.
            return open(self.metrics_path if writes else os.devnull, "ab", buffering=0)
        except OSError as error:
            raise UserError(f"{self.metrics_path} can't be opened ({error.strerror}): {remedy(error)}") from error

    def append(self, file: BinaryIO, line: dict[str, Any]) -> None:
        """Append a line to the open metrics.jsonl. UserError: it doesn't fit."""
        try:
            data = json.dumps(line).encode() + b"\n"
            if file.write(data) < len(data):  # only a part fitted
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        except OSError as error:
            raise UserError(
                f"{self.metrics_path} can't be written ({error.strerror}): {remedy(error)}, then go on with --resume"
            ) from error
