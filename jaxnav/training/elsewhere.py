"""A run's policy in scenes other than those it was trained in."""

import dataclasses
from typing import Any

from ..errors import UserError
from .config import RunConfig
from .dataclass_json import differences, to_json


def in_scenes(config: RunConfig, scenes: str) -> RunConfig:
    """``config`` in other scenes, with as many people as they take and with the people there; all else stays.

    The robot still observes as many people as in training, so that its networks fit.

    scenes: as for ``--scene``. UserError: one is unknown, or their people differ.
    """
    nearest = min(config.world.nearest, config.world.pedestrians)
    try:
        world = dataclasses.replace(config.world, nearest=nearest).of_scenes(scenes)
        world.world()
    except ValueError as error:
        raise UserError(f"--scene is {scenes}: {error}") from None
    return dataclasses.replace(config, world=world)


def changes(before: RunConfig, after: RunConfig) -> dict[str, Any]:
    """The values of the world in ``after`` that are others than in ``before``, by dotted name."""
    old, new = to_json(before.world), to_json(after.world)
    found = {}
    for name in differences(old, new, "world"):
        value = new
        for part in name.split(".")[1:]:
            value = value[part]
        found[name] = value
    return found
