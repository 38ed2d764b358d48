"""The layer that only ever slows down: what it promises for any points, and in worlds where somebody wants a crash."""

import dataclasses
import itertools
import json
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from experiments.exporting import navigated
from jaxnav.export.modules import modules
from jaxnav.training.config import preset, resolve
from jaxnav.training.run import Run


@pytest.fixture(scope="module")
def layer(bundles):
    folder = bundles("lidar")[2]
    contract = json.loads((folder / "contract.json").read_text())
    with modules(folder, "safety") as (safety,):
        yield safety.SafetyLayer(contract), contract, safety.SafetyLayer


def path(v, w, time, times=200):
    """Where the robot is within that time, in small steps of its own."""
    x = y = heading = 0.0
    places = [(x, y)]
    for _ in range(times):
        heading += 0.5 * w * time / times
        x, y = x + v * time / times * math.cos(heading), y + v * time / times * math.sin(heading)
        heading += 0.5 * w * time / times
        places.append((x, y))
    return np.array(places)


points = st.lists(st.tuples(st.floats(-0.8, 0.8), st.floats(-0.8, 0.8)), max_size=12)


@given(points=points, v=st.floats(0.0, 0.6), w=st.floats(-0.9, 0.9))
def test_it_only_slows_and_then_touches_nothing(layer, points, v, w):
    safety, contract, _ = layer
    points = np.array(points).reshape(-1, 2)
    slower = safety(v, w, points)
    assert 0.0 <= slower <= v
    places = path(slower, w, contract["control"]["period"])
    away = np.hypot(*(points[:, None] - places).T)
    # Who is nearer already must not be approached any further.
    least = np.minimum(contract["robot"]["radius"] + 0.01, np.hypot(*points.T) - 2e-3)
    assert (away >= least).all()


def test_it_stops_in_time_before_a_wall(layer):
    """Step by step at full speed toward a wall: it slows, comes close, and stands with a gap."""
    safety, contract, _ = layer
    x, period = 0.0, contract["control"]["period"]
    speeds = []
    for _ in range(60):
        wall = np.stack([np.full(181, 2.0 - x), np.linspace(-1.0, 1.0, 181)], axis=1)
        speeds.append(safety(0.6, 0.0, wall))
        x += period * speeds[-1]
    gap = 2.0 - x - contract["robot"]["radius"]
    assert contract["safety"]["gap"] <= gap < 0.05
    assert speeds[0] == 0.6 and speeds[-1] < 0.02 and all(b <= a for a, b in itertools.pairwise(speeds))


@pytest.mark.parametrize("age", [0.0, 0.1, 0.3, 0.45])
@pytest.mark.parametrize("period", [0.05, 0.1, 0.2])
def test_old_scans_are_taken_for_old(layer, age, period):
    """An adversary at full speed, and a laser that is late: it never touches the wall, and it gets near."""
    safety, contract, _ = layer
    x, v, places = 0.0, 0.6, [0.0]
    for _ in range(300):
        seen = places[max(len(places) - 1 - round(age / period), 0)]
        wall = np.stack([np.full(181, 2.0 - seen), np.linspace(-1.0, 1.0, 181)], axis=1)
        v = safety(0.6, 0.0, wall, age)
        x += period * v
        places.append(x)
    gap = 2.0 - x - contract["robot"]["radius"]
    assert 0.0 < gap < 0.1


def test_what_a_laser_can_not_see_is_kept_away(layer):
    """A wall that is nearer than it can measure vanishes, and would be hit then."""
    safety, _, _ = layer
    x, blind = 0.0, 0.3
    for _ in range(200):
        wall = np.stack([np.full(181, 2.0 - x), np.linspace(-1.0, 1.0, 181)], axis=1)
        x += 0.1 * safety(0.6, 0.0, wall[np.hypot(*wall.T) > blind], blind=blind)
    assert 2.0 - x > blind


def test_a_larger_or_slower_robot_stops_earlier(layer):
    _, contract, make = layer
    wall = np.stack([np.full(181, 0.6), np.linspace(-1.0, 1.0, 181)], axis=1)
    usual = make(contract)(0.6, 0.0, wall)
    larger = make(contract, radius=0.3)(0.6, 0.0, wall)
    slower = make(contract, deceleration=0.3)(0.6, 0.0, wall)
    assert 0 < larger < usual <= 0.6 and 0 < slower < usual
    assert 0 < make(contract, gap=0.1)(0.6, 0.0, wall) < usual
    assert make(contract)(0.6, 0.0, wall, blind=0.3) < usual
    for name in ("radius", "deceleration", "gap"):
        with pytest.raises(ValueError, match=f"{name} is -1: give a number above 0"):
            make(contract, **{name: -1})


def test_it_may_leave_what_it_already_touches(layer):
    safety, _, _ = layer
    behind = np.array([[-0.17, 0.0], [-0.15, 0.05]])
    assert safety(0.5, 0.0, behind) == 0.5
    assert safety(0.5, 0.0, -behind) == 0.0


def test_no_adversary_hits_a_wall(bundles, robot, full):
    """Full speed, toward the nearest obstacle; without the layer nearly all of them hit one."""
    base = preset("quick")
    world = base.world.of_scenes(("narrow", "corner"))
    world = dataclasses.replace(world, params=world.params.replace(max_steps=25.0))
    run = Run(resolve(dataclasses.replace(base, world=world, out="runs/none")))
    folder, policy, navigator, scans = robot("lidar")
    scan_of, episodes = navigated.laser(scans, run), 500 if full else 12
    hits = {}
    for safety in (True, False):
        ends, share = navigated.by_navigators(
            navigated.Worlds(run, 1, episodes), lambda safety=safety: navigator.Navigator(str(folder), safety=safety),
            scan_of, navigated.adversary(policy, run),
        )  # fmt: skip
        hits[safety] = ends.hit_wall.sum()
        assert (share > 0.5) == safety
    assert hits[True] == 0 and hits[False] > 0.6 * 2 * episodes
