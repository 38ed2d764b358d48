"""jaxnav evaluate: a run's policy played again."""

import dataclasses
import json
from typing import Annotated

import tyro
from rich.console import Console

from ..errors import UserError
from .options import EPISODES, check_policy, check_seed, enable_compilation_cache, parse
from .output import print_result


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
    episodes: int = EPISODES
    seed: int = 0
    scene: str = "all"
    policy: str = "last"
    phrases: str = "test"
    json: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False


def command(arguments):
    from ..training.run import Run

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
    policy = run.policy(options.policy)
    with Console(stderr=True).status("evaluating"):
        result = run.evaluator.evaluate(policy, options.policy, options.episodes, options.seed, options.phrases)
    if run.agent.can_hear:
        result["phrases"] = options.phrases
    if options.scene != "all":
        result["scenes"] = {options.scene: result["scenes"][options.scene]}
    if options.json:
        print(json.dumps(result))
    else:
        print_result(Console(), result)
