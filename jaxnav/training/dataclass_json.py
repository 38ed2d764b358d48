"""Nested dataclasses as JSON, back again, and where two of them differ."""

import dataclasses
import types
import typing
from typing import Any


def to_json(value: Any) -> Any:
    """A dataclass as nested dicts and lists."""
    if dataclasses.is_dataclass(value):
        return {field.name: to_json(getattr(value, field.name)) for field in dataclasses.fields(value)}
    if isinstance(value, tuple):
        return [to_json(item) for item in value]
    return value


def from_json(cls: Any, data: dict[str, Any]) -> Any:
    """The dataclass ``cls`` from the result of `to_json`; ValueError names a field that is missing or unknown."""
    hints = typing.get_type_hints(cls)
    fields = {field.name for field in dataclasses.fields(cls)}
    for name in fields ^ set(data):
        raise ValueError(f"field {name} is {'missing' if name in fields else 'unknown'}")
    values = {}
    for name, item in data.items():
        hint = hints[name]
        if dataclasses.is_dataclass(hint):
            item = from_json(hint, item)
        elif typing.get_origin(hint) is tuple and not isinstance(hint, types.UnionType):
            item = tuple(tuple(part) if isinstance(part, list) else part for part in item)
        values[name] = item
    return cls(**values)


def differences(old: Any, new: Any, prefix: str = "") -> list[str]:
    """Dotted names of the fields in which two results of `to_json` differ."""
    if not isinstance(old, dict) or not isinstance(new, dict):
        return [] if old == new else [prefix]
    names = sorted(old.keys() | new.keys())
    return [d for name in names for d in differences(old.get(name), new.get(name), f"{prefix}.{name}".lstrip("."))]
