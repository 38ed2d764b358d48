"""The declaration of a sweep: the configuration it starts from, the space it searches, its budget, its objective."""

import dataclasses
import importlib.util
import itertools
import math
import pathlib
import traceback
from collections.abc import Callable, Mapping
from typing import Annotated, Any, Literal

import numpy as np
import tyro

from ..errors import UserError
from ..statistics import sign
from ..training.config import HSACRunConfig, resolve, scene_names
from ..training.dataclass_json import to_json


@dataclasses.dataclass(frozen=True)
class Range:
    """Floats from ``low`` to ``high``, drawn uniformly, or uniformly in their logarithm."""

    low: float
    high: float
    log: bool = False


def mean_success(scenes: Mapping[str, Any]) -> float:
    """Mean success over the scenes. scenes: `jaxnav.training.evaluation.metrics` by scene."""
    return float(np.mean([metrics["success"] for metrics in scenes.values()]))


def worst_success(scenes: Mapping[str, Any]) -> float:
    """Success in the scene where it is lowest."""
    return min(metrics["success"] for metrics in scenes.values())


@dataclasses.dataclass(frozen=True)
class Guard:
    """Other scenes, in which a winner must not learn more slowly than ``base`` does.

    Attributes:
        scene: as in a run.
        total_steps: steps of every episode within which every scene has to reach the success.
        every: steps between two measurements.
        reaches: the success that all scenes have to reach at once.
        slack: a winner may take this many times the steps of ``base``, both as means over the seeds.
    """

    scene: str = "all"
    total_steps: int = 500
    every: int = 50
    reaches: float = 0.95
    slack: float = 1.1


FRESH_SEED = 1_000_000  # of the first confirming training; trials of a search have lower ones
_CODE = tyro.conf.Suppress  # only the file can set these fields


@dataclasses.dataclass(frozen=True)
class Sweep:
    """A search over hyperparameters: populations of trials, of which the worst are stopped early and replaced.

    Attributes:
        base: the run that trials differ from. Its seed is the first trial's; each further trial has the next seed.
        space: ranges of floats, by dotted name: ``hyper.*`` and ``world.params.reward_*``.
        sizes: values of static fields, by dotted name (``agent.updates_per_step``): each combination has a compiled
            program and populations of its own.
        objective: a function from the metrics of all scenes to a number.
        direction: whether the objective is to be large or small.
        guard: other scenes, in which the winner must still learn.
        trials: number of trials, those that are stopped early included.
        members: trials that a population trains at once.
        populations: populations of each combination of sizes.
        rungs: steps of every episode after which the worst trials are stopped.
        keep: share of the trials at a rung that go on.
        episodes: episodes of each scene that judge a trial.
        confirm: how many of the best trials are trained again beside ``base``; 0 declares the best trial the winner.
        seeds: fresh seeds with which each of them is trained.
        seed: seed of the search itself.
    """

    base: HSACRunConfig
    space: Annotated[Mapping[str, Range], _CODE]
    sizes: Annotated[Mapping[str, tuple], _CODE] = dataclasses.field(default_factory=dict)
    objective: Annotated[Callable[[Mapping[str, Any]], float], _CODE] = mean_success
    direction: Annotated[Literal["maximize", "minimize"], _CODE] = "maximize"
    guard: Annotated[Guard | None, _CODE] = None
    trials: int = 64
    members: int = 16
    populations: int = 1
    rungs: tuple[int, ...] = ()
    keep: float = 1 / 3
    episodes: int = 200
    confirm: int = 3
    seeds: int = 5
    seed: int = 0

    @property
    def sign(self) -> int:
        """1 where the objective is maximised, -1 where it is minimised."""
        return sign(self.direction)

    @property
    def round_steps(self) -> int:
        """Steps of every episode in a round, after which trials are judged."""
        return math.gcd(*self.rungs, self.base.train.total_steps)

    @property
    def combinations(self) -> list[dict[str, Any]]:
        """Combinations of the sizes, {name: value} each; a single empty one if no sizes are searched."""
        names = list(self.sizes)
        return [dict(zip(names, values, strict=True)) for values in itertools.product(*self.sizes.values())]

    @property
    def own(self) -> tuple[str, ...]:
        """Fields of the world's `Params` that differ between trials."""
        return tuple(name.rpartition(".")[2] for name in self.space if name.startswith("world."))

    def base_values(self) -> dict[str, Any]:
        """The values of ``base``, by the searched names."""
        base = resolve(self.base)  # a scene brings rewards of its own, unless the run sets them
        sizes = {name: get(base, name) for name in self.sizes}
        floats: dict[str, Any] = {name: get(base, name) for name in self.space}
        return sizes | {name: float(value) for name, value in floats.items()}

    def configuration(self, values: Mapping[str, Any]) -> HSACRunConfig:
        """The resolved configuration of a trial with these values."""
        config: Any = self.base
        for name, value in values.items():
            config = put(config, name, value)
        resolved: Any = resolve(config)
        return resolved

    def identity(self) -> dict[str, Any]:
        """The fields that a sweep must keep to go on, as JSON: all but trials, members, confirm and seeds."""
        free = {"space", "sizes", "objective", "guard", "trials", "members", "confirm", "seeds"}
        rest = {field.name: getattr(self, field.name) for field in dataclasses.fields(self) if field.name not in free}
        base = to_json(self.base)
        train = {name: value for name, value in base["train"].items() if name != "checkpoint_seconds"}
        return rest | {
            "base": {name: base[name] for name in base if name not in ("out", "resume")} | {"train": train},
            "space": {name: dataclasses.asdict(found) for name, found in self.space.items()},
            "sizes": {name: [_plain(value) for value in values] for name, values in self.sizes.items()},
            "objective": self.objective.__name__,
            "guard": self.guard and dataclasses.asdict(self.guard),
            "rungs": list(self.rungs),
        }


