"""Complaints that are Orbax's: coroutines of a failed checkpoint complain whenever Python collects them."""

from collections.abc import Callable
from typing import Any


def without_orbax(hook: Callable[[Any], Any]) -> Callable[[Any], None]:
    """``sys.unraisablehook`` that passes on to ``hook`` all but what a failed checkpoint leaves behind."""

    def complain(unraisable):
        code = getattr(unraisable.object, "cr_code", None)
        if str(unraisable.exc_value) != "Event loop is closed" and "orbax" not in getattr(code, "co_filename", ""):
            hook(unraisable)

    return complain
