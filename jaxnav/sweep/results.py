"""What a sweep has found: its trials, as plain data, whatever store they came from."""

import dataclasses
from typing import Any

PHASES = ("search", "confirm", "guard")


@dataclasses.dataclass(frozen=True)
class Trial:
    """One training.

    number: in its phase, from 0; state: running, stopped (at a rung), broken (its numbers turned non-finite) or
    complete; values: by dotted name, what it has of its own, floats and sizes; seed: of its training; of: number of
    the trial of the search whose values it has again, None for those of base; objective: the last one measured, None
    before; curve: a row for each round: env_steps (since it began), objective, scenes (of each its metrics: success,
    ...), losses (means over the round), seconds (its share of the round); device: on which it was trained last.
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
    def seconds(self):
        """Of the device: its share of what its population took."""
        return sum(row["seconds"] for row in self.curve)


@dataclasses.dataclass(frozen=True)
class Results:
    """name: of the sweep; identity: what it was, as JSON (`Sweep.identity`); budget: trials, confirm and seeds asked
    for; phases: trials by the name of the phase, in order of their numbers; runs: versions, commit and device
    (`provenance`) of every start, as far as they differ."""

    name: str
    identity: dict
    budget: dict
    phases: dict[str, list[Trial]]
    runs: list[dict] = dataclasses.field(default_factory=list)
