"""Numbers and names of a report, as text."""

from collections.abc import Sequence
from typing import Any


def number(value: float | None, signed: bool = False) -> str:
    """A measurement with three decimals, or with fewer where it is large."""
    if value is None:
        return "-"
    return f"{value:{'+' if signed else ''},.{3 if abs(value) < 10 else 1 if abs(value) < 1000 else 0}f}"


def with_interval(value: float | None, interval: Sequence[float] | None, signed: bool = False) -> str:
    """A measurement, with its interval in brackets if it has one."""
    if interval is None:
        return number(value, signed)
    return f"{number(value, signed)} ({number(interval[0], signed)} to {number(interval[1], signed)})"


def searched(value: Any) -> str:
    """A searched value; a float with four digits."""
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def name_of(trial: int | None) -> str:
    """The name of a candidate. trial: its number in the search, None for base."""
    return "base" if trial is None else f"trial {trial}"
