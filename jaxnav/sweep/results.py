"""The results of a sweep: its trials as plain data, whatever store they come from."""

import dataclasses
from typing import Any

from ..statistics import sign

PHASES = ("search", "confirm", "guard")


@dataclasses.dataclass(frozen=True)
class Trial:
    """One training.

    number:    its number in its phase, from 0.
    state:     running, stopped (at a rung), broken (its numbers turned non-finite) or complete.
    values:    the floats and sizes that it differs by, by dotted name.
    seed:      seed of its training.
    of:        number of the trial of the search that it repeats, None for base.
    objective: the last measurement, None before the first.
    curve:     a row for each round: env_steps (since it began), objective, scenes (metrics by scene), losses (means),
               seconds (its share of the round).
    device:    on which it was trained last.
    """

    number: int
    state: str
    values: dict[str, Any]
    seed: int
    of: int | None
    objective: float | None
    curve: tuple[dict, ...]
    device: str = ""

    @property
    def score(self) -> float:
        """The objective of a trial that has one."""
        assert self.objective is not None
        return self.objective

    @property
    def seconds(self) -> float:
        """Device time: its share of its population's."""
        return sum(row["seconds"] for row in self.curve)


@dataclasses.dataclass(frozen=True)
class Results:
    """The results of a sweep.

    name:     of the sweep.
    identity: its declaration as JSON (`Sweep.identity`).
    budget:   trials, confirm and seeds asked for.
    phases:   trials by phase, in order of their numbers.
    runs:     versions, commit and device (`provenance`) of every start, as far as they differ.
    """

    name: str
    identity: dict
    budget: dict
    phases: dict[str, list[Trial]]
    runs: list[dict] = dataclasses.field(default_factory=list)

    @property
    def sign(self) -> int:
        """1 where the objective is maximised, -1 where it is minimised."""
        return sign(self.identity["direction"])
