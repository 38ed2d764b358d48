"""jaxnav train: a robot trained, evaluated, drawn and exported."""

import dataclasses
import json
import sys
from typing import TYPE_CHECKING, Annotated, Generic, TypeVar

import tyro
from rich.console import Console

from .. import fields
from ..errors import UserError
from . import STARTED
from .options import Flag, enable_compilation_cache, parse, scene_field, value_of
from .output import print_result

if TYPE_CHECKING:
    from ..training.config import RunConfig
    from ..training.run import Run

_Config = TypeVar("_Config")


@dataclasses.dataclass(frozen=True)
class _TrainOptions(Generic[_Config]):
    """Train a robot, then evaluate, draw and export it."""

    config: Annotated[_Config, tyro.conf.arg(name="")]
    scene: str = scene_field("to train and evaluate in, with the people who walk there; if not world.scenes")
    devices: int = fields.other(
        0,
        allowed="1, 2, 4 or 8",
        doc="devices for episodes and batches, with equal numbers for any of them; 0: not parted",
    )
    distributed: Flag = fields.flag(
        False,
        doc="be one of several processes, whose devices count together, as Slurm or Kubernetes say, or "
        "JAX_COORDINATOR_ADDRESS, JAX_NUM_PROCESSES and JAX_PROCESS_ID",
    )
    from_sweep: str = fields.text(
        "", allowed="a path", doc="folder of a sweep, whose winner is the default of all other options"
    )


_EXAMPLES = """\
  jaxnav train --seed 1 --out runs/mine            the quick preset; --resume goes on after an interruption
  jaxnav train --scene hard --hyper.discount 0.98
  jaxnav train --scene door.py:door                a scene of your own
"""


def command(arguments: list[str]) -> None:
    from ..training.config import preset, resolve

    folder = value_of(arguments, "--from-sweep")
    if folder is not None:
        default = _winner(folder, arguments)
    else:
        default = preset(value_of(arguments, "--preset") or "quick", value_of(arguments, "--algo") or "hsac")
    if not {"-h", "--help"} & set(arguments):
        _check_algorithm(arguments, default.algo)
    scene = value_of(arguments, "--scene")
    if scene is not None:
        # The people of a scene are the defaults of --world.params, which the command line may still change.
        default = default.of_scenes(scene)
        if value_of(arguments, "--world.scenes") is not None:
            raise UserError(f"--scene is {scene} beside --world.scenes: give one of the two")
    options = parse(
        _TrainOptions[type(default)], arguments, "train", _EXAMPLES, _TrainOptions(config=default),
        "Train a robot, then evaluate, draw and export it.",
    )  # fmt: skip
    from ..api import train
    from ..training.devices import is_first, join_processes  # not needed for --help
    from ..training.signals import Interrupted

    if options.distributed:
        if options.devices == 0:
            raise UserError("--distributed needs --devices: give how many there are in all processes")
        join_processes()
    enable_compilation_cache()
    config = options.config
    try:
        run = train(config, config.out, config.resume, devices=options.devices, started=STARTED)
    except Interrupted as stop:
        if is_first():
            folder = resolve(config).out
            print(f"\nstopped and saved; go on with the same command and --resume --out {folder}", file=sys.stderr)
        sys.exit(128 + stop.signal)
    if is_first():
        _print(run)


def _print(run: "Run") -> None:
    """Print how a trained run does, and where everything is."""
    print_result(Console(), json.loads((run.folder / "evaluation.json").read_text()))
    names = (
        "bundle/", "evaluation.json", "trajectories.png", "episode.gif", "learning_curve.png", "metrics.jsonl",
        "config.json",
    )  # fmt: skip
    names = [name for name in names if (run.folder / name).exists()]  # no bundle of a learner that can't be exported
    seconds = run.files.metrics()[-1]["wall_seconds"]
    Console(markup=False, highlight=False).print(
        f"trained in {seconds:.0f} s; everything is in {run.folder}/: {', '.join(names)}", soft_wrap=True
    )


def _winner(folder: str, arguments: list[str]) -> "RunConfig":
    """The run of a sweep's winner. UserError: there is none, or options say that it is another."""
    from ..sweep.folder import winner

    for option in ("--preset", "--algo"):
        if value_of(arguments, option) is not None:
            raise UserError(
                f"{option} is {value_of(arguments, option)} beside --from-sweep {folder}: give one of the two"
            )
    return winner(folder)


def _check_algorithm(arguments: list[str], algo: str) -> None:
    """UserError: an option that other algorithms have, and this one hasn't."""
    from ..agents import LEARNERS
    from ..agents.learner import find_learner

    def has(learner, part, names):
        return names & {f.name for f in dataclasses.fields(learner.config if part == "agent" else learner.hyper)}

    own = find_learner(algo)
    for argument in arguments:
        option = argument.partition("=")[0]
        part, _, name = option.removeprefix("--").partition(".")
        if not option.startswith("--") or part not in ("agent", "hyper"):
            continue
        field = name.replace("-", "_")
        names = {field, field.removeprefix("no_")}
        having = [other for other, learner in LEARNERS.items() if has(learner, part, names)]
        if having and not has(own, part, names):
            raise UserError(f"{option}: {algo} has no such option; leave it out, or give --algo {' or '.join(having)}")
