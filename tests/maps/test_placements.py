"""Starts, goals and crossing lines: clear of walls, joined by a short path, and timed to meet."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.sparse.csgraph import dijkstra

from jaxnav.maps import occupancy, paths, placements, polygons
from jaxnav.world.geometry import Vec2, closest_on_segment

FAST, SLOW = 0.6, 0.5


def draw(scene, count=3000, robot_speed=FAST, speed=SLOW, seed=0):
    """(robots, pedestrians) `[count, 4]` of a scene, under jit."""
    u = jax.random.uniform(jax.random.key(seed), (12, count))
    robots, walkers = jax.jit(scene.meet)(list(u), robot_speed, speed)
    x, y, _, _, goal_x, goal_y = walkers
    return np.stack(robots, axis=1).astype(float), np.stack([x, y, goal_x, goal_y], axis=1).astype(float)


def strolls(scene):
    """All lines `[1024, 4]` of those who stroll."""
    x, y, _, _, goal_x, goal_y = scene.stroll([(jnp.arange(1024) + 0.5) / 1024])
    return np.stack([x, y, goal_x, goal_y], axis=1)


def gap_along(lines, walls, flat):
    """Distance `[N]` of lines to the walls, and whether all of a line is in free space, from points 2 cm apart."""
    steps = np.linspace(0, 1, 400)[:, None]
    gaps, free = [], []
    for line in lines:
        points = line[:2] + steps * (line[2:] - line[:2])
        gaps.append(flat.distances(points, walls).min())
        free.append(flat.inside(points, walls).all())
    return np.array(gaps), np.array(free)


def test_starts_goals_and_pedestrians_lines_keep_clear_of_the_walls(scene, flat):
    walls = flat.wall_array(scene.chains)
    robots, walkers = draw(scene)
    for points in (robots[:, :2], robots[:, 2:]):
        assert flat.distances(points, walls).min() >= 0.3 - 1e-5
        assert flat.inside(points, walls).all()
    gaps, free = gap_along(np.concatenate([walkers[:100], strolls(scene)[:100]]), walls, flat)
    assert gaps.min() >= 0.3 - 1e-5
    assert free.all()


def test_strolls_are_2_to_8_m_long(scene):
    lines = strolls(scene)
    assert len(np.unique(lines, axis=0)) > 1000
    lengths = np.hypot(*(lines[:, 2:] - lines[:, :2]).T)
    assert lengths.min() >= 2.0 - 1e-4 and lengths.max() <= 8.0 + 1e-4


def test_a_path_joins_start_and_goal_and_is_no_long_detour(scene, flat, request):
    """By Dijkstra over free space, whose steps to eight neighbours are at most 8.3 % too long."""
    file = request.getfixturevalue("house_file") if scene.name.endswith("house.yaml") else scene.name
    building = occupancy.read(file)
    free = building.cells == occupancy.FREE
    graph, centres = paths._graph(free)
    robots, _ = draw(scene)
    length = np.hypot(*(robots[:, 2:] - robots[:, :2]).T)
    assert length.min() >= 4.0 - 1e-4 and length.max() <= 8.0 + 1e-4
    for robot, straight in zip(robots[:40], length, strict=False):
        start, goal = (np.argmin(np.hypot(*(centres - building.to_cells(end)).T)) for end in (robot[:2], robot[2:]))
        way = dijkstra(graph, indices=start)[goal] * building.resolution
        assert way <= 1.3 * 1.083 * straight + 0.1


@pytest.fixture(scope="module")
def hall():
    """`Meetings` in an empty room of 9 x 9 m: every path is straight."""
    building = occupancy.OccupancyMap(np.zeros((180, 180), np.uint8), 0.05, (-4.5, -4.5, 0.0))
    free = np.ones((180, 180), bool)
    walls = polygons.edges([building.to_world(chain) for chain in polygons.wall_chains(free, 1.0)])
    room = placements.standing_room(free, 6.0)
    rng = np.random.default_rng(0)
    lines = placements.sample_lines(rng, building, room, walls, 2000, 0.3)
    return placements.sample_meetings(rng, building, room, walls, lines, 2000, (4.0, 8.0), 1.3, 0.3)


def test_who_gives_way_to_nobody_is_touched(hall):
    """Robot and pedestrian walk straight on; the pedestrian's line has room enough to be on time."""
    assert hall.x.size == 2000
    u = np.stack([(np.arange(2000) + 0.5) / 2000, np.full(2000, 0.5)])
    (x, y, goal_x, goal_y), (px, py, _, _, pgx, pgy) = (
        np.array(part, float) for part in placements.meet(hall)(u, FAST, SLOW)
    )
    length, walk = np.hypot(goal_x - x, goal_y - y), np.hypot(pgx - px, pgy - py)
    ux, uy, vx, vy = (goal_x - x) / length, (goal_y - y) / length, (pgx - px) / walk, (pgy - py) / walk
    t = np.linspace(0, 20, 2001)[:, None]
    robot = x + np.minimum(FAST * t, length) * ux, y + np.minimum(FAST * t, length) * uy
    walker = px + np.minimum(SLOW * t, walk) * vx, py + np.minimum(SLOW * t, walk) * vy
    nearest = np.hypot(robot[0] - walker[0], robot[1] - walker[1]).min(axis=0)
    assert nearest.max() < 0.27  # their radii are 0.17 and 0.1 m
    # They meet in the middle of the way, from any direction but the robot's own, and the pedestrian walks on.
    along = (hall.meet_x - x) * ux + (hall.meet_y - y) * uy
    np.testing.assert_allclose(along, hall.distance, atol=0.26)
    assert (hall.distance / length).min() >= 0.35 - 1e-3 and (hall.distance / length).max() <= 0.7 + 1e-3
    turn = np.arccos(np.clip(ux * vx + uy * vy, -1, 1))
    assert turn.min() >= 0.84 - 1e-3 and turn.max() > 3.0
    on = np.hypot(pgx - hall.meet_x, pgy - hall.meet_y)
    assert on.min() >= 1.2 - 1e-3 and on.max() <= 3.0 + 1e-3


