"""The parts of a run's configuration that all learners share: its world and its training loop."""

import dataclasses
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from .. import maps, plugins
from ..errors import UserError
from ..fields import check, nested, number, other, whole
from ..world import SCENES, SUITES, Params, Scene, World, WorldConfig, body_reach
from ..world.people import RECORDING
from ..world.scenes import params_of


@dataclasses.dataclass(frozen=True)
class WorldSettings(WorldConfig):
    """Sizes, switches and floats of a world, and which of the floats are drawn anew for each training episode.

    A scene may also be the yaml file of a map, or file.py:NAME.
    """

    params: Params = nested(Params, doc="floats of the world")
    randomise: tuple[tuple[str, float, float], ...] = other(
        (),
        allowed="name, lowest and highest of each",
        doc="fields of world.params that each training episode draws anew",
    )

    def world(self) -> World:
        """The `World` of these sizes, with its parts in files loaded. ValueError, UserError: see `World`, `plugins`."""
        own, names = {}, []
        for name in self.scenes:
            found = self._load(name)
            names += [scene.name for scene in found] or [name]  # of a recording, or unknown: World says it
            own |= {scene.name: scene for scene in found}
        fields: dict[str, Any] = {field.name: getattr(self, field.name) for field in dataclasses.fields(WorldConfig)}
        parts: dict[str, Any] = {}
        if plugins.is_file(self.reward):
            parts["reward"] = plugins.load_part(self.reward, "reward")
        if plugins.is_file(self.people):
            parts["people"] = plugins.load_part(self.people, "people")
        fields["scenes"] = tuple(names)
        return World(WorldConfig(**fields), own.values(), **parts)

    def of_scenes(self, scenes: str | Sequence[str]) -> "WorldSettings":
        """The same in other scenes (see `scene_names`), with as many people as they take, and with the people there.

        Fields of ``params`` that are neither the usual ones nor those of the present scenes stay. ValueError: people of
        different suites.
        """
        names = scene_names(scenes)
        found = _people(names)
        here, before = params_of(found) if found else Params(), self._present()
        pedestrians = max(self.pedestrians, *((scene.crowd or (1, 1))[1] for scene in found), 1)
        params = {
            name: getattr(here, name) if any(np.array_equal(value, getattr(one, name)) for one in before) else value
            for name, value in vars(self.params).items()
        }
        return dataclasses.replace(self, scenes=names, pedestrians=pedestrians, params=Params(**params))

    def _present(self) -> tuple[Params, ...]:
        """The usual `Params`, and those of the present scenes."""
        try:
            return Params(), params_of(_people(self.scenes))
        except ValueError:  # none, or of several suites
            return (Params(),)

    def _load(self, name: str) -> tuple[Scene, ...]:
        if not is_map(name):
            return _found(name)
        scan_range, margin = float(self.params.scan_range), max(maps.MARGIN, float(body_reach(self.params)))
        return (maps.load(name, scan_range=scan_range, margin=margin),)


def is_map(scene: str) -> bool:
    """Whether the name of a scene is that of a ROS map_server file."""
    return scene.endswith((".yaml", ".yml"))


def scene_names(scenes: str | Iterable[str]) -> tuple[str, ...]:
    """The names that --scene stands for: names separated by commas, each of a suite, a scene, a map or file.py:NAME.

    UserError: there is none of that name.
    """
    names: list[str] = []
    for name in scenes.split(",") if isinstance(scenes, str) else scenes:
        suite = SUITES["parity"] if name == "all" else SUITES.get(name)
        if suite is None and name not in (*SCENES, RECORDING) and not is_map(name) and not plugins.is_file(name):
            suites = ", ".join(("all", *SUITES))
            raise UserError(
                f"scene {name!r} is unknown: choose {suites}, one of {', '.join(SCENES)}, "
                f"{RECORDING} (that of world.recording), the yaml file of a map, or file.py:NAME"
            )
        names += suite or (name,)
    return tuple(names)


def _found(name: str) -> tuple[Scene, ...]:
    """The registered scene of a name, or those that file.py:NAME names."""
    if not plugins.is_file(name):
        return (SCENES[name],) if name in SCENES else ()
    found = plugins.load_part(name, "scene")
    return (found,) if isinstance(found, Scene) else found


def _is_scene(value: Any) -> bool:
    several = isinstance(value, tuple | list) and len(value) > 0
    return isinstance(value, Scene) or (several and all(isinstance(one, Scene) for one in value))


plugins.recognise("scene", _is_scene)


def _people(names: Iterable[str]) -> list[Scene]:
    """The scenes of these names that say which people they have: all but maps."""
    return [scene for name in names if not is_map(name) for scene in _found(name)]


@dataclasses.dataclass(frozen=True)
class TrainConfig:
    """Sizes of the training loop."""

    episodes: int = whole(256, low=1, doc="episodes that are played at once")
    replay_rows: int = whole(400, low=1, unit="steps", doc="steps of all episodes that replay keeps")
    steps_per_chunk: int = whole(25, low=1, unit="steps", doc="steps between two lines of metrics.jsonl")
    total_steps: int = whole(
        1000, low=1, unit="steps", doc="length of the training, in steps of all episodes; a multiple of steps-per-chunk"
    )
    evaluate_every: int = whole(4, low=1, unit="chunks", doc="chunks between two evaluations")
    checkpoint_seconds: float = number(
        60.0, low=0, unit="s", doc="the most work a kill can cost; may change on --resume"
    )

    def __post_init__(self):
        check(self, "train")
        if self.total_steps % self.steps_per_chunk:
            raise ValueError(
                f"train.total_steps is {self.total_steps}: give a multiple of "
                f"train.steps_per_chunk, which is {self.steps_per_chunk}"
            )
