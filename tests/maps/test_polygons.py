"""Wall polygons: closed, free space to the left, within the tolerance of the cells' border, apart from each other."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxnav.maps import polygons

MASKS = st.integers(0, 100_000)


def area(chain):
    x, y = np.array(chain).T
    return 0.5 * np.sum(x * np.roll(y, -1) - y * np.roll(x, -1))


def cells_inside(chains, shape, flat):
    """The mask of cells whose centre the chains enclose."""
    rows, columns = np.indices(shape)
    centres = np.stack([columns, rows], axis=-1).reshape(-1, 2) + 0.5
    return flat.inside(centres, flat.wall_array(chains)).reshape(shape)


def border_points(chains):
    """Points along the walls, a quarter of a cell apart at most."""
    walls = polygons.edges(chains)
    steps = np.ceil(4 * np.hypot(*(walls[:, 2:] - walls[:, :2]).T)).astype(int) + 1
    return np.concatenate([np.linspace(w[:2], w[2:], n) for w, n in zip(walls, steps, strict=True)])


@given(seed=MASKS)
def test_without_tolerance_the_chains_are_the_border_of_the_cells(flat, seed):
    free = polygons.simple_border(flat.blobs(seed))
    chains = polygons.wall_chains(free, 0.0)
    np.testing.assert_array_equal(cells_inside(chains, free.shape, flat), free)
    assert sum(area(chain) for chain in chains) == free.sum()
    # Just to the left of every wall is a free cell, just to the right is none.
    walls = polygons.edges(chains)
    middle, way = 0.5 * (walls[:, :2] + walls[:, 2:]), walls[:, 2:] - walls[:, :2]
    left = 0.1 * np.stack([-way[:, 1], way[:, 0]], axis=1) / np.hypot(*way.T)[:, None]
    padded = np.pad(free, 1)
    for side, is_free in ((left, True), (-left, False)):
        column, row = np.floor(middle + side).astype(int).T + 1
        assert np.all(padded[row, column] == is_free)


@settings(max_examples=25)
@given(seed=MASKS, tolerance=st.sampled_from([0.5, 1.0, 2.0]))
def test_simplified_chains_stay_within_the_tolerance_and_leave_nothing_out(flat, seed, tolerance):
    free = polygons.simple_border(flat.blobs(seed))
    exact, chains = polygons.wall_chains(free, 0.0), polygons.wall_chains(free, tolerance)
    assert len(chains) == len(exact)
    assert flat.distances(border_points(chains), polygons.edges(exact)).max() <= tolerance + 1e-6
    assert flat.distances(border_points(exact), polygons.edges(chains)).max() <= tolerance + 1e-6
    assert all(area(chain) * area(whole) > 0 for chain, whole in zip(chains, exact, strict=True))
    # Cells farther than the tolerance from the border are on their side of it.
    rows, columns = np.indices(free.shape)
    centres = np.stack([columns, rows], axis=-1).reshape(-1, 2) + 0.5
    far = flat.distances(centres, polygons.edges(exact)).reshape(free.shape) > tolerance
    np.testing.assert_array_equal(cells_inside(chains, free.shape, flat)[far], free[far])


def meet(p, q):
    """Whether two segments of whole numbers share a point: exact, by the case."""

    def turn(a, b, c):
        return int(np.sign((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])))

    def between(a, b, c):
        return min(a[0], b[0]) <= c[0] <= max(a[0], b[0]) and min(a[1], b[1]) <= c[1] <= max(a[1], b[1])

    (a, b), (c, d) = p, q
    turns = turn(a, b, c), turn(a, b, d), turn(c, d, a), turn(c, d, b)
    if turns[0] * turns[1] < 0 and turns[2] * turns[3] < 0:
        return True
    ends = ((a, b, c), (a, b, d), (c, d, a), (c, d, b))
    return any(side == 0 and between(*three) for side, three in zip(turns, ends, strict=True))


@settings(max_examples=25)
@given(seed=MASKS, tolerance=st.sampled_from([1.0, 3.0]))
def test_chains_neither_meet_themselves_nor_each_other(flat, seed, tolerance):
    """Without care three of these in four do, at 3 cells."""
    chains = polygons.wall_chains(polygons.simple_border(flat.blobs(seed, (24, 30))), tolerance)
    walls = []
    for i, chain in enumerate(chains):
        points = [tuple(map(int, point)) for point in chain]
        assert len(set(points)) == len(points) >= 3
        walls += [
            (i, j, len(points), pair) for j, pair in enumerate(zip(points, [*points[1:], points[0]], strict=True))
        ]
    for (i, j, size, p), (k, m, _, q) in itertools.combinations(walls, 2):
        neighbours = i == k and (m - j) % size in (1, size - 1)
        assert neighbours or not meet(p, q)


@given(seed=MASKS)
def test_a_simple_border_touches_itself_nowhere_and_takes_away_corners_only(flat, seed):
    mask = flat.blobs(seed)
    free = polygons.simple_border(mask)
    blocks = np.stack([free[:-1, :-1], free[:-1, 1:], free[1:, 1:], free[1:, :-1]])
    assert not np.any(np.all(blocks == np.array([True, False, True, False])[:, None, None], axis=0))
    assert not np.any(np.all(blocks == np.array([False, True, False, True])[:, None, None], axis=0))
    assert not np.any(free & ~mask)
    np.testing.assert_array_equal(free, polygons.simple_border(free))


def test_a_pillar_of_one_cell_stays_and_free_space_ends_with_the_image():
    free = np.ones((5, 7), bool)
    free[2, 3] = False
    outer, pillar = sorted(polygons.wall_chains(free, 1.0), key=area, reverse=True)
    assert area(outer) == 35 and len(outer) == 4
    assert area(pillar) == pytest.approx(-1.0, abs=0.5)


@pytest.mark.parametrize("slope", [0.05, 0.37, 0.5, 0.99])
def test_a_slanted_wall_is_one_wall(slope):
    """sqrt(2) cells is the tolerance that any staircase of a straight wall needs."""
    rows, columns = np.indices((60, 60))
    (chain,) = polygons.wall_chains(polygons.simple_border(columns > 0.3 + slope * rows), np.sqrt(2))
    assert len(chain) in (3, 4, 5)