@pytest.mark.parametrize(("speed", "robot_speed"), [(0.5, 0.6), (0.2, 0.6), (1.2, 0.6), (0.5, 0.3)])
def test_the_pedestrian_starts_where_its_speed_says_or_as_far_as_its_line_reaches(office, speed, robot_speed):
    table = office.meet.table
    u = np.stack([(np.arange(table.x.size) + 0.5) / table.x.size, np.linspace(0, 1, table.x.size)])
    _, (px, py, *_) = office.meet(u, robot_speed, speed)
    behind = np.hypot(px - table.meet_x, py - table.meet_y)
    wanted = speed / robot_speed * table.distance + 0.8 * (u[1] - 0.5)
    np.testing.assert_allclose(behind, np.clip(wanted, 0, table.behind), atol=1e-4)
    assert np.mean(wanted <= table.behind) > (0.9 if speed / robot_speed < 0.84 else 0.05)


def test_all_of_the_table_is_drawn_evenly_and_by_seed(office, scene):
    robots, walkers = draw(scene, count=8000)
    table = scene.meet.table
    assert table.x.size > 3000
    drawn = 1 - np.exp(-8000 / table.x.size)  # of the rows, by chance
    rows = np.unique(np.concatenate([robots, walkers[:, 2:]], axis=1), axis=0)
    assert rows.shape[0] == pytest.approx(drawn * table.x.size, rel=0.05)
    assert np.unique(robots, axis=0).shape[0] > 900  # each of 1,025 paths up to four times
    np.testing.assert_array_equal(robots, draw(scene, count=8000)[0])
    u = np.full(12, 1 - 2**-24, np.float32)  # the largest number that jax draws
    assert office.meet(u, FAST, SLOW)[0][0] == office.meet.table.x[-1]
    assert all(leaf.dtype == np.float32 for leaf in table)
    assert np.isfinite(walkers).all()


def test_paths_turn_at_a_corner_and_are_as_short_as_they_can_be():
    """Around a wall that reaches half across a room: the shortest way is over the wall's end."""
    mask = np.ones((60, 60), bool)
    mask[:40, 30] = False
    rng = np.random.default_rng(0)
    found = paths.sample_paths(rng, mask, 400, (20.0, 50.0), 1.3)
    assert len(found) == 400
    blocked = 0
    for path in found:
        a, b = path[0], path[-1]
        crossing = a[1] + (30.5 - a[0]) / (b[0] - a[0]) * (b[1] - a[1]) if (a[0] - 30.5) * (b[0] - 30.5) < 0 else 60.0
        straight = np.hypot(*(b - a))
        assert 20 <= straight <= 50 and paths.length(path) <= 1.3 * straight
        if min(abs(a[0] - 30.5), abs(b[0] - 30.5)) < 3:
            continue
        if crossing < 39:
            blocked += 1
            around = sum(np.hypot(*(end - (30.5, 40.0))) for end in (a, b))
            assert around - 1.5 <= paths.length(path) <= 1.06 * around
        elif crossing > 42:
            assert len(path) == 2
    assert blocked > 20


def test_along_walks_a_path_by_its_length():
    path = np.array([[0.0, 0.0], [3.0, 0.0], [3.0, 2.0]])
    for distance, point, way in ((1.0, (1, 0), (1, 0)), (4.0, (3, 1), (0, 1)), (5.0, (3, 2), (0, 1))):
        found = paths.along(path, distance)
        np.testing.assert_allclose(found, (point, way), atol=1e-12)


def test_reach_ends_at_what_is_in_the_way_and_at_its_limit():
    mask = np.ones((5, 20), bool)
    mask[2, 12] = False
    starts, ways = np.array([[2.2, 2.5]] * 3), np.array([[1.0, 0.0], [-1.0, 0.0], [1.0, 0.0]])
    np.testing.assert_allclose(paths.reach(mask, starts, ways, np.array([99.0, 99.0, 4.0])), [9.5, 2.0, 4.0])


def test_clear_of_is_the_distance_of_lines_to_walls(flat):
    """Against the world's own distance of points to walls, at points along the lines."""
    rng = np.random.default_rng(0)
    walls, lines = rng.uniform(-2, 2, (30, 4)), rng.uniform(-2, 2, (400, 4))
    steps = np.linspace(0, 1, 300)[:, None, None]
    x, y = (lines[:, i] + steps[..., 0] * (lines[:, i + 2] - lines[:, i]) for i in (0, 1))
    qx, qy = closest_on_segment(Vec2(x[..., None], y[..., None]), Vec2(*walls.T[:2]), Vec2(*walls.T[2:]))
    sampled = np.hypot(qx - x[..., None], qy - y[..., None]).min(axis=(0, 2))
    for clearance in (0.02, 0.1, 0.3):
        clear = placements.clear_of(walls, lines, clearance)
        sure = np.abs(sampled - clearance) > 0.01
        np.testing.assert_array_equal(clear[sure], sampled[sure] >= clearance)
        assert clear.any() == (clearance < 0.3) or clear.any()
