"""The command line: jaxnav train | sweep | evaluate | render | export | talk | understand | language."""

import time

_STARTED = time.monotonic()  # training time counts from the start of the process, imports included

import dataclasses
import json
import os
import shlex
import sys
from typing import Annotated, Generic, TypeVar

import tyro
from rich.console import Console

from .command import check_policy, check_seed, enable_compilation_cache, parse
from .errors import UserError, remedy
from .terminal import print_result, training_progress

_EPISODES = 500  # of each scene, in the evaluation that ends a training run

_HELP = """jaxnav: a 2D world of pedestrians, and a robot in it that learns to steer and to talk.

usage: jaxnav COMMAND [options]      jaxnav COMMAND --help explains the options

  train            train a robot, evaluate, draw and export it; without options: the quick preset, CPU minutes
  sweep FILE       search for hyperparameters: hundreds of learners at once, the worst stopped early
  evaluate RUN     play a run's policy again: more episodes, other seeds
  render RUN       draw a run's pictures again
  export RUN       write a run's policy as a folder for a robot: torch and numpy, no JAX
  talk RUN         speak for a pedestrian while a run's robot drives, and see what it understands, does and says
  understand       what sentences mean to a run's policy
  language build   embed the phrases anew, after phrases.csv was changed

  jaxnav train --preset lidar --seed 1             twice as wide, three times as long
  jaxnav train --scene hallway --out runs/hall     one scene
  jaxnav train --scene hard --out runs/hard        scenes in which words are needed
  jaxnav train --algo td3                          a baseline that steers and is silent: td3, ppo or a2c
  jaxnav train --scene map.yaml --out runs/mine    your own building, a ROS map
  jaxnav train --resume --out runs/quick-0         go on after an interruption
  jaxnav sweep experiments/sweeps/hard.py --trials 60 --members 8
  jaxnav train --from-sweep runs/sweeps/hard       train with what a sweep has found
  jaxnav evaluate runs/quick-0 --episodes 2000 --seed 7
  jaxnav export runs/quick-0 --onnx
  jaxnav export --verify runs/quick-0/bundle
  jaxnav talk runs/quick-0 --scene hallway
  jaxnav understand --run runs/quick-0 "I'm in a hurry" "Watch out on your right!"
"""


def main(arguments: list[str] | None = None) -> None:
    """Entry point of the console script. Exits with 2 after an error that the user can mend."""
    arguments = sys.argv[1:] if arguments is None else arguments
    commands = {
        "train": _train, "sweep": _sweep, "evaluate": _evaluate, "render": _render, "export": _export, "talk": _talk,
        "understand": _understand, "language": _language,
    }  # fmt: skip
    if not arguments or arguments[0] in ("-h", "--help"):
        print(_HELP, end="")
        sys.exit(0 if arguments else 2)
    if arguments[0] == "--version":
        from importlib.metadata import version

        print(version("jaxnav"))
        return
    if arguments[0] not in commands:
        _fail(f"command {arguments[0]!r} is unknown: choose from {', '.join(commands)}")
    try:
        commands[arguments[0]](arguments[1:])
    except UserError as error:
        _fail(str(error))
    except KeyboardInterrupt:
        goes_on = {
            "train": "; jaxnav train --resume with the same options goes on",
            "sweep": f"; jaxnav {shlex.join(a for a in arguments if a != '--resume')} --resume goes on",
        }.get(arguments[0], "")
        print(f"interrupted{goes_on}", file=sys.stderr)
        sys.exit(130)
    except BrokenPipeError:  # who reads our output has had enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(1)


def _fail(message):
    print(f"error: {message}", file=sys.stderr)
    sys.exit(2)


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


def _train(arguments):
    from .training.config import preset, resolve, scene_names
    from .training.devices import is_first, join_processes, layout_on, together
    from .training.run import Interrupted, Run

    folder = _option(arguments, "--from-sweep")
    if folder is not None:
        default = _winner(folder, arguments)
    else:
        default = preset(_option(arguments, "--preset") or "quick", _option(arguments, "--algo") or "hsac")
    if not {"-h", "--help"} & set(arguments):
        _check_algorithm(arguments, default.algo)
    scene = _option(arguments, "--scene")
    if scene is not None:
        # The people of a scene are the defaults of --world.params, which the command line may still change.
        default = dataclasses.replace(default, scene=scene, world=default.world.of_scenes(scene_names(scene)))
    options = parse(
        _TrainOptions[type(default)], arguments, "train", "Train a robot.", default=_TrainOptions(config=default)
    )
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
            progress = run.train(report, _STARTED)
        except Interrupted as stop:
            console.print(f"\nstopped and saved; go on with the same command and --resume --out {run.folder}")
            sys.exit(128 + stop.signal)
    with together():  # who has nothing to write waits, since the first process coordinates the others
        if is_first():
            _finish(run, progress, console)


def _finish(run, progress, console):
    """Evaluate, draw and export what was trained, and say where it is."""
    from .cli_export import write

    seed, actor = run.config.seed, run.actor(progress, "last")
    with console.status("evaluating"):
        result = run.evaluator.evaluate(actor, "last", _EPISODES, seed)
    run.write_json("evaluation.json", result)
    print_result(Console(), result)
    with console.status("drawing"):
        _draw(run, actor, seed)
    with console.status("exporting"):
        write(run, actor, "last", run.folder / "bundle")
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
    from .cli_sweep import winner

    for option in ("--preset", "--algo"):
        if _option(arguments, option) is not None:
            raise UserError(
                f"{option} is {_option(arguments, option)} beside --from-sweep {folder}: give one of the two"
            )
    return winner(folder)


