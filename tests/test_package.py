"""The package as a whole: its version, what importing it costs, and which room imports which."""

import ast
import importlib.metadata
import subprocess
import sys
from pathlib import Path

import pytest

import jaxnav

PACKAGE = Path(jaxnav.__file__).parent

# From the ground up: a room imports only rooms that stand before it.
ROOMS = (
    "errors",
    "fields",
    "plugins",
    "files",
    "statistics",
    "world",
    "maps",
    "language",
    "agents",
    "training",
    "render",
    "sweep",
    "export",
    "adapters",
    "api",
    "talk",
    "cli",
)


def imported_rooms(source, package):
    """Rooms that a module imports anywhere in it. package: its own, in parts, as ("jaxnav", "world")."""
    names = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            names += [alias.name.split(".") for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            above = list(package[: len(package) - node.level + 1]) if node.level else []
            module = above + (node.module.split(".") if node.module else [])
            names += [[*module, alias.name] for alias in node.names]
    inside = [name[1] if len(name) > 1 else "" for name in names if name[0] == "jaxnav"]
    return {name for name in inside if name in ROOMS}


@pytest.mark.parametrize(
    ("source", "rooms"),
    [
        ("from .geometry import norm", {"world"}),
        ("from . import orca", {"world"}),
        ("from ..agents import hsac", {"agents"}),
        ("from .. import training", {"training"}),
        ("def f():\n    import jaxnav.cli", {"cli"}),
        ("from jaxnav.maps.polygons import walls\nimport jax", {"maps"}),
        ("import jaxnavigator\nfrom jaxnav import Params", set()),
    ],
)
def test_imported_rooms_are_found_in_every_spelling(source, rooms):
    assert imported_rooms(source, ("jaxnav", "world")) == rooms


@pytest.mark.parametrize("room", ROOMS)
def test_a_room_imports_only_rooms_above_it(room):
    files = [*PACKAGE.glob(f"{room}.py"), *PACKAGE.glob(f"{room}/**/*.py")]
    for file in files:
        package = ("jaxnav", *file.relative_to(PACKAGE).parts[:-1])
        below = imported_rooms(file.read_text(), package) - set(ROOMS[: ROOMS.index(room) + 1])
        assert not below, f"{file.relative_to(PACKAGE)} imports {', '.join(sorted(below))}"


def test_every_module_is_in_a_room():
    modules = {path.stem for path in PACKAGE.glob("*.py")} | {path.parent.name for path in PACKAGE.glob("*/*.py")}
    assert modules - {"__init__"} <= set(ROOMS)


def test_version_is_the_installed_one():
    assert jaxnav.__version__ == importlib.metadata.version("jaxnav")


def test_every_public_name_exists():
    assert len(set(jaxnav.__all__)) == len(jaxnav.__all__)
    for name in jaxnav.__all__:
        assert hasattr(jaxnav, name), name


def test_importing_jaxnav_leaves_the_heavy_libraries_alone():
    heavy = ["torch", "matplotlib", "orbax", "cv2", "tyro"]
    code = f"import sys, jaxnav; print(*[name for name in {heavy} if name in sys.modules])"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert result.stdout.split() == []
