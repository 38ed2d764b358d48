"""Sizes that learners share: static under ``jit``. Each learner's own config extends one of these."""

import dataclasses
from typing import Self

from .encoders import Encoder, find_encoder


@dataclasses.dataclass(frozen=True)
class LearnerConfig:
    """Sizes of the networks: static under ``jit``.

    Attributes:
        encoder: how observations become features: lidar, lidar-approach (which is told when and how near each
            pedestrian comes), grid (the paper's CNN), grid-frozen (its weights random), or one that you registered.
        encoder_widths: its widths, in the order in which it names them; empty for its own.
        actor_widths: hidden layers of the actor.
        critic_widths: hidden layers of each critic, or of the value network.
    """

    encoder: str = "lidar"
    encoder_widths: tuple[int, ...] = ()
    actor_widths: tuple[int, ...] = (128, 128)
    critic_widths: tuple[int, ...] = (128, 128)

    def __post_init__(self):
        find_encoder(self.encoder).sizes(self.encoder_widths)
        for name in ("actor_widths", "critic_widths"):
            widths = getattr(self, name)
            if not widths or any(width < 1 for width in widths):
                raise ValueError(f"agent.{name} is {widths!r}: give at least one width, each at least 1")

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

    def _check_whole(self, *names):
        for name in names:
            value = getattr(self, name)
            if not isinstance(value, int) or value < 1:
                raise ValueError(f"agent.{name} is {value!r}: give a whole number of at least 1")


@dataclasses.dataclass(frozen=True)
class ReplayConfig(LearnerConfig):
    """Sizes of a learner that samples from replay.

    Attributes:
        batch: transitions an update.
        updates_per_step: updates after each step of all episodes.
        n_step: rewards that are summed before the critics are asked.
        huber_delta: error at which the critic loss turns linear.
    """

    batch: int = 512
    updates_per_step: int = 4
    n_step: int = 3
    huber_delta: float = 2.0

    def __post_init__(self):
        super().__post_init__()
        self._check_whole("batch", "updates_per_step", "n_step")
        if not self.huber_delta > 0:
            raise ValueError(f"agent.huber_delta is {self.huber_delta!r}: give a number above 0")

    def updates(self, steps: int) -> int:
        return steps * self.updates_per_step


@dataclasses.dataclass(frozen=True)
class RolloutConfig(LearnerConfig):
    """Sizes of a learner that learns from the steps that it has just played.

    Attributes:
        horizon: steps of all episodes that an update learns from; divides train.steps_per_chunk.
    """

    horizon: int = 5

    def __post_init__(self):
        super().__post_init__()
        self._check_whole("horizon")

    def updates(self, steps: int) -> int:
        return steps // self.horizon
