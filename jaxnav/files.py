"""One way to write a file: whole or not at all."""

import json
import pathlib
from collections.abc import Callable
from typing import Any

from .errors import UserError, remedy


def write_atomically(path: str | pathlib.Path, content: bytes | str | Callable[[pathlib.Path], object]) -> None:
    """Write a file so that an interruption leaves the old one or the new one.

    content: what the file holds, text in UTF-8, or a function that writes it to the path that it is given, which has
    the same ending. UserError: the file can't be written.
    """
    path = pathlib.Path(path)
    temporary = path.with_name(f".new-{path.name}")
    try:
        try:
            if callable(content):
                content(temporary)
            else:
                temporary.write_bytes(content.encode() if isinstance(content, str) else content)
            temporary.replace(path)
        finally:
            temporary.unlink(missing_ok=True)
    except OSError as error:
        raise UserError(f"{path} can't be written ({error.strerror or error}): {remedy(error)}") from error


def write_json(path: str | pathlib.Path, value: Any) -> None:
    """Write ``value`` as indented JSON. UserError: the file can't be written. ValueError: a number is not finite."""
    write_atomically(path, json.dumps(value, indent=1, allow_nan=False) + "\n")
