"""jaxnav evaluate: a run's policy played again."""

import dataclasses
import json

from rich.console import Console

from .. import fields
from .options import EPISODES, EpisodeOptions, Flag, RunFolder, enable_compilation_cache, open_run, parse, run_folder
from .output import print_result


@dataclasses.dataclass(frozen=True)
class _Options(EpisodeOptions):
    """Play a run's policy, its muted twin and a robot that drives straight: the metrics of each scene."""

    run: RunFolder = run_folder()
    episodes: int = fields.whole(EPISODES, low=1, high=1_000_000, doc="episodes in each scene")
    phrases: str = fields.choice(
        "test",
        ("test", "validation", "train"),
        doc="phrases that people say; patterns of test were never heard in training",
    )
    json: Flag = fields.flag(False, doc="print one JSON object, no table")


_EXAMPLES = """\
  jaxnav evaluate runs/quick-0 --episodes 2000 --seed 7
  jaxnav evaluate runs/quick-0 --scene hard               scenes in which it was not trained
  jaxnav evaluate runs/quick-0 --scene door.py:door --json
"""


def command(arguments: list[str]) -> None:
    options = parse(_Options, arguments, "evaluate", _EXAMPLES)
    enable_compilation_cache()
    opened = open_run(options.run, options.policy, options.scene)
    with Console(stderr=True).status("evaluating"):
        result = opened.run.evaluator.evaluate(
            opened.policy, options.policy, options.episodes, options.seed, options.phrases
        )
    if opened.policy.learner.can_hear:
        result["phrases"] = options.phrases
    result |= opened.elsewhere
    if options.json:
        print(json.dumps(result))
    else:
        print_result(Console(), result)
