"""Shared by the commands: parsing and checking options, and the cache of compiled programs."""

import contextlib
import dataclasses
import io
import itertools
import os
import pathlib
import re
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import tyro

from .. import fields
from ..errors import UserError

if TYPE_CHECKING:
    from ..training.config import RunConfig
    from ..training.policy import Policy
    from ..training.run import Run

EPISODES = 500  # of each scene, in evaluations unless asked for otherwise

Flag = Annotated[bool, tyro.conf.FlagCreatePairsOff]
RunFolder = Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="RUN")]

_Options = TypeVar("_Options")

_REQUIRED: Any = dataclasses.MISSING


def run_folder() -> Any:
    """The field of a run's folder."""
    return fields.text(_REQUIRED, allowed="a path", doc="the run's folder")


def scene_field(what: str) -> Any:
    """The field of ``--scene``; ``what`` says what the scenes are for."""
    allowed = "names separated by commas: all, hard, hard-laser, a scene, map.yaml or file.py:NAME"
    return fields.text("", allowed=allowed, doc=f"scenes {what}")


@dataclasses.dataclass(frozen=True, kw_only=True)
class PolicyOptions:
    """Which policy of a run."""

    policy: str = fields.choice(
        "last", ("last", "best"), doc="the one at the end, or the one with the best evaluation during training"
    )


@dataclasses.dataclass(frozen=True, kw_only=True)
class EpisodeOptions(PolicyOptions):
    """Which policy of a run, and which episodes it plays."""

    seed: int = fields.whole(0, low=0, high=2**32 - 1, doc="seed of the episodes")
    scene: str = scene_field("to play in, if not in those of training")


def parse(
    cls: type[_Options],
    arguments: Sequence[str],
    command: str,
    examples: str = "",
    default: Any = tyro.MISSING_NONPROP,
    description: str | None = None,
) -> _Options:
    """``cls`` from the command line, its fields checked. ``examples`` are shown below the help.

    UserError: what tyro would say in a box of many lines, in one.
    """
    complaint = io.StringIO()
    try:
        with contextlib.redirect_stderr(complaint):
            options = tyro.cli(cls, args=arguments, prog=f"jaxnav {command}", description=description, default=default)
    except SystemExit as stop:
        if not stop.code:
            print(f"examples:\n{examples}" if examples else "", end="")
            raise
        # The box, drawn with lines or, where the terminal has none, without: a title, the text, a rule, where to look.
        lines = [line.strip("│ ") for line in complaint.getvalue().splitlines()[1:]]
        lines = itertools.takewhile(lambda line: not line.startswith("For full helptext"), lines)
        text = " ".join(line for line in lines if line.strip("─-"))
        text = re.sub(r"^Error parsing (?:(?!--)\S+: )?", "", text)
        raise UserError(f"{text} (jaxnav {command} --help lists the options)") from None
    for field in dataclasses.fields(options):  # pyright: ignore[reportArgumentType]
        rule, value = fields.rule_of(field), getattr(options, field.name)
        if rule is not None and not rule.holds(value):
            raise UserError(f"--{field.name.replace('_', '-')} is {value!r}: give {rule.allowed}")
    return options


@dataclasses.dataclass(frozen=True)
class Opened:
    """A run as a command uses it.

    Attributes:
        run: the run, in the scenes that the command asks for.
        policy: its policy there.
        trained: the configuration with which it was trained.
    """

    run: "Run"
    policy: "Policy"
    trained: "RunConfig"

    @property
    def elsewhere(self) -> dict[str, Any]:
        """Entries of the results where the scenes differ from training: its scenes, and other changes of the world."""
        from ..training.elsewhere import changes

        if self.run.config is self.trained:
            return {}
        return {"trained_in": list(self.trained.world.scenes), "changed": changes(self.trained, self.run.config)}


def open_run(folder: str, which: str, scenes: str = "", hears: bool = False) -> Opened:
    """The run of a folder and its policy, in other scenes if any are given.

    which: last or best; hears: whether its robot has to hear sentences. UserError: the folder holds no such policy,
    there is no such scene, or the robot is deaf to sentences.
    """
    from ..training.elsewhere import in_scenes
    from ..training.run import Run

    run = Run.open(folder)
    if hears and not (run.agent.can_hear and run.config.world.hearing):
        raise UserError(
            f"{folder} is a run whose robot hears no phrases: train one with --algo hsac --agent.language phrases"
        )
    policy = run.policy(which)
    if not scenes:
        return Opened(run, policy, run.config)
    elsewhere = Run(in_scenes(run.config, scenes))
    return Opened(elsewhere, elsewhere.policy_of(policy.parameters), run.config)


def value_of(arguments: Sequence[str], name: str) -> str | None:
    """The value of an option that has to be known before the others are parsed."""
    value = None
    for i, argument in enumerate(arguments):
        if argument == name and i + 1 < len(arguments):
            value = arguments[i + 1]
        elif argument.startswith(name + "="):
            value = argument[len(name) + 1 :]
    return value  # the last counts, as for every option


def enable_compilation_cache() -> None:
    """Keep compiled programs between processes, where JAX_COMPILATION_CACHE_DIR or the user's cache folder says."""
    import jax

    home = pathlib.Path(os.environ.get("XDG_CACHE_HOME") or pathlib.Path.home() / ".cache")
    config: Any = jax.config
    if config.jax_compilation_cache_dir is None:
        jax.config.update("jax_compilation_cache_dir", str(home / "jaxnav" / "xla"))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.5)


def tolerate_any_encoding() -> None:
    """Let a wrong byte on standard input be a replacement character instead of an error."""
    if isinstance(sys.stdin, io.TextIOWrapper):
        sys.stdin.reconfigure(errors="replace")
