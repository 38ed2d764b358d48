"""The Python that lies in a bundle, imported from there: what a robot would run."""

import contextlib
import importlib
import pathlib
import sys


@contextlib.contextmanager
def modules(bundle, *names):
    """The modules of these names, which are those of this bundle alone; afterwards nobody else finds them."""
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
