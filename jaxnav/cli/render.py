"""jaxnav render: a run's pictures drawn again."""

import dataclasses
from typing import Annotated

import tyro
from rich.console import Console

from .options import EPISODES, check_policy, check_seed, enable_compilation_cache, parse


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


def command(arguments):
    from ..render.of_run import draw_run
    from ..training.run import Run

    options = parse(_RenderOptions, arguments, "render")
    check_seed(options.seed)
    check_policy(options.policy)
    enable_compilation_cache()
    run = Run.open(options.run)
    policy = run.policy(options.policy)
    with Console(stderr=True).status("drawing"):
        paths = draw_run(run, policy, options.seed, EPISODES)
    print("\n".join(str(path) for path in paths))
