"""The command line: one module per command, imported when it is called."""

import importlib
import os
import shlex
import sys
import time

from ..errors import UserError
from ..training.unraisable import without_orbax

STARTED = time.monotonic()  # training time counts from here, so that importing a command's libraries counts

COMMANDS = ("train", "sweep", "evaluate", "compare", "render", "export", "talk", "understand", "language")

_HELP = """jaxnav: a 2D world of pedestrians, and a robot in it that learns to steer and to talk.

usage: jaxnav COMMAND [options]      jaxnav COMMAND --help explains the options

  train            train a robot, evaluate, draw and export it; without options: the quick preset, CPU minutes
  sweep FILE       search for hyperparameters: hundreds of learners at once, the worst stopped early
  evaluate RUN     play a run's policy again: more episodes, other seeds
  compare RUN RUN  play runs on the same episodes: which is first, and is that certain?
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
  jaxnav compare runs/quick-0 runs/td3-quick-0
  jaxnav evaluate runs/quick-0 --scene hard        play it where it was not trained
  jaxnav train --scene door.py:door                a scene of your own, one file
  jaxnav export runs/quick-0 --onnx
  jaxnav export --verify runs/quick-0/bundle
  jaxnav talk runs/quick-0 --scene hallway
  jaxnav understand --run runs/quick-0 "I'm in a hurry" "Watch out on your right!"
"""


def main(arguments: list[str] | None = None) -> None:
    """Entry point of the console script. Exits with 2 after an error that the user can mend."""
    arguments = sys.argv[1:] if arguments is None else arguments
    if not arguments or arguments[0] in ("-h", "--help"):
        print(_HELP, end="")
        sys.exit(0 if arguments else 2)
    name, *options = arguments
    if name == "--version":
        from importlib.metadata import version

        print(version("jaxnav"))
        return
    if name not in COMMANDS:
        _fail(f"command {name!r} is unknown: choose from {', '.join(COMMANDS)}")
    # A failed checkpoint is one line, and its remains may be collected at any time until the process has ended.
    sys.unraisablehook = without_orbax(sys.unraisablehook)
    try:
        importlib.import_module(f".{name}", __name__).command(options)
    except UserError as error:
        _fail(str(error))
    except KeyboardInterrupt:
        goes_on = {
            "train": "; jaxnav train --resume with the same options goes on",
            "sweep": f"; jaxnav {shlex.join(a for a in arguments if a != '--resume')} --resume goes on",
        }.get(name, "")
        print(f"interrupted{goes_on}", file=sys.stderr)
        sys.exit(130)
    except BrokenPipeError:  # the reader of our output has had enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(1)


def _fail(message: str) -> None:
    print(f"error: {message}", file=sys.stderr)
    sys.exit(2)
