"""jaxnav render: a run's pictures drawn again."""

import dataclasses
from typing import Annotated

import tyro
from rich.console import Console

from ..errors import UserError, remedy
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
    from ..training.run import Run

    options = parse(_RenderOptions, arguments, "render")
    check_seed(options.seed)
    check_policy(options.policy)
    enable_compilation_cache()
    run = Run.open(options.run)
    policy = run.policy(options.policy)
    with Console(stderr=True).status("drawing"):
        paths = draw(run, policy, options.seed)
    print("\n".join(str(path) for path in paths))


def draw(run, policy, seed):
    """Draw trajectories.png, episode.gif and learning_curve.png; returns their paths."""
    from ..render import animation, figures

    lines = run.metrics()
    worth = _worth_drawing(run.evaluator.summaries(policy, EPISODES, seed))
    episodes = run.evaluator.record(policy, seed, *worth)
    drawn = {
        "trajectories.png": lambda path: figures.trajectories(run.world, episodes, path, run.params, EPISODES),
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
