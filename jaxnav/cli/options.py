"""Shared by the commands: parsing and checking options, and the cache of compiled programs."""

import contextlib
import io
import itertools
import os
import pathlib
import re

import tyro

from ..errors import UserError

EPISODES = 500  # of each scene, in evaluations unless asked for otherwise


def parse(cls, arguments, command, description=None, default=tyro.MISSING_NONPROP):
    """``cls`` from the command line; what tyro would say in a box of many lines is a `UserError` of one."""
    complaint = io.StringIO()
    try:
        with contextlib.redirect_stderr(complaint):
            return tyro.cli(cls, args=arguments, prog=f"jaxnav {command}", description=description, default=default)
    except SystemExit as stop:
        if not stop.code:
            raise
        # The box, drawn with lines or, where the terminal has none, without: a title, the text, a rule, where to look.
        lines = [line.strip("│ ") for line in complaint.getvalue().splitlines()[1:]]
        lines = itertools.takewhile(lambda line: not line.startswith("For full helptext"), lines)
        text = " ".join(line for line in lines if line.strip("─-"))
        text = re.sub(r"^Error parsing (?:(?!--)\S+: )?", "", text)
        raise UserError(f"{text} (jaxnav {command} --help lists the options)") from None


def check_seed(seed):
    if not 0 <= seed < 2**32:
        raise UserError(f"--seed is {seed}: give a whole number from 0 to {2**32 - 1}")


def check_policy(policy):
    if policy not in ("last", "best"):
        raise UserError(f"--policy {policy!r} is unknown: choose last or best")


def enable_compilation_cache():
    """Keep compiled programs between processes, where JAX_COMPILATION_CACHE_DIR or the user's cache folder says."""
    import jax

    home = pathlib.Path(os.environ.get("XDG_CACHE_HOME") or pathlib.Path.home() / ".cache")
    if jax.config.jax_compilation_cache_dir is None:
        jax.config.update("jax_compilation_cache_dir", str(home / "jaxnav" / "xla"))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.5)


def value_of(arguments, name):
    """The value of an option that has to be known before the others are parsed."""
    value = None
    for i, argument in enumerate(arguments):
        if argument == name and i + 1 < len(arguments):
            value = arguments[i + 1]
        elif argument.startswith(name + "="):
            value = argument[len(name) + 1 :]
    return value  # the last counts, as for every option
