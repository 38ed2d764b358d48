"""jaxnav train: a robot trained, evaluated, drawn and exported."""

import dataclasses
import json
import sys
from typing import Annotated, Generic, TypeVar

import tyro
from rich.console import Console

from ..errors import UserError
from . import STARTED
from .options import enable_compilation_cache, parse, value_of
from .output import print_result

_Config = TypeVar("_Config")


@dataclasses.dataclass(frozen=True)
class _TrainOptions(Generic[_Config]):
    """Train a robot.

    Args:
        config: the run.
        scene: where to train and evaluate: all (square, hallway, crosswalk), hard, hard-laser, a scene, the yaml file
            of a ROS map, file.py:NAME, or several of these separated by commas; with the people who walk there.
        devices: 1, 2, 4 or 8, on which episodes and batches lie in 8 shards: the numbers are those of any other count.
            0: not parted, on one device.
        distributed: be one of several processes, whose devices count together, as Slurm or Kubernetes say, or
            JAX_COORDINATOR_ADDRESS, JAX_NUM_PROCESSES and JAX_PROCESS_ID.
        from_sweep: folder of a sweep, whose winner is the default of all other options.
    """

    config: Annotated[_Config, tyro.conf.arg(name="")]
    scene: str = ""
    devices: int = 0
    distributed: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    from_sweep: str = ""


def command(arguments):
    from ..api import train
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
        _TrainOptions[type(default)], arguments, "train", "Train a robot.", default=_TrainOptions(config=default)
    )
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


def _print(run):
    """Print how a trained run does, and where everything is."""
    print_result(Console(), json.loads((run.folder / "evaluation.json").read_text()))
    names = (
        "bundle/", "evaluation.json", "trajectories.png", "episode.gif", "learning_curve.png", "metrics.jsonl",
        "config.json",
    )  # fmt: skip
    seconds = run.files.metrics()[-1]["wall_seconds"]
    Console(markup=False, highlight=False).print(
        f"trained in {seconds:.0f} s; everything is in {run.folder}/: {', '.join(names)}", soft_wrap=True
    )


def _winner(folder, arguments):
    """The run of a sweep's winner. UserError: there is none, or options say that it is another."""
    from ..sweep.folder import winner

    for option in ("--preset", "--algo"):
        if value_of(arguments, option) is not None:
            raise UserError(
                f"{option} is {value_of(arguments, option)} beside --from-sweep {folder}: give one of the two"
            )
    return winner(folder)


def _check_algorithm(arguments, algo):
    """UserError: an option that other algorithms have, and this one hasn't."""
    from ..agents import LEARNERS

    for argument in arguments:
        option = argument.partition("=")[0]
        part, _, name = option.removeprefix("--").partition(".")
        if not option.startswith("--") or part not in ("agent", "hyper"):
            continue
        field = name.replace("-", "_")
        having = [
            other
            for other, learner in LEARNERS.items()
            if {field, field.removeprefix("no_")}
            & {f.name for f in dataclasses.fields(learner.config if part == "agent" else learner.hyper)}
        ]
        if having and algo not in having:
            raise UserError(f"{option}: {algo} has no such option; leave it out, or give --algo {' or '.join(having)}")