def _plain(value: Any) -> Any:
    return list(value) if isinstance(value, tuple) else value


def get(config: Any, name: str) -> Any:
    """The value of a dotted field."""
    for part in name.split("."):
        config = getattr(config, part)
    return config


def put(config: Any, name: str, value: Any) -> Any:
    """A copy of ``config`` with ``value`` in a dotted field."""
    first, _, rest = name.partition(".")
    if rest:
        value = put(getattr(config, first), rest, value)
    return dataclasses.replace(config, **{first: value})


def load(path: str | pathlib.Path) -> Sweep:
    """The `Sweep` named ``sweep`` in a Python file. UserError: there is none, or the file can't be run."""
    path = pathlib.Path(path)
    if not path.is_file():
        raise UserError(f"{path} is no file: give the Python file that declares a sweep")
    spec = importlib.util.spec_from_file_location(f"sweep_{path.stem}", path)
    if spec is None or spec.loader is None:
        raise UserError(f"{path} is no Python file: give one that ends in .py")
    module = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
        sweep = module.sweep
    except UserError as error:
        raise UserError(f"{path}: {error}") from error
    except Exception as error:  # whatever somebody's file may raise
        lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == str(path)]
        where = f", line {lines[-1]}" if lines else ""
        raise UserError(f"{path}{where}: {type(error).__name__}: {error}") from error
    if not isinstance(sweep, Sweep):
        raise UserError(f"{path}: sweep is a {type(sweep).__name__}: make it a jaxnav.sweep.Sweep")
    return sweep


def check(sweep: Sweep) -> None:
    """UserError: a field is wrong; names the field, its value and the remedy."""
    if sweep.direction not in ("maximize", "minimize"):
        raise UserError(f"direction is {sweep.direction!r}: give maximize or minimize")
    if not callable(sweep.objective) or not hasattr(sweep.objective, "__name__"):
        raise UserError(f"objective is {sweep.objective!r}: give a function of the metrics of every scene")
    if not sweep.space:
        raise UserError("space is empty: name at least one float, as in {'hyper.tau': Range(0.005, 0.03, log=True)}")
    for name, found in sweep.space.items():
        _check_range(sweep, name, found)
    for name, values in sweep.sizes.items():
        _check_size(sweep, name, values)
    least = {"trials": 1, "members": 1, "populations": 1, "episodes": 1, "confirm": 0, "seeds": 1, "seed": 0}
    for name, low in least.items():
        if not isinstance(getattr(sweep, name), int) or not low <= getattr(sweep, name) < 2**31:
            raise UserError(f"{name} is {getattr(sweep, name)}: give a whole number of at least {low}")
    if sweep.base.seed + sweep.trials > FRESH_SEED:
        raise UserError(
            f"base.seed is {sweep.base.seed}, with {sweep.trials} trials: give a smaller one, since seeds from "
            f"{FRESH_SEED} on are for the confirmation"
        )
    if not 0 < sweep.keep < 1:
        raise UserError(f"keep is {sweep.keep}: give a share above 0 and below 1")
    steps, chunk = sweep.base.train.total_steps, sweep.base.train.steps_per_chunk
    if list(sweep.rungs) != sorted(set(sweep.rungs)) or any(
        rung % chunk or not 0 < rung < steps for rung in sweep.rungs
    ):
        raise UserError(
            f"rungs are {' '.join(map(str, sweep.rungs))}: give ascending multiples of base.train.steps_per_chunk "
            f"({chunk}) below base.train.total_steps ({steps})"
        )
    if sweep.guard is not None:
        _check_guard(sweep.guard, chunk)
    for values in sweep.combinations:
        for end in ("low", "high"):
            try:
                sweep.configuration(values | {name: getattr(found, end) for name, found in sweep.space.items()})
            except (ValueError, UserError) as error:
                raise UserError(f"the {end} ends of space: {error}") from None


