"""What is seen from a cell: never too little, and much less than all."""

import cv2
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxnav import maps
from jaxnav.maps import occupancy, polygons, visibility
from jaxnav.world import World, WorldConfig, lidar
from jaxnav.world.geometry import Vec2

BEAMS = 181
LIMIT = 12.0


def poses(scene, flat, count, seed=0):
    """Random x, y, heading `[count, 3]` in free space."""
    rng = np.random.default_rng(seed)
    walls = flat.wall_array(scene.chains)
    low, high = walls.reshape(-1, 2).min(axis=0), walls.reshape(-1, 2).max(axis=0)
    points = rng.uniform(low, high, (20 * count, 2))
    points = points[flat.inside(points, walls)][:count]
    return np.column_stack([points, rng.uniform(-np.pi, np.pi, len(points))]).astype(np.float32)


def listed(cells, x, y):
    """The row of the table for a point."""
    column, row = ((value - low) // cells.size for value, low in ((x, cells.x), (y, cells.y)))
    return cells.walls[row.astype(int), column.astype(int)]


def scans(scene):
    """A function from poses `[N, 3]` to ranges `[N, BEAMS]` by the world's own raycast, with cells and without."""
    walls = World(WorldConfig(scenes=(scene.name,)), [scene]).walls(0)
    directions = lidar.beam_directions(BEAMS)

    def scan(pose, walls):
        x, y, heading = pose
        return lidar.raycast(Vec2(x, y), Vec2(jnp.cos(heading), jnp.sin(heading)), walls.near(x, y), directions, LIMIT)

    return [jax.jit(jax.vmap(lambda pose, w=w: scan(pose, w))) for w in (walls, walls.replace(cells=None))]


def test_ranges_are_those_to_all_walls(scene, flat):
    walls = flat.wall_array(scene.chains).astype(np.float32)
    at = poses(scene, flat, 300)
    culled, exhaustive = (np.asarray(scan(jnp.asarray(at, jnp.float32))) for scan in scans(scene))
    # The same walls in another loop: no more than a rounding apart.
    np.testing.assert_allclose(culled, exhaustive, rtol=1e-5, atol=1e-5)
    # And they are ranges: those of an independent float64 computation.
    for pose, measured in zip(at[:40], culled, strict=False):
        angles = pose[2] + np.linspace(-np.pi / 2, np.pi / 2, BEAMS)
        around = [flat.ranges(walls, pose[0], pose[1], angles + delta, LIMIT) for delta in (-2e-5, 0.0, 2e-5)]
        assert np.all(measured >= np.min(around, axis=0) - 2e-3)
        assert np.all(measured <= np.max(around, axis=0) + 2e-3)


@pytest.fixture
def block_of_rooms(write_map):
    """54 rooms of 6 x 6 m in six rows, and doors of 1 m between all neighbours, those in a line not opposite."""
    side, wall, door = 60, 2, 10
    pitch = side + wall
    image = np.zeros((6 * pitch + wall, 9 * pitch + wall), np.uint8)
    for row, column in np.ndindex(6, 9):
        y, x = row * pitch + wall, column * pitch + wall
        image[y : y + side, x : x + side] = 254
        if column:
            at = y + 5 + 15 * ((row + column) % 3)
            image[at : at + door, x - wall : x] = 254
        if row:
            at = x + 5 + 15 * ((column + 2 * row) % 3)
            image[y - wall : y, at : at + door] = 254
    return maps.load(write_map(image, resolution=0.1), meetings=64, strolls=64)


def test_few_walls_of_many_rooms_are_tested(block_of_rooms, flat):
    """A building of 56 x 37 m: a beam tests one padded row of the table, and the ranges are those to all walls."""
    total = sum(len(chain) for chain in block_of_rooms.chains)
    assert total > 500
    assert block_of_rooms.cells.walls.shape[-1] < total / 5
    at = poses(block_of_rooms, flat, 300, seed=2)
    culled, exhaustive = (np.asarray(scan(jnp.asarray(at))) for scan in scans(block_of_rooms))
    np.testing.assert_allclose(culled, exhaustive, rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize(("name", "tolerance"), [("office", 0.0), ("house", np.sqrt(2))])
def test_ranges_are_those_in_the_image(name, tolerance, flat, request):
    """A march through the image, where what isn't free grows or shrinks by the tolerance of the walls, in cells.

    The office's walls are along its cells: simplifying changes nothing.
    """
    scene = request.getfixturevalue(name)
    building = occupancy.read(request.getfixturevalue("house_file") if name == "house" else scene.name)
    walls = flat.wall_array(scene.chains)
    fine = 8  # pixels a cell
    free = np.kron(np.pad(building.cells == occupancy.FREE, 1), np.ones((fine, fine), np.uint8))
    from_wall, from_free = (
        cv2.distanceTransform(mask, cv2.DIST_L2, cv2.DIST_MASK_PRECISE) for mask in (free, 1 - free)
    )
    slack = fine * tolerance + 1.5
    at = poses(scene, flat, 60, seed=1)
    angles = np.linspace(-np.pi, np.pi, 61)
    measured = np.array(
        [flat.ranges(walls[listed(scene.cells, x, y)], x, y, heading + angles, LIMIT) for x, y, heading in at]
    )
    steps = np.arange(0, LIMIT / building.resolution, 0.1)
    way = np.stack([np.cos(at[:, 2:] + angles), np.sin(at[:, 2:] + angles)], axis=-1)[:, :, None]
    points = building.to_cells(at[:, :2])[:, None, None] + steps[:, None] * way
    column, row = np.clip((fine * (points + 1)).astype(int), 0, np.array(free.shape[::-1]) - 1).transpose(3, 0, 1, 2)

    def marched(blocked):
        hit = blocked[row, column]
        return np.where(hit.any(axis=2), steps[hit.argmax(axis=2)] * building.resolution, LIMIT)

    assert np.all(measured >= marched(from_wall <= slack) - 0.01)
    assert np.all(measured <= marched(from_free > slack) + 0.01)
    # Nearly all of them to a cell more than the tolerance: the rest pass an edge or graze along a wall.
    plain = np.abs(measured - marched(free == 0)) <= (tolerance + 1) * building.resolution
    assert plain.mean() > 0.9


@settings(max_examples=20)
@given(seed=st.integers(0, 100_000), size=st.sampled_from([3.0, 8.0, 17.0]), limit=st.sampled_from([12.0, 60.0]))
def test_no_wall_is_missed_in_random_caves(flat, seed, size, limit):
    """First hits of beams from anywhere in a cell or within its margin, exactly."""
    free = polygons.simple_border(flat.blobs(seed))
    chains = polygons.wall_chains(free, 1.0)
    walls = flat.wall_array([chain.tolist() for chain in chains])
    cells = visibility.visible_walls(chains, size, 1.5, limit)
    rng = np.random.default_rng(seed)
    points = rng.uniform((0, 0), free.shape[::-1], (300, 2))
    points = points[flat.inside(points, walls)][:60]
    for x, y in points:
        angles = rng.uniform(-np.pi, np.pi, 120)
        exhaustive = flat.ranges(walls, x, y, angles, limit)
        for dx, dy in ((0.0, 0.0), (1.4, -1.4)):
            column, row = int((x + dx - cells.x) // size), int((y + dy - cells.y) // size)
            if 0 <= row < cells.walls.shape[0] and 0 <= column < cells.walls.shape[1]:
                chosen = cells.walls[row, column]
                if chosen[0] >= 0:  # else nobody is in that cell
                    np.testing.assert_array_equal(
                        flat.ranges(walls[chosen[chosen >= 0]], x, y, angles, limit), exhaustive
                    )


def test_lists_are_close_to_what_is_really_seen(scene, flat):
    """All that beams hit from many points of a cell is in its list, and not much else."""
    walls = flat.wall_array(scene.chains)
    cells = scene.cells
    rng = np.random.default_rng(0)
    spent = needed = 0
    for row, column in np.argwhere(cells.walls[..., 0] >= 0)[::3]:
        corner = np.array([cells.x, cells.y]) + cells.size * np.array([column, row])
        points = corner + rng.uniform(-0.3, cells.size + 0.3, (25, 2))
        points = points[flat.inside(points, walls)]
        seen = set()
        for x, y in points:
            angles = rng.uniform(-np.pi, np.pi, 300)
            each = np.stack([flat.ranges(walls[[i]], x, y, angles, LIMIT) for i in range(len(walls))])
            seen |= set(each.argmin(axis=0)[each.min(axis=0) < LIMIT])
        entries = cells.walls[row, column]
        assert seen <= set(entries)
        spent, needed = spent + np.count_nonzero(entries >= 0), needed + len(seen)
    assert spent < 1.5 * needed


def test_the_office_is_culled(office):
    total = sum(len(chain) for chain in office.chains)
    count = np.count_nonzero(office.cells.walls >= 0, axis=-1)
    assert count.max() == office.cells.walls.shape[-1] < 0.8 * total
    assert count[count > 0].mean() < 0.6 * total


def test_a_block_hides_what_is_behind_it_and_its_own_back():
    """A room of 20 x 10 m, a block across most of it: from the far left the right wall is hidden."""
    room = np.array([[0, 0], [20, 0], [20, 10], [0, 10]], float)
    block = np.array([[10, 0.5], [10, 9.5], [13, 9.5], [13, 0.5]], float)
    cells = visibility.visible_walls([room, block], 1.0, 0.0, 50.0)
    bottom, right, top, left, front, cap, back, foot = range(8)
    assert set(cells.walls[5, 8]) - {-1} == {bottom, top, left, front}
    assert set(cells.walls[5, 15]) - {-1} == {bottom, right, top, back}
    assert right in cells.walls[9, 2]  # along the gap above the block
    assert cap in cells.walls[9, 2] and foot not in cells.walls[9, 2]
    assert np.all(cells.walls[3, 11] == -1)  # in the block
    near = visibility.visible_walls([room, block], 1.0, 0.0, 3.0)
    assert set(near.walls[5, 5]) - {-1} == set()
    assert set(near.walls[5, 1]) - {-1} == {left}


@pytest.mark.parametrize("bend", [0.0, 0.15, -0.15])
def test_walls_of_a_chain_hide_together(bend):
    """A screen, straight or bent, of many short walls: none of them would hide the far wall alone."""
    room = np.array([[0, 0], [20, 0], [20, 10], [0, 10]], float)
    y = np.linspace(0.5, 9.5, 19)
    front = np.column_stack([10 + bend * np.sin(y * 7), y])
    block = np.concatenate([front, front[::-1] + np.array([0.4, 0.0])])
    cells = visibility.visible_walls([room, block], 1.0, 0.0, 50.0)
    assert 1 not in cells.walls[5, 8]
