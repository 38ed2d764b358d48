"""jaxnav understand: what sentences mean to a run's policy."""

import dataclasses
import json
import logging
import sys
from typing import Annotated

import tyro
from rich.console import Console

from ..errors import UserError
from .options import check_policy, enable_compilation_cache, parse


@dataclasses.dataclass(frozen=True)
class _UnderstandOptions:
    """What sentences mean to a run's policy: silence, stop, right or left, and how sure it is.

    Args:
        text: sentences; without any, one a line from standard input.
        run: the run's folder.
        json: print one JSON object a line: text, message, confidence.
        policy: last, or best: the one with the best evaluation during training.
    """

    run: str
    text: Annotated[tuple[str, ...], tyro.conf.Positional] = ()
    json: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    policy: str = "last"


def command(arguments):
    options = parse(_UnderstandOptions, arguments, "understand")
    check_policy(options.policy)
    enable_compilation_cache()
    log_to_stderr()
    ears = interpreter_of(open_hearing(options.run, options.policy))
    if not options.text and sys.stdin.isatty():
        Console(stderr=True).print("a sentence a line; Ctrl-D ends")
    sys.stdin.reconfigure(errors="replace")
    for text in options.text or (line.rstrip("\r\n") for line in sys.stdin):
        found = ears.read(text)
        if options.json:
            row = {"text": text, "message": found.name, "confidence": round(found.confidence, 4)}
            print(json.dumps(row), flush=True)
        else:
            doubt = "  (unsure: it would ask again)" if found.unsure else ""
            print(f"{found.name:8} {found.confidence:.2f}  {found.text}{doubt}", flush=True)


def open_hearing(folder, policy):
    """The `Policy` of a run. UserError: its robot hears messages, no sentences."""
    from ..training.run import Run

    run = Run.open(folder)
    if not run.agent.can_hear or not run.config.world.hearing:
        raise UserError(
            f"{folder} is a run whose robot hears no phrases: train one with --algo hsac --agent.language phrases"
        )
    return run.policy(policy)


def interpreter_of(policy):
    import jax

    from ..language.interpreter import PolicyInterpreter
    from ..language.table import Embedder, default_table

    heard = jax.jit(policy.learner.understand)
    return PolicyInterpreter(Embedder(default_table()), lambda words: heard(policy.parameters, words))


def log_to_stderr():
    handler = logging.StreamHandler()
    handler.setFormatter(logging.Formatter("%(message)s"))
    log = logging.getLogger("jaxnav.language")
    log.addHandler(handler)
    log.propagate = False
