"""Sizes that learners share: static under ``jit``. Each learner's own config extends one of these."""

import dataclasses
from typing import Self

from .. import fields
from .encoders import Encoder, find_encoder

_ENCODERS = ("lidar", "lidar-approach", "grid", "grid-frozen")


def _are_widths(value):
    return isinstance(value, tuple) and all(type(width) is int and width >= 1 for width in value)


@dataclasses.dataclass(frozen=True)
class LearnerConfig:
    """Sizes of the networks: static under ``jit``."""

    encoder: str = fields.part(
        "lidar",
        _ENCODERS,
        doc="how observations become features: lidar, lidar-approach (which is told when and how near each pedestrian "
        "comes), grid (the paper's CNN) or grid-frozen (its weights random)",
    )
    encoder_widths: tuple[int, ...] = fields.other(
        (), allowed="whole numbers of at least 1", holds=_are_widths,
        doc="widths of the encoder, in the order in which it names them; none for its own",
    )  # fmt: skip
    actor_widths: tuple[int, ...] = fields.wholes((128, 128), doc="hidden layers of the actor")
    critic_widths: tuple[int, ...] = fields.wholes(
        (128, 128), doc="hidden layers of each critic, or of the value network"
    )

    def __post_init__(self):
        fields.check(self, "agent")
        find_encoder(self.encoder).sizes(self.encoder_widths)

    @property
    def encoding(self) -> Encoder:
        """The record of the encoder."""
        return find_encoder(self.encoder)

    def filled(self) -> Self:
        """The same with the encoder's widths as numbers."""
        return dataclasses.replace(self, encoder_widths=tuple(self.encoding.sizes(self.encoder_widths).values()))

    def updates(self, steps: int) -> int:
        """How many updates ``steps`` steps of all episodes make."""
        raise NotImplementedError


@dataclasses.dataclass(frozen=True)
class ReplayConfig(LearnerConfig):
    """Sizes of a learner that samples from replay: static under ``jit``."""

    batch: int = fields.whole(512, low=1, doc="transitions an update")
    updates_per_step: int = fields.whole(4, low=1, doc="updates after each step of all episodes")
    n_step: int = fields.whole(3, low=1, doc="rewards that are summed before the critics are asked")
    huber_delta: float = fields.number(2.0, above=0, doc="error at which the critic loss turns linear")

    def updates(self, steps: int) -> int:
        return steps * self.updates_per_step


@dataclasses.dataclass(frozen=True)
class RolloutConfig(LearnerConfig):
    """Sizes of a learner that learns from the steps that it has just played: static under ``jit``."""

    horizon: int = fields.whole(
        5, low=1, doc="steps of all episodes that an update learns from; divides train.steps_per_chunk"
    )

    def updates(self, steps: int) -> int:
        return steps // self.horizon
