"""The functions of ``import jaxnav``: train, load, evaluate, record and compare."""

import dataclasses
import pathlib
import re
import time
from collections.abc import Callable
from typing import Any

import jax
import numpy as np

from .errors import UserError
from .statistics import paired_difference
from .training.config import RunConfig, resolve
from .training.devices import is_first, layout_on, together
from .training.elsewhere import in_scenes
from .training.evaluation import Evaluator, evaluator_of, metrics
from .training.policy import Policy
from .training.rollout import Episode
from .world import Params, World, WorldConfig

EPISODES = 500  # of each scene, in evaluations unless asked for otherwise

PHRASES = ("train", "validation", "test")


def train(
    config: RunConfig,
    out: str | pathlib.Path = "",
    resume: bool = False,
    report: Callable[[dict[str, Any]], None] | None = None,
    finish: bool = True,
    devices: int = 0,
    started: float | None = None,
) -> Any:
    """Train a robot, and evaluate, draw and export it, as ``jaxnav train`` does. Returns its `Run`.

    config: begin with `preset` and change it with `dataclasses.replace`.
    out: the run's folder, that of the configuration if not given.
    resume: go on with the run that the folder holds, bit for bit.
    report: called with each line of metrics.jsonl; progress is shown if not given.
    finish: write evaluation.json, the pictures and bundle/ at the end; no bundle of a learner that can't be exported.
    devices: on which the run is parted (see ``jaxnav train --help``); 0: one device, not parted.
    started: ``time.monotonic()`` from which wall_seconds count, now if not given.

    UserError: a value out of its range, or the folder can't be used. `Interrupted`: Ctrl-C or SIGTERM, after a
    checkpoint was saved.
    """
    from rich.console import Console

    from .training.progress import training_progress
    from .training.run import Run
    from .training.train import train as train_run

    started = time.monotonic() if started is None else started
    config = dataclasses.replace(config, out=str(out or config.out), resume=resume or config.resume)
    config = resolve(config)
    run = Run(config, layout_on(devices))
    run.prepare_folder()
    # Plain text: a folder may be called [bold], and what is copied from here must not be broken into lines.
    quiet = report is not None or not is_first()
    console = Console(stderr=True, soft_wrap=True, markup=False, highlight=False, quiet=quiet)
    console.print(f"training in {run.folder} (preset {config.preset}, seed {config.seed}); the first chunk compiles")
    with training_progress(config, console) as show:
        progress = train_run(run, report or show, started)
    with together():  # who has nothing to write waits, since the first process coordinates the others
        if is_first() and finish:
            _finish(run, run.policy("last", progress), console)
    return run


def _finish(run, policy, console):
    """Evaluate, draw and export the last policy of a run."""
    from .export.contract import check_exportable
    from .export.of_run import export_run
    from .files import write_json
    from .render.of_run import draw_run

    with console.status("evaluating"):
        result = run.evaluator.evaluate(policy, "last", EPISODES, run.config.seed)
    write_json(run.folder / "evaluation.json", result)
    with console.status("drawing"):
        draw_run(run, policy, run.config.seed, EPISODES)
    try:
        check_exportable(run.agent)
    except UserError as reason:  # a learner or an encoder of one's own may know no torch
        console.print(f"no bundle: {reason}")
        return
    with console.status("exporting"):
        export_run(run, policy, "last", run.folder / "bundle", replace=True)


def load(folder: str | pathlib.Path, policy: str = "last") -> Policy:
    """The policy of a run's folder: last, or best, the one with the best evaluation during training.

    UserError: there is no run, it can't be read, or it has no such policy.
    """
    from .training.run import Run

    if policy not in ("last", "best"):
        raise UserError(f"policy is {policy!r}: choose last or best")
    return Run.open(folder).policy(policy)


def evaluate(
    policy: Policy | str | pathlib.Path,
    episodes: int = EPISODES,
    seed: int = 0,
    phrases: str = "test",
    world: World | None = None,
    params: Params | None = None,
) -> dict[str, Any]:
    """Metrics of a policy by scene, like evaluation.json: with intervals, the straight line and the muted policy.

    policy: a `Policy` or the folder of a run; episodes: in each scene; seed: of the episodes.
    phrases: what people say: test, sentences of patterns never heard in training; validation; or train.
    world, params: where to play, if not in the world in which it was trained.

    UserError: a value out of its range, or a world in which the policy observes something else.
    """
    _check(episodes, seed, phrases)
    name, policy = _named(policy)
    if not isinstance(policy, Policy):
        raise UserError(f"policy is {policy!r}: give a policy or the folder of a run; compare plays any player")
    world, params = _where(policy, world, params, None)
    _check_fits(name, policy, world, params)
    result = evaluator_of(world, params).evaluate(policy, name, episodes, seed, phrases)
    return result | {"phrases": phrases} if policy.learner.can_hear else result


def record(
    policy: Any,
    episodes: int = 1,
    seed: int = 0,
    scene: str | None = None,
    world: World | None = None,
    params: Params | None = None,
) -> list[Episode]:
    """Episodes of an evaluation with all their states, ``episodes`` of each scene or of ``scene``.

    policy: a `Policy`, the folder of a run, or any player; world, params: where to play, if not where it was trained.

    UserError: a scene that the world doesn't have, or a world in which the policy observes something else.
    """
    _check(episodes, seed, "test")
    name, player = _named(policy)
    world, params = _where(player, world, params, None)
    _check_fits(name, player, world, params)
    names = [one.name for one in world.scenes]
    if scene is not None and scene not in names:
        raise UserError(f"scene is {scene!r}: choose one of {', '.join(names)}")
    scenes = np.arange(len(names)) if scene is None else np.array([names.index(scene)])
    indices = np.tile(np.arange(episodes), scenes.size)
    return evaluator_of(world, params).record(player, seed, np.repeat(scenes, episodes), indices)


