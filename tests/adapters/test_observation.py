"""What foreign learners see, and what they are told when a package is missing."""

import importlib
import sys

import jax
import numpy as np
import pytest

from jaxnav import Params, World, WorldConfig
from jaxnav.adapters import observation
from jaxnav.world import Observation
from jaxnav.world.types import ObservedDialogue


def observed(**parts):
    """An observation of two pedestrians: the first asks the robot to go right, the second refused to stop."""
    heard = ObservedDialogue(
        is_open=np.array([1, 0]), pedestrian_first=np.array([1, 0]), message=np.array([2, 0]),
        message_age=np.array([4, 0]), request=np.array([0, 1]), request_age=np.array([0, 37]),
        reply=np.array([0, 2]), utterance=np.array([70000, 0], np.uint32),
    )  # fmt: skip
    return Observation(
        pose=np.arange(9, dtype=np.float32).reshape(3, 3), twist=np.array([0.5, -0.25], np.float32),
        may_request=np.bool_(True), scan=np.array([0.0, 3.0, 6.0], np.float32),
        pedestrians=np.arange(8, dtype=np.float32).reshape(2, 4), dialogue=heard, **parts,
    )  # fmt: skip


def test_parts_say_what_the_docstring_says():
    seen = observation.parts(observed(), Params(scan_range=6.0))
    assert list(seen) == ["pose", "twist", "may_request", "scan", "pedestrians", "dialogue"]
    assert {part.dtype for part in seen.values()} == {np.dtype(np.float32)}
    np.testing.assert_array_equal(seen["may_request"], [1.0])
    np.testing.assert_array_equal(seen["scan"], [0.0, 0.5, 1.0])
    #           open first ages       message     request     reply
    expected = [[1, 1, 0.4, 0.0, 0, 0, 1, 0, 1, 0, 0, 0, 1, 0, 0], [0, 0, 0.0, 1.0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]]
    np.testing.assert_array_equal(seen["dialogue"], np.array(expected, np.float32))


def test_the_vector_is_the_parts_in_the_order_of_the_fields():
    vector = observation.flat(observed(), Params(scan_range=6.0))
    assert vector.shape == (9 + 2 + 1 + 3 + 8 + 30,)
    np.testing.assert_array_equal(vector[:12], [*range(9), 0.5, -0.25, 1.0])
    np.testing.assert_array_equal(vector[15:23], range(8))
    # The same under jit, which sorts dicts by their keys.
    np.testing.assert_array_equal(jax.jit(observation.flat)(observed(), Params(scan_range=6.0)), vector)


@pytest.mark.parametrize(
    ("config", "expected"),
    [
        (
            WorldConfig(pedestrians=6, beams=7),
            {
                "pose": (3, 3),
                "twist": (2,),
                "may_request": (1,),
                "scan": (7,),
                "pedestrians": (4, 4),
                "seen": (4,),
                "dialogue": (4, 15),
            },
        ),
        (
            WorldConfig(observation=("sensor_map", "pedestrian_map")),
            {"pose": (3, 3), "twist": (2,), "may_request": (1,), "sensor_map": (48, 48), "pedestrian_map": (3, 48, 48)},
        ),
    ],
)
def test_shapes_are_those_of_the_world_without_what_it_leaves_out(config, expected):
    assert observation.shapes(World(config)) == expected


@pytest.mark.parametrize("package", ["gymnax", "gymnasium", "brax"])
def test_a_missing_package_is_named_with_the_remedy(package, monkeypatch):
    for name in {package, *sys.modules}:
        if name.split(".")[0] == package:
            monkeypatch.setitem(sys.modules, name, None)
    monkeypatch.delitem(sys.modules, f"jaxnav.adapters.{package}", raising=False)
    with pytest.raises(ImportError, match=f'jaxnav.adapters.{package} needs {package}: pip install "{package}>='):
        importlib.import_module(f"jaxnav.adapters.{package}")
