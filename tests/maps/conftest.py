"""Maps written for a test, the two that are at hand, and float64 geometry that owes nothing to the package."""

import os
from pathlib import Path

import cv2
import numpy as np
import pytest

from jaxnav import maps

OFFICE = Path(__file__).parents[2] / "examples" / "office.yaml"


@pytest.fixture(scope="session")
def office():
    """Five rooms along a corridor, with a pillar and a cupboard: 12 x 9 m."""
    return maps.load(OFFICE)


@pytest.fixture(scope="session")
def house_file():
    """A map that SLAM made: an arena of 5 m with nine pillars."""
    if "JAXNAV_DATA" not in os.environ:
        pytest.skip("JAXNAV_DATA names no folder with maps/turtlebot3_house.yaml")
    return Path(os.environ["JAXNAV_DATA"]) / "maps" / "turtlebot3_house.yaml"


@pytest.fixture(scope="session")
def house(house_file):
    return maps.load(house_file)


@pytest.fixture(params=["office", "house"])
def scene(request):
    return request.getfixturevalue(request.param)


@pytest.fixture
def write_map(tmp_path):
    """(pixels, **fields) -> path of a yaml file in the test's own folder; a field of None is left out."""

    def write(pixels, **fields):
        cv2.imwrite(str(tmp_path / "map.png"), pixels)
        usual = {"image": "map.png", "resolution": 0.05, "origin": [0.0, 0.0, 0.0], "negate": 0}
        fields = usual | {"occupied_thresh": 0.65, "free_thresh": 0.196} | fields
        path = tmp_path / "map.yaml"
        path.write_text("\n".join(f"{name}: {value}" for name, value in fields.items() if value is not None))
        return path

    return write


def blobs(seed, shape=(40, 50)):
    """A random mask of smooth and of ragged shapes."""
    rng = np.random.default_rng(seed)
    noise = cv2.GaussianBlur(rng.random(shape).astype(np.float32), (0, 0), rng.uniform(0.4, 3.0))
    return noise > np.quantile(noise, rng.uniform(0.15, 0.8))


def wall_array(chains):
    return np.array([(*a, *b) for chain in chains for a, b in zip(chain, [*chain[1:], chain[0]], strict=True)])


def ranges(walls, x, y, angles, limit):
    """`[angles]` distance to the nearest of ``walls`` `[E, 4]`, ``limit`` at most: two straight lines a wall."""
    dx, dy = np.cos(angles)[:, None], np.sin(angles)[:, None]
    ax, ay, bx, by = walls.T
    ex, ey = bx - ax, by - ay
    area = dx * ey - dy * ex
    with np.errstate(divide="ignore", invalid="ignore"):
        t = ((ax - x) * ey - (ay - y) * ex) / area
        s = ((ax - x) * dy - (ay - y) * dx) / area
    return np.where((area != 0) & (t >= 0) & (s >= 0) & (s <= 1), t, limit).min(axis=1, initial=limit)


def distances(points, walls):
    """`[N]` from ``points`` `[N, 2]` to the nearest of ``walls`` `[E, 4]`."""
    a, e = walls[:, :2], walls[:, 2:] - walls[:, :2]
    t = np.clip(np.einsum("nec,ec->ne", points[:, None] - a, e) / np.sum(e * e, axis=1), 0, 1)
    return np.linalg.norm(points[:, None] - a - t[..., None] * e, axis=2).min(axis=1)


def inside(points, walls):
    """Whether ``points`` `[N, 2]` are in free space: an odd number of walls to the right."""
    ax, ay, bx, by = walls.T
    px, py = points.T[..., None]
    spans = (ay > py) != (by > py)
    at = ax + (py - ay) / np.where(by == ay, 1.0, by - ay) * (bx - ax)
    return np.count_nonzero(spans & (at > px), axis=1) % 2 == 1


@pytest.fixture(scope="session")
def flat():
    """The functions of this file."""
    return type("Flat", (), {f.__name__: staticmethod(f) for f in (blobs, wall_array, ranges, distances, inside)})
