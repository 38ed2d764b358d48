"""jaxnav compare: runs on the same episodes, and how certain their differences are."""

import dataclasses
import json
from typing import Annotated

import tyro
from rich.console import Console

from .. import fields
from ..errors import UserError
from .options import EPISODES, EpisodeOptions, Flag, enable_compilation_cache, parse
from .output import print_comparison


@dataclasses.dataclass(frozen=True)
class _Options(EpisodeOptions):
    """Play two or more runs on the same episodes: success of each, and paired differences with 95 % intervals.

    They play in the scenes of the first run, or in those of --scene.
    """

    runs: Annotated[tuple[str, ...], tyro.conf.Positional, tyro.conf.arg(metavar="RUN RUN ...")] = fields.other(
        (), allowed="at least two", doc="folders of the runs"
    )
    episodes: int = fields.whole(EPISODES, low=1, high=1_000_000, doc="episodes in each scene")
    json: Flag = fields.flag(False, doc="print one JSON object, no table")


_EXAMPLES = """\
  jaxnav compare runs/quick-0 runs/td3-quick-0
  jaxnav compare runs/a runs/b runs/c --scene hard --episodes 2000 --json
"""


def command(arguments: list[str]) -> None:
    options = parse(_Options, arguments, "compare", _EXAMPLES)
    if len(options.runs) < 2:
        raise UserError(f"RUN RUN ... are {len(options.runs)}: give the folders of at least two runs")
    enable_compilation_cache()
    from ..api import compare, load

    policies = [load(run, options.policy) for run in options.runs]
    with Console(stderr=True).status("comparing"):
        result = compare(*policies, episodes=options.episodes, seed=options.seed, scene=options.scene or None)
    if options.json:
        print(json.dumps(result))
    else:
        print_comparison(Console(), result)
