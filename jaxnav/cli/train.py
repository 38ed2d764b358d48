"""jaxnav train: a robot trained, evaluated, drawn and exported."""

import dataclasses
import sys
from typing import Annotated, Generic, TypeVar

import tyro
from rich.console import Console

from ..errors import UserError
from . import STARTED
from .options import EPISODES, enable_compilation_cache, parse, value_of
from .output import print_result, training_progress
from .render import draw

_Config = TypeVar("_Config")


@dataclasses.dataclass(frozen=True)
class _TrainOptions(Generic[_Config]):
    """Train a robot.

    Args:
        config: the run.
        devices: 1, 2, 4 or 8, on which episodes and batches lie in 8 shards: the numbers are those of any other count.
            0: not parted, on one device.
        distributed: be one of several processes, whose devices count together, as Slurm or Kubernetes say, or
            JAX_COORDINATOR_ADDRESS, JAX_NUM_PROCESSES and JAX_PROCESS_ID.
        from_sweep: folder of a sweep, whose winner is the default of all other options.
    """

    config: Annotated[_Config, tyro.conf.arg(name="")]
    devices: int = 0
    distributed: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    from_sweep: str = ""


def command(arguments):
    from ..training.config import preset, resolve, scene_names

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
        default = dataclasses.replace(default, scene=scene, world=default.world.of_scenes(scene_names(scene)))
    options = parse(
        _TrainOptions[type(default)], arguments, "train", "Train a robot.", default=_TrainOptions(config=default)
    )
    from ..training.devices import is_first, join_processes, layout_on, together  # not needed for --help
    from ..training.run import Interrupted, Run

    if options.distributed:
        if options.devices == 0:
            raise UserError("--distributed needs --devices: give how many there are in all processes")
        join_processes()
    config = resolve(options.config)
    enable_compilation_cache()
    run = Run(config, layout_on(options.devices))
    run.prepare_folder()
    # Plain text: a folder may be called [bold], and what is copied from here must not be broken into lines.
    console = Console(stderr=True, soft_wrap=True, markup=False, highlight=False, quiet=not is_first())
    console.print(f"training in {run.folder} (preset {config.preset}, seed {config.seed}); the first chunk compiles")
    with training_progress(config, console) as report:
        try:
            progress = run.train(report, STARTED)
        except Interrupted as stop:
            console.print(f"\nstopped and saved; go on with the same command and --resume --out {run.folder}")
            sys.exit(128 + stop.signal)
    with together():  # who has nothing to write waits, since the first process coordinates the others
        if is_first():
            _finish(run, progress, console)


def _finish(run, progress, console):
    """Evaluate, draw and export what was trained, and say where it is."""
    from .export import write

    seed, policy = run.config.seed, run.policy("last", progress)
    with console.status("evaluating"):
        result = run.evaluator.evaluate(policy, "last", EPISODES, seed)
    run.write_json("evaluation.json", result)
    print_result(Console(), result)
    with console.status("drawing"):
        draw(run, policy, seed)
    with console.status("exporting"):
        write(run, policy.parameters, "last", run.folder / "bundle")
    names = (
        "bundle/", "evaluation.json", "trajectories.png", "episode.gif", "learning_curve.png", "metrics.jsonl",
        "config.json",
    )  # fmt: skip
    Console(markup=False, highlight=False).print(
        f"trained in {run.metrics()[-1]['wall_seconds']:.0f} s; everything is in {run.folder}/: {', '.join(names)}",
        soft_wrap=True,
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
    from ..training.config import ALGORITHMS

    for argument in arguments:
        option = argument.partition("=")[0]
        part, _, name = option.removeprefix("--").partition(".")
        if not option.startswith("--") or part not in ("agent", "hyper"):
            continue
        field = name.replace("-", "_")
        having = [
            other
            for other, (_, config) in ALGORITHMS.items()
            if {field, field.removeprefix("no_")} & {f.name for f in dataclasses.fields(getattr(config(), part))}
        ]
        if having and algo not in having:
            raise UserError(f"{option}: {algo} has no such option; leave it out, or give --algo {' or '.join(having)}")
