"""The Python modules of a bundle, imported from its folder as a robot does."""

import contextlib
import importlib
import pathlib
import sys
from collections.abc import Iterator
from typing import Any


@contextlib.contextmanager
def modules(bundle: str | pathlib.Path, *names: str) -> Iterator[tuple[Any, ...]]:
    """The modules of a bundle with these names; afterwards they can't be imported any more."""
    own = [path.stem for path in pathlib.Path(bundle).glob("*.py")]
    before = {name: sys.modules.pop(name, None) for name in own}
    sys.path.insert(0, str(bundle))
    written, sys.dont_write_bytecode = sys.dont_write_bytecode, True
    try:
        yield tuple(importlib.import_module(name) for name in names)
    finally:
        sys.dont_write_bytecode = written
        sys.path.remove(str(bundle))
        for name in own:
            sys.modules.pop(name, None)
        sys.modules.update({name: module for name, module in before.items() if module is not None})
