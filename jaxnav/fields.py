"""Fields of configurations: default, range, unit and meaning in one place, from which they are checked and documented.

A dataclass, frozen or a pytree, declares its fields with the functions below; `check` reads the ranges back, tyro the
texts of ``--help``, and `rows` what docs/configuration.md prints.

    @dataclasses.dataclass(frozen=True)
    class Config:
        width: float = number(0.4, above=0, unit="m", doc="width of a door")
        doors: int = whole(1, low=1, high=9, doc="how many doors there are")
        side: str = choice("left", ("left", "right"), doc="side on which they open")

        def __post_init__(self):
            check(self, "config")
"""

import dataclasses
import math
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import jax
import numpy as np
from jax.core import Tracer

_RULE = "jaxnav"  # the key of a field's metadata


@dataclasses.dataclass(frozen=True)
class Rule:
    """The values a field may have.

    Attributes:
        doc: meaning of the field.
        unit: unit of its value, empty if it has none.
        allowed: range or choices, as a noun: "a number above 0".
        holds: (value) -> whether it is in that range.
        whole: whether a number has to be whole.
    """

    doc: str
    unit: str
    allowed: str
    holds: Callable[[Any], bool]
    whole: bool = False


def number(
    default: Any,
    *,
    low: float | None = None,
    high: float | None = None,
    above: float | None = None,
    below: float | None = None,
    whole: bool = False,
    unit: str = "",
    doc: str,
) -> Any:
    """A finite float, or an array of them: from ``low`` to ``high``, or above ``above`` and below ``below``."""

    def holds(value):
        if isinstance(value, bool) or not isinstance(value, int | float | np.ndarray | np.number | jax.Array):
            return False
        value = np.asarray(value)
        return bool(
            np.all(np.isfinite(value))
            and (low is None or np.all(value >= low))
            and (high is None or np.all(value <= high))
            and (above is None or np.all(value > above))
            and (below is None or np.all(value < below))
            and (not whole or np.all(value == np.floor(value)))
        )

    limits = _limits(low, high, above, below)
    kind = "a whole number" if whole else "a number"
    allowed = f"{kind} {limits}" if limits else "a finite number"
    return _field(default, Rule(doc, unit, allowed, holds, whole))


def probability(default: Any, *, doc: str) -> Any:
    """A float from 0 to 1, or an array of them."""
    return number(default, low=0, high=1, doc=doc)


def whole(default: int, *, low: int | None = None, high: int | None = None, unit: str = "", doc: str) -> Any:
    """An int from ``low`` to ``high``."""

    def holds(value):
        least, most = -math.inf if low is None else low, math.inf if high is None else high
        return isinstance(value, int) and not isinstance(value, bool) and least <= value <= most

    return _field(default, Rule(doc, unit, f"a whole number {_limits(low, high)}".strip(), holds, True))


def wholes(default: tuple[int, ...], *, low: int = 1, unit: str = "", doc: str) -> Any:
    """A tuple of one or more ints, each at least ``low``."""

    def holds(value):
        return isinstance(value, tuple) and len(value) > 0 and all(type(item) is int and item >= low for item in value)

    return _field(default, Rule(doc, unit, f"one or more whole numbers of at least {low}", holds))


def choice(default: Any, options: Sequence[Any], *, doc: str) -> Any:
    """One of a few values."""
    options = tuple(options)
    return _field(default, Rule(doc, "", f"one of {_list(options)}", lambda value: value in options))


def choices(default: tuple[str, ...], options: Sequence[str], *, doc: str) -> Any:
    """A tuple of some of a few values, each once."""
    options = tuple(options)

    def holds(value):
        return isinstance(value, tuple) and len(set(value)) == len(value) and set(value) <= set(options)

    return _field(default, Rule(doc, "", f"some of {_list(options)}, each once", holds))


def flag(default: bool, *, doc: str) -> Any:
    """True or False."""
    return _field(default, Rule(doc, "", "True or False", lambda value: isinstance(value, bool)))


def text(default: str, *, allowed: str = "any text", doc: str) -> Any:
    """A str; ``allowed`` describes what it names. Whoever looks the name up says that it is unknown."""
    return _field(default, Rule(doc, "", allowed, lambda value: isinstance(value, str)))


def part(default: str, names: Sequence[str], *, doc: str) -> Any:
    """The name of a registered part, or of one in a file, file.py:NAME. ``names`` are those that jaxnav registers."""
    return text(default, allowed=f"{', '.join(names)}, a name that you registered, or file.py:NAME", doc=doc)


def other(default: Any, *, allowed: str, doc: str, holds: Callable[[Any], bool] = lambda value: True) -> Any:
    """A value of any other type; ``holds`` tells which are allowed, ``allowed`` says it."""
    return _field(default, Rule(doc, "", allowed, holds))


def nested(cls: Callable[[], Any], *, doc: str) -> Any:
    """A configuration within a configuration, which checks itself; ``cls()`` is its default."""
    rule = Rule(doc, "", "its fields", lambda value: True)
    return dataclasses.field(default_factory=cls, metadata={_RULE: rule, "help": doc})


def again(cls: type, name: str, default: Any) -> Any:
    """A field of the base class ``cls`` with another default."""
    rule = rule_of(next(field for field in dataclasses.fields(cls) if field.name == name))
    assert rule is not None, f"{cls.__name__}.{name} has no rule"
    return _field(default, rule)


def rule_of(field: dataclasses.Field) -> Rule | None:
    """The `Rule` of a field, None if it was declared without."""
    return field.metadata.get(_RULE)


def check(config: Any, prefix: str) -> None:
    """Raise ValueError naming the first field of a dataclass that is out of its range. Traced values pass."""
    for field in dataclasses.fields(config):
        rule, value = rule_of(field), getattr(config, field.name)
        if rule is None or any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(value)):
            continue
        if not rule.holds(value):
            raise ValueError(f"{prefix}.{field.name} is {value!r}: give {rule.allowed}".lstrip("."))


def rows(cls: type, prefix: str = "") -> Iterator[tuple[str, Any, Rule]]:
    """(dotted name, default, rule) of every field of a dataclass, those of nested ones included."""
    default = cls()
    for field in dataclasses.fields(cls):
        value, name = getattr(default, field.name), f"{prefix}.{field.name}".lstrip(".")
        if dataclasses.is_dataclass(value):
            yield from rows(type(value), name)
            continue
        rule = rule_of(field)
        assert rule is not None, f"{cls.__name__}.{field.name} is declared without jaxnav.fields"
        yield name, value, rule


def _field(default: Any, rule: Rule) -> Any:
    unit = f"{rule.unit}; " if rule.unit else ""
    shown = rule.doc if isinstance(default, bool) else f"{rule.doc} ({unit}{rule.allowed})"
    return dataclasses.field(default=default, metadata={_RULE: rule, "help": shown})


def _list(options: Sequence[Any]) -> str:
    return ", ".join(map(str, options))


def _short(value: float) -> str:
    return str(value) if isinstance(value, int) else f"{value:g}"


def _limits(low=None, high=None, above=None, below=None) -> str:
    if low is not None and high is not None:
        return f"from {_short(low)} to {_short(high)}"
    limits = (("of at least", low), ("of at most", high), ("above", above), ("below", below))
    return " and ".join(f"{word} {_short(value)}" for word, value in limits if value is not None)
