"""jaxnav render: a run's pictures drawn again."""

import dataclasses
import re

from rich.console import Console

from .options import EPISODES, EpisodeOptions, RunFolder, enable_compilation_cache, open_run, parse, run_folder


@dataclasses.dataclass(frozen=True)
class _Options(EpisodeOptions):
    """Draw a run's pictures again: trajectories.png, episode.gif, learning_curve.png."""

    run: RunFolder = run_folder()


_EXAMPLES = """\
  jaxnav render runs/quick-0 --seed 7 --policy best
  jaxnav render runs/quick-0 --scene hard                 pictures into runs/quick-0/hard/
"""


def command(arguments: list[str]) -> None:
    from ..render.of_run import draw_run

    options = parse(_Options, arguments, "render", _EXAMPLES)
    enable_compilation_cache()
    opened = open_run(options.run, options.policy, options.scene)
    run, folder = opened.run, None
    if options.scene:
        folder = run.folder / re.sub(r"[^\w-]+", "-", options.scene)
    with Console(stderr=True).status("drawing"):
        paths = draw_run(run, opened.policy, options.seed, EPISODES, folder)
    print("\n".join(str(path) for path in paths))