def _check_algorithm(arguments, algo):
    """UserError: an option that other algorithms have, and this one hasn't."""
    from .training.config import ALGORITHMS

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


@dataclasses.dataclass(frozen=True)
class _EvaluateOptions:
    """Play a run's policy: the seven metrics of each scene, with 95 % Wilson intervals.

    Args:
        run: the run's folder.
        episodes: in each scene.
        seed: of the episodes.
        scene: all, or one scene of the run.
        policy: last, or best: the one with the best evaluation during training.
        phrases: what people say: test, sentences of patterns never heard in training; validation; or train.
        json: print one JSON object instead of a table.
    """

    run: Annotated[str, tyro.conf.Positional]
    episodes: int = _EPISODES
    seed: int = 0
    scene: str = "all"
    policy: str = "last"
    phrases: str = "test"
    json: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False


def _evaluate(arguments):
    from .training.run import Run

    options = parse(_EvaluateOptions, arguments, "evaluate")
    if not 1 <= options.episodes <= 1_000_000:
        raise UserError(f"--episodes is {options.episodes}: give a whole number from 1 to 1000000")
    check_seed(options.seed)
    check_policy(options.policy)
    if options.phrases not in ("train", "validation", "test"):
        raise UserError(f"--phrases {options.phrases!r} is unknown: choose test, validation or train")
    enable_compilation_cache()
    run = Run.open(options.run)
    scenes = [scene.name for scene in run.world.scenes]
    if options.scene not in ("all", *scenes):
        raise UserError(f"--scene {options.scene!r} is not in this run: choose all or one of {', '.join(scenes)}")
    actor = run.actor(run.restore(), options.policy)
    with Console(stderr=True).status("evaluating"):
        result = run.evaluator.evaluate(actor, options.policy, options.episodes, options.seed, options.phrases)
    if run.agent.vocabulary(options.phrases) is not None:
        result["phrases"] = options.phrases
    if options.scene != "all":
        result["scenes"] = {options.scene: result["scenes"][options.scene]}
    if options.json:
        print(json.dumps(result))
    else:
        print_result(Console(), result)


@dataclasses.dataclass(frozen=True)
class _RenderOptions:
    """Draw a run's pictures again: trajectories.png, episode.gif, learning_curve.png.

    Args:
        run: the run's folder.
        seed: of the episodes.
        policy: last, or best: the one with the best evaluation during training.
    """

    run: Annotated[str, tyro.conf.Positional]
    seed: int = 0
    policy: str = "last"


def _render(arguments):
    from .training.run import Run

    options = parse(_RenderOptions, arguments, "render")
    check_seed(options.seed)
    check_policy(options.policy)
    enable_compilation_cache()
    run = Run.open(options.run)
    actor = run.actor(run.restore(), options.policy)
    with Console(stderr=True).status("drawing"):
        paths = _draw(run, actor, options.seed)
    print("\n".join(str(path) for path in paths))


def _export(arguments):
    from .cli_export import export

    export(arguments)


def _sweep(arguments):
    from .cli_sweep import sweep

    sweep(arguments)


def _talk(arguments):
    from .cli_language import talk

    talk(arguments)


def _understand(arguments):
    from .cli_language import understand

    understand(arguments)


def _language(arguments):
    from .cli_language import language

    language(arguments)


def _draw(run, actor, seed):
    """Draw trajectories.png, episode.gif and learning_curve.png; returns their paths."""
    from .render import animation, figures

    lines = run.metrics()
    episodes = run.record(actor, seed, *_worth_drawing(run.evaluator.summaries(actor, _EPISODES, seed)))
    drawn = {
        "trajectories.png": lambda path: figures.trajectories(run.world, episodes, path, run.params, _EPISODES),
        "episode.gif": lambda path: animation.animate(run.world, run.params, _worth_watching(episodes), path),
        "learning_curve.png": lambda path: figures.learning_curve(lines, path),
    }
    for name, draw in drawn.items():
        path, temporary = run.folder / name, run.folder / f"new-{name}"
        try:
            draw(temporary)
            temporary.replace(path)
        except OSError as error:
            temporary.unlink(missing_ok=True)
            raise UserError(f"{path} can't be written ({error.strerror}): {remedy(error)}") from error
    return [run.folder / name for name in drawn]


def _worth_drawing(summaries):
    """(scene indices, episode indices) of evaluated episodes: of each scene up to two failures, and 14 in all."""
    scenes, chosen = [], []
    for scene, arrived in enumerate(summaries.arrived):
        failed = [i for i, success in enumerate(arrived) if not success][:2]
        passed = [i for i, success in enumerate(arrived) if success]
        for episode in list(dict.fromkeys([*failed, *passed, *range(len(arrived))]))[:14]:
            scenes.append(scene)
            chosen.append(episode)
    return scenes, chosen


def _worth_watching(episodes):
    """An episode of each scene in which something is said, the robot and the pedestrian taking turns to begin."""
    chosen = []
    for i, scene in enumerate(dict.fromkeys(episode.scene for episode in episodes)):
        of_scene = [episode for episode in episodes if episode.scene == scene]
        talks = [
            [e for e in of_scene if e.outcomes.requested.any()],
            [e for e in of_scene if e.states.encounters.message.any()],
        ]
        chosen.append((talks[i % 2] or talks[1 - i % 2] or of_scene)[0])
    return chosen


def _option(arguments, name):
    """The value of an option that has to be known before the others are parsed."""
    value = None
    for i, argument in enumerate(arguments):
        if argument == name and i + 1 < len(arguments):
            value = arguments[i + 1]
        elif argument.startswith(name + "="):
            value = argument[len(name) + 1 :]
    return value  # the last counts, as for every option


if __name__ == "__main__":
    main()
