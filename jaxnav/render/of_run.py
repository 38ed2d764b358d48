"""The pictures in a run's folder: trajectories.png, episode.gif and learning_curve.png."""

import pathlib

from ..errors import UserError, remedy
from ..files import write_atomically
from ..training.policy import Policy
from ..training.rollout import Episode, EpisodeSummary
from ..training.run import Run
from . import animation, figures


def draw_run(
    run: Run, policy: Policy, seed: int, episodes: int, folder: pathlib.Path | None = None
) -> list[pathlib.Path]:
    """Draw the pictures of a run's policy among ``episodes`` of each scene. Returns their paths.

    folder: where to draw what happens in other scenes than the run's, without the learning curve; the run's folder if
        not given.

    UserError: one can't be written.
    """
    worth = _worth_drawing(run.evaluator.summaries(policy, episodes, seed))
    drawn = run.evaluator.record(policy, seed, *worth)
    pictures = {
        "trajectories.png": lambda path: figures.trajectories(run.world, drawn, path, run.params, episodes),
        "episode.gif": lambda path: animation.animate(run.world, run.params, _worth_watching(drawn), path),
    }
    if folder is None:
        folder, lines = run.folder, run.files.metrics()
        pictures["learning_curve.png"] = lambda path: figures.learning_curve(lines, path)
    elif not folder.is_dir():
        try:
            folder.mkdir()
        except OSError as error:
            raise UserError(f"{folder} can't be made ({error.strerror}): {remedy(error)}") from error
    for name, draw in pictures.items():
        write_atomically(folder / name, draw)
    return [folder / name for name in pictures]


def _worth_drawing(summaries: EpisodeSummary) -> tuple[list[int], list[int]]:
    """(scene indices, episode indices) of evaluated episodes: of each scene up to two failures, and 14 in all."""
    scenes: list[int] = []
    chosen: list[int] = []
    for scene, arrived in enumerate(summaries.arrived):
        failed = [i for i, success in enumerate(arrived) if not success][:2]
        passed = [i for i, success in enumerate(arrived) if success]
        for episode in list(dict.fromkeys([*failed, *passed, *range(len(arrived))]))[:14]:
            scenes.append(scene)
            chosen.append(episode)
    return scenes, chosen


def _worth_watching(episodes: list[Episode]) -> list[Episode]:
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