def compare(
    *players: Any,
    episodes: int = EPISODES,
    seed: int = 0,
    phrases: str = "test",
    scene: str | None = None,
    world: World | None = None,
    params: Params | None = None,
) -> dict[str, Any]:
    """Play two or more robots on the same episodes: their metrics and the paired differences of their success.

    players: policies, folders of runs, or scripted robots; episodes: in each scene; seed: of the episodes.
    phrases: the split from which people speak.
    scene: what to play in, as ``jaxnav train --scene`` has it; world, params: likewise. By default the world of the
        first policy.

    Returns episodes, seed, phrases, the names of the players, and scenes: of each ``players``, by name the metrics of
    `jaxnav.training.evaluation.metrics`, and ``differences``, for each pair one, other, difference and ci95.

    UserError: fewer than two players, or a world in which a policy observes something else.
    """
    _check(episodes, seed, phrases)
    if len(players) < 2:
        raise UserError(f"players are {len(players)}: give at least two to compare")
    named = _unique([_named(player) for player in players])
    first = next((player for player in named.values() if isinstance(player, Policy)), None)
    world, params = _where(first, world, params, scene)
    for name, player in named.items():
        _check_fits(name, player, world, params)
    evaluator = evaluator_of(world, params)
    played = {name: _played(evaluator, player, episodes, seed, phrases) for name, player in named.items()}
    names = list(named)
    pairs = [(one, other) for i, one in enumerate(names) for other in names[i + 1 :]]
    scenes = {}
    for i, one_scene in enumerate(world.scenes):
        here = {name: type(summary)(*(leaf[i] for leaf in summary)) for name, summary in played.items()}
        scenes[one_scene.name] = {
            "players": {name: metrics(summary) for name, summary in here.items()},
            "differences": [_difference(here, one, other) for one, other in pairs],
        }
    return {"episodes": episodes, "seed": seed, "phrases": phrases, "players": names, "scenes": scenes}


def _played(evaluator: Evaluator, player, episodes, seed, phrases):
    player = player.hearing(phrases) if isinstance(player, Policy) else player
    return evaluator.summaries(player, episodes, seed)


def _difference(played, one, other):
    found = paired_difference(played[one].arrived, played[other].arrived)
    return {"one": one, "other": other, "difference": found["difference"], "ci95": found["ci95"]}


def _named(player: Any) -> tuple[str, Any]:
    """(name, player) of a policy, a run's folder or a scripted robot."""
    if isinstance(player, str | pathlib.Path):
        player = load(player)
    if isinstance(player, Policy):
        return (pathlib.Path(player.config.out).name if player.config else "policy"), player
    if not callable(player) or isinstance(player, type):
        raise UserError(
            f"player is {player!r}: give a policy, the folder of a run, or a scripted robot, StraightLine()"
        )
    return re.sub(r"(?<!^)(?=[A-Z])", " ", type(player).__name__).lower(), player


def _unique(named: list[tuple[str, Any]]) -> dict[str, Any]:
    """Players by name, in their order; the second of one name is called ``name 2``."""
    result: dict[str, Any] = {}
    for name, player in named:
        number, one = 1, name
        while one in result:
            number += 1
            one = f"{name} {number}"
        result[one] = player
    return result


def _where(player: Any, world: World | None, params: Params | None, scene: str | None) -> tuple[World, Params]:
    """The world and its floats that were asked for, otherwise those of the policy."""
    if scene is not None:
        if world is not None:
            raise UserError(f"scene is {scene!r} beside a world: give one of the two")
        config = player.config if isinstance(player, Policy) else None
        if config is None:
            raise UserError(f"scene is {scene!r} without a run: give the folder of a run, or a world")
        settings = in_scenes(config, scene).world
        return settings.world(), params or settings.params
    if world is not None:
        return world, params or world.default_params
    if isinstance(player, Policy):
        return player.world, params or player.params
    world = World(WorldConfig())
    return world, params or world.default_params


def _check_fits(name: str, player: Any, world: World, params: Params) -> None:
    """UserError: the policy observes something else in this world than in its own."""
    if not isinstance(player, Policy) or player.world == world:
        return
    here, there = (_observed(one, params) for one in (world, player.world))
    if here == there:
        return
    for field in dataclasses.fields(WorldConfig):
        given, needed = getattr(world.config, field.name), getattr(player.world.config, field.name)
        if given != needed and field.name in ("observation", "beams", "nearest", "pedestrians", "scan_delay"):
            raise UserError(
                f"world.{field.name} is {given} where {name} is to play, and {needed} where it was trained: give a "
                f"world with world.{field.name} {needed}"
            )
    raise UserError(f"{name} observes something else in this world: give one like that in which it was trained")


def _observed(world: World, params: Params) -> Any:
    def observe(key):
        return world.observe(world.reset(key, params), params)

    leaves, structure = jax.tree.flatten(jax.eval_shape(observe, jax.random.key(0)))
    return structure, [(leaf.shape, leaf.dtype) for leaf in leaves]


def _check(episodes: int, seed: int, phrases: str) -> None:
    if not 1 <= episodes <= 1_000_000:
        raise UserError(f"episodes is {episodes}: give a whole number from 1 to 1000000")
    if not 0 <= seed < 2**32:
        raise UserError(f"seed is {seed}: give a whole number from 0 to {2**32 - 1}")
    if phrases not in PHRASES:
        raise UserError(f"phrases is {phrases!r}: choose test, validation or train")
