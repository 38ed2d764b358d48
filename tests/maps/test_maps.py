"""Loading a map as a scene, and what is said when it can't be one."""

import numpy as np
import pytest

from jaxnav import maps

WHITE, BLACK = 254, 0


def room(rows, columns):
    """An image of one free room in a wall of two cells."""
    image = np.full((rows + 4, columns + 4), BLACK, np.uint8)
    image[2:-2, 2:-2] = WHITE
    return image


def area(chain):
    x, y = np.array(chain).T
    return 0.5 * np.sum(x * np.roll(y, -1) - y * np.roll(x, -1))


def test_an_empty_room_is_one_chain_in_metres_turned_by_yaw(write_map):
    """Room of 6 x 5 m, its corner 0.1 m from that of the image."""
    scene = maps.load(write_map(room(100, 120), origin=[1.0, 2.0, np.pi / 2]), meetings=64)
    (chain,) = scene.chains
    corners = {(round(x, 4), round(y, 4)) for x, y in chain}
    assert corners == {(0.9, 2.1), (0.9, 8.1), (-4.1, 8.1), (-4.1, 2.1)}
    assert area(chain) == pytest.approx(30.0, abs=1e-4)
    assert scene.capacity == 23  # 5.4 x 4.4 m of standing room, a square metre each
    assert scene.cells.walls.shape == (6, 5, 4)
    assert sorted(scene.cells.walls[3, 2]) == [0, 1, 2, 3]


def test_the_office_is_one_floor_around_two_obstacles(office):
    """The pillar of 0.4 x 0.4 m and the cupboard of 0.6 x 1.5 m, in rooms that doors join."""
    assert [np.sign(area(chain)) for chain in office.chains].count(1) == 1
    assert sorted(round(area(chain), 2) for chain in office.chains)[:2] == [-0.9, -0.16]
    assert office.name.endswith("office.yaml")


def test_the_house_has_nine_pillars_in_an_arena(house):
    areas = np.sort([area(chain) for chain in house.chains])
    assert len(areas) == 10 and areas[-1] == pytest.approx(20.8, abs=0.6)
    assert np.all(areas[:9] < -0.05) and np.all(areas[:9] > -0.16)


def test_unknown_and_unreachable_parts_are_no_floor(write_map):
    image = np.concatenate([room(100, 120), np.pad(room(40, 40), ((0, 60), (0, 0)))], axis=1)
    image[50:60, 40:50] = 205
    scene = maps.load(write_map(image), meetings=64)
    assert sorted(round(area(chain), 2) for chain in scene.chains) == [-0.25, 30.0]


def test_loading_is_deterministic_and_the_seed_counts(write_map):
    path = write_map(room(100, 120))
    one, again, other = (maps.load(path, meetings=64, seed=seed) for seed in (0, 0, 1))
    u = [np.linspace(0, 1, 50, endpoint=False)]
    np.testing.assert_array_equal(one.stroll(u), again.stroll(u))
    np.testing.assert_array_equal(one.meet.table.meet_x, again.meet.table.meet_x)
    assert not np.array_equal(one.stroll(u), other.stroll(u))


@pytest.mark.parametrize(
    ("image", "fields", "said"),
    [
        (np.zeros((50, 50), np.uint8), {}, "no free space: check negate"),
        (np.full((50, 50), 205, np.uint8), {}, "no free space"),
        (room(100, 120), {"negate": 1}, "no free space with 0.3 m of clearance: check the resolution, 0.05"),
        (room(10, 200), {}, "no free space with 0.3 m of clearance"),
        (room(40, 40), {}, "4.0 m apart, but .* extends over 1.98 m"),
        (np.concatenate([room(50, 50)] * 4, axis=1), {}, "4.0 m apart, but .* extends over 2.69 m"),
        (room(14, 120), {"resolution": 0.05}, None),
    ],
)
def test_a_map_in_which_nobody_can_go_anywhere_is_refused(write_map, image, fields, said):
    path = write_map(image, **fields)
    if said is None:
        assert maps.load(path, meetings=16).meet.table.x.size == 16
        return
    with pytest.raises(ValueError, match=said) as error:
        maps.load(path)
    assert str(path) in str(error.value)


def test_a_resolution_that_makes_a_room_a_town_is_refused(write_map):
    """5.0 for 0.05."""
    path = write_map(room(100, 120), resolution=5.0)
    with pytest.raises(ValueError, match=r"600 x 500 m, .* 5.0 m a pixel for an image of 124 x 104") as error:
        maps.load(path)
    assert str(path) in str(error.value)


def test_a_goal_that_only_a_long_way_round_reaches_is_none(write_map):
    """Three corridors in a U, each too short for start and goal: around a corner it is a fifth farther."""
    image = room(80, 100)
    image[2:62, 22:82] = BLACK
    path = write_map(image)
    with pytest.raises(ValueError, match=r"no goal 4.6 to 8.0 m from a start can be reached on a path of at most 1.05"):
        maps.load(path, distances=(4.6, 8.0), detour=1.05)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"clearance": 0.0}, "clearance is 0.0: give a finite number above 0"),
        ({"cell": -1.0}, "cell is -1.0"),
        ({"cell": np.inf}, "cell is inf"),
        ({"cell": 0.02}, "6 x 5 m, which is more than 40,000 cells of 0.02 m: .* or give a larger cell"),
        ({"scan_range": float("nan")}, "scan_range is nan"),
        ({"margin": "wide"}, "margin is wide"),
        ({"meetings": 0}, "meetings is 0"),
        ({"meetings": 1.5}, "meetings is 1.5: give a whole number of at least 1"),
        ({"strolls": None}, "strolls is None"),
        ({"seed": -1}, "seed is -1: give a whole number of at least 0"),
        ({"distances": (8.0, 4.0)}, r"distances is \(8.0, 4.0\)"),
        ({"distances": (4,)}, r"distances is \(4,\): give the least, above 0, and the greatest"),
        ({"distances": None}, "distances is None"),
        ({"distances": (4.0, np.inf)}, "distances is "),
        ({"detour": 0.9}, "detour is 0.9: give at least 1"),
        ({"detour": None}, "detour is None"),
        ({"tolerance": -0.1}, "tolerance is -0.1: give at least 0 metres"),
        ({"tolerance": np.inf}, "tolerance is inf"),
    ],
)
def test_an_option_out_of_range_is_named(write_map, options, said):
    with pytest.raises(ValueError, match=said):
        maps.load(write_map(room(100, 120)), **options)
