"""Parts from files: a scene, a pedestrian model, a reward, an encoder or a learner named ``file.py:NAME``.

A name stands wherever the name of a registered part does. The file is executed once, however often it is named. It has
to stand alone: a run keeps a copy of it, not of what else it may import from its folder.
"""

import dataclasses
import functools
import hashlib
import importlib.util
import itertools
import pathlib
import shutil
import sys
import traceback
import types
from collections.abc import Callable, Iterator
from typing import Any, TypeVar

from .errors import UserError

_Config = TypeVar("_Config")


class Changed(UserError):
    """A run's copy of a file is no longer the one it was trained with."""


FOLDER = "sources"  # of a run, for its copies
# Fields of a run's configuration that may name parts in files, and the kinds of parts.
FIELDS = {
    "world.scenes": "scene",
    "world.people": "people",
    "world.reward": "reward",
    "agent.encoder": "encoder",
    "algo": "learner",
}


def is_file(name: str) -> bool:
    """Whether a name is ``file.py:NAME``, or a file in which the NAME is missing."""
    path, colon, _ = name.rpartition(":")
    return name.endswith(".py") or (bool(colon) and path.endswith(".py"))


def load_part(name: str, kind: str) -> Any:
    """The object that ``file.py:NAME`` names: a `Scene` or a tuple of them, if ``kind`` is scene.

    kind: one of the values of `FIELDS`. UserError, of one line with field, value and remedy: no such file, it raises,
    it has no such object, or the object is no part of that kind.
    """
    field = next(field for field, one in FIELDS.items() if one == kind)
    path, _, attribute = name.rpartition(":") if not name.endswith(".py") else (name, "", "")
    said = f"{field} is {name!r}"
    module = _module(pathlib.Path(path), said)
    having = [key for key, value in vars(module).items() if not key.startswith("_") and _CHECKS[kind](value)]
    choose = f"choose from {', '.join(having)}" if having else f"{path} has no {kind}: add one"
    if not attribute:
        raise UserError(f"{said}, which has no NAME: {choose}")
    if not hasattr(module, attribute):
        raise UserError(f"{said}: there is no {attribute} in it; {choose}")
    part = getattr(module, attribute)
    if not _CHECKS[kind](part):
        raise UserError(f"{said}, of type {type(part).__name__}, not {_KINDS[kind]}: {choose}")
    return tuple(part) if isinstance(part, list) else part


def keep(config: _Config, folder: str | pathlib.Path) -> tuple[_Config, dict[str, str]]:
    """(``config`` that names the copies, SHA-256 of each copy by its name) of a run in ``folder``.

    Every file that ``config`` names is copied into ``folder``/sources; its name becomes sources/file.py:NAME, so that
    the run opens wherever its folder lies. UserError: two files have one name, or a copy can't be written.
    """
    folder = pathlib.Path(folder)
    kept, hashes = described(config)
    for path in {pathlib.Path(name.rpartition(":")[0]) for name in _names(config)}:
        target = folder / FOLDER / path.name
        if target.exists() and target.samefile(path):
            continue
        try:
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(path, target)
        except OSError as error:
            raise UserError(f"{target} can't be written ({error.strerror}): make it writable") from error
    return kept, hashes


def described(config: _Config) -> tuple[_Config, dict[str, str]]:
    """`keep` without copying: what tells whether two configurations name the same parts."""
    hashes: dict[str, str] = {}
    for name in _names(config):
        path = pathlib.Path(name.rpartition(":")[0])
        digest = _sha256(_read(path, f"{path}"))
        if hashes.setdefault(path.name, digest) != digest:
            raise UserError(f"two files are called {path.name}, {path} and another: rename one of them")
    return _renamed(config, lambda path: f"{FOLDER}/{path.name}"), dict(sorted(hashes.items()))


def check(config: _Config, hashes: dict[str, str], folder: str | pathlib.Path) -> _Config:
    """``config`` as `keep` stored it, with names that lead to the copies in ``folder``.

    Changed: a copy is missing or has changed since.
    """
    folder = pathlib.Path(folder)
    for name, digest in hashes.items():
        path = folder / FOLDER / name
        if not path.exists():
            raise Changed(f"{path}, with which the run was trained, is missing: put it back, or train anew")
        if _sha256(_read(path, str(path))) != digest:
            raise Changed(
                f"{path} has changed since the run was trained: undo the change, or train anew with another --out"
            )
    return _renamed(config, lambda path: str(folder / path))


_CHECKS: dict[str, Callable[[Any], bool]] = {
    "reward": lambda value: callable(value) and not isinstance(value, type),
    # World checks its methods.
    "people": lambda value: not isinstance(value, type | types.ModuleType | types.FunctionType),
}


def recognise(kind: str, check: Callable[[Any], bool]) -> None:
    """Have parts of a kind checked by ``check``: called by the module that defines their type."""
    _CHECKS[kind] = check


_KINDS = {
    "scene": "a Scene or several",
    "people": "a PedestrianModel",
    "reward": "a function (StepEvents, Params) -> dict",
    "encoder": "an Encoder",
    "learner": "what register_learner returns",
}


def _module(path: pathlib.Path, said: str) -> types.ModuleType:
    """The module of a file; ``said`` begins the UserError."""
    return _execute(_sha256(_read(path, said)), path.resolve(), said)


def _read(path: pathlib.Path, said: str) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise UserError(f"{said}: {path} can't be read ({error.strerror}): give an existing file") from None


# By their text alone: a file and its copy in a run are one module.
_executed: dict[str, types.ModuleType] = {}


def _execute(digest: str, path: pathlib.Path, said: str) -> types.ModuleType:
    if digest in _executed:
        return _executed[digest]
    name = f"jaxnav_part_{path.stem}_{digest[:12]}"
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # dataclasses look their module up
    try:
        spec.loader.exec_module(module)
    except (Exception, SystemExit) as error:
        del sys.modules[name]
        lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == str(path)]
        line = error.lineno if isinstance(error, SyntaxError) else next(reversed(lines), None)
        text = " ".join(str(error).split())
        where = f"line {line} of it raises" if line else "it raises"
        raise UserError(f"{said}: {where} {type(error).__name__} ({text}): mend the file") from error
    _executed[digest] = module
    return module


def _sha256(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


def _names(config: Any) -> Iterator[str]:
    """The names of parts in files that a configuration has."""
    for field in FIELDS:
        value = functools.reduce(_get, field.split("."), config)
        yield from (name for name in ((value,) if isinstance(value, str) else value) if is_file(name))


def _renamed(config: Any, rename: Callable[[pathlib.Path], str]) -> Any:
    """``config`` with the path of each part in a file replaced by ``rename(path)``."""

    def renamed(name):
        path, _, attribute = name.rpartition(":")
        return f"{rename(pathlib.Path(path))}:{attribute}" if is_file(name) else name

    for field in FIELDS:
        *groups, last = field.split(".")
        owners = list(itertools.accumulate(groups, _get, initial=config))
        value = _get(owners[-1], last)
        new = renamed(value) if isinstance(value, str) else type(value)(map(renamed, value))
        if new == value:
            continue
        for owner, name in zip(reversed(owners), reversed([*groups, last]), strict=True):
            new = owner | {name: new} if isinstance(owner, dict) else dataclasses.replace(owner, **{name: new})
        config = new
    return config


def _get(owner: Any, name: str) -> Any:
    return owner[name] if isinstance(owner, dict) else getattr(owner, name)