def _known(sweep: Sweep, name: str) -> Any:
    """The value of a dotted field of ``base``. UserError: there is no such field."""
    try:
        return get(sweep.base, name)
    except AttributeError:
        part, _, last = name.rpartition(".")
        try:
            fields = sorted(field.name for field in dataclasses.fields(get(sweep.base, part) if part else sweep.base))
        except (AttributeError, TypeError):
            fields = ["hyper", "world.params", "agent", "train"]
        raise UserError(f"{name} is no field of base ({last!r} is unknown): choose from {', '.join(fields)}") from None


def _check_range(sweep: Sweep, name: str, found: Any) -> None:
    value = _known(sweep, name)
    if not isinstance(found, Range):
        raise UserError(f"space has {found!r} for {name}: give a Range(low, high), or move it to sizes")
    if not name.startswith(("hyper.", "world.params.reward_")):
        kind = "a static size" if isinstance(value, int | tuple | str | bool) else "part of the task"
        remedy = (
            f"move it to sizes, as in {{{name!r}: (...)}}, where each value has populations of its own"
            if kind == "a static size"
            else "search hyper.* or world.params.reward_*, and vary tasks with base.world.randomise"
        )
        raise UserError(f"space has {name}, {kind}, which can't differ inside one population: {remedy}")
    if not all(isinstance(end, int | float) for end in (found.low, found.high)):
        raise UserError(f"space has {found!r} for {name}: give two numbers")
    if not (math.isfinite(found.low) and math.isfinite(found.high) and found.low < found.high):
        raise UserError(f"space has an empty range for {name}, {found.low} to {found.high}: give the lower end first")
    if found.log and found.low <= 0:
        raise UserError(f"space has a logarithmic range for {name} from {found.low}: begin above 0, or give log=False")


def _check_size(sweep: Sweep, name: str, values: Any) -> None:
    value = _known(sweep, name)
    if not name.startswith(("agent.", "train.")):
        raise UserError(f"sizes has {name}: give fields of agent or train; floats belong into space")
    if name in ("train.total_steps", "train.steps_per_chunk", "train.episodes", "train.checkpoint_seconds"):
        raise UserError(f"sizes has {name}, which has to be the same for all: change base.{name} instead")
    if not isinstance(values, tuple) or not values or len(set(values)) < len(values):
        raise UserError(f"sizes has {values!r} for {name}: give a tuple of different values")
    for choice in values:
        if type(choice) is not type(value):
            raise UserError(f"sizes has {choice!r} for {name}: give values like {value!r}")
        try:
            put(sweep.base, name, choice)
        except ValueError as error:
            raise UserError(f"sizes has {choice!r} for {name}: {error}") from None


def _check_guard(guard: Guard, chunk: int) -> None:
    if guard.every < 1 or guard.every % chunk or guard.total_steps < 1 or guard.total_steps % guard.every:
        raise UserError(
            f"guard.every is {guard.every} and guard.total_steps {guard.total_steps}: give a multiple of "
            f"base.train.steps_per_chunk ({chunk}), and a multiple of that"
        )
    try:
        scene_names(guard.scene)
    except UserError as error:
        raise UserError(f"guard.scene: {error}") from None
    if not 0 < guard.reaches <= 1 or not guard.slack > 0:
        raise UserError(
            f"guard.reaches is {guard.reaches} and slack {guard.slack}: give a success and a number above 0"
        )
