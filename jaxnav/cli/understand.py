"""jaxnav understand: what sentences mean to a run's policy."""

import dataclasses
import json
import logging
import sys
from typing import TYPE_CHECKING, Annotated

import tyro
from rich.console import Console

from .. import fields
from .options import (
    Flag,
    PolicyOptions,
    enable_compilation_cache,
    open_run,
    parse,
    run_folder,
    tolerate_any_encoding,
)

if TYPE_CHECKING:
    from ..language.interpreter import PolicyInterpreter
    from ..training.policy import Policy


@dataclasses.dataclass(frozen=True)
class _Options(PolicyOptions):
    """Tell what sentences mean to a run's policy: silence, stop, right or left, and how sure it is."""

    run: str = run_folder()
    text: Annotated[tuple[str, ...], tyro.conf.Positional, tyro.conf.arg(metavar="TEXT ...")] = fields.other(
        (), allowed="any text", doc="sentences; without any, the lines of standard input"
    )
    json: Flag = fields.flag(False, doc="print a JSON object per line: text, message, confidence")


_EXAMPLES = """\
  jaxnav understand --run runs/quick-0 "I'm in a hurry" "Watch out on your right!"
"""


def command(arguments: list[str]) -> None:
    options = parse(_Options, arguments, "understand", _EXAMPLES)
    enable_compilation_cache()
    log_to_stderr()
    interpreter = interpreter_of(open_run(options.run, options.policy, hears=True).policy)
    if not options.text and sys.stdin.isatty():
        Console(stderr=True).print("a sentence a line; Ctrl-D ends")
    tolerate_any_encoding()
    for text in options.text or (line.rstrip("\r\n") for line in sys.stdin):
        found = interpreter.read(text)
        if options.json:
            row = {"text": text, "message": found.name, "confidence": round(found.confidence, 4)}
            print(json.dumps(row), flush=True)
        else:
            doubt = "  (unsure: it would ask again)" if found.unsure else ""
            print(f"{found.name:8} {found.confidence:.2f}  {found.text}{doubt}", flush=True)


def interpreter_of(policy: "Policy") -> "PolicyInterpreter":
    """The interpreter of sentences that a policy is itself."""
    import jax

    from ..language.interpreter import PolicyInterpreter
    from ..language.table import Embedder, default_table

    heard = jax.jit(policy.learner.understand)  # pyright: ignore[reportAttributeAccessIssue] (of those that can hear)
    return PolicyInterpreter(Embedder(default_table()), lambda words: heard(policy.parameters, words))


def log_to_stderr() -> None:
    """Show what jaxnav.language warns of."""
    handler = logging.StreamHandler()
    handler.setFormatter(logging.Formatter("%(message)s"))
    log = logging.getLogger("jaxnav.language")
    log.addHandler(handler)
    log.propagate = False
