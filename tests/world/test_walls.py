"""Walls: chains are checked, padding adds none, and the nearest are found."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxnav.world.walls import nearest_walls, pad_walls, wall_clearance, walls_from_chains

SQUARE = [(0, 0), (4, 0), (4, 4), (0, 4)]
PILLAR = [(1, 1), (1, 2), (2, 2), (2, 1)]


def test_chains_keep_their_neighbours():
    walls = walls_from_chains([SQUARE, PILLAR])
    corners = np.stack([walls.x, walls.y], axis=1)
    for chain, first in ((SQUARE, 0), (PILLAR, 5)):
        for i in range(4):
            wall = first + i
            assert walls.solid[wall]
            np.testing.assert_array_equal(corners[wall], chain[i])
            np.testing.assert_array_equal(corners[wall + 1], chain[(i + 1) % 4])
            np.testing.assert_array_equal(corners[walls.before[wall]], chain[i - 1])
            np.testing.assert_array_equal(corners[walls.after[wall]], chain[(i + 2) % 4])
    assert walls.solid.sum() == 8 and not walls.solid[4]


@pytest.mark.parametrize(
    ("chain", "message"),
    [
        ([(0, 0)], "at least two vertices"),
        ([(0, 0), (1, np.nan), (1, 1)], r"vertex 1 at .* give finite numbers"),
        ([(0, 0), (1, 0), (0, -10_001)], r"vertex 2 at .* give metres, at most 10000"),
        ([(0, 0), (1, 0), (1, 0), (0, 1)], r"edge of 0 m after vertex 1"),
        ([(0, 0), (1, 0), (0, 0)], r"edge of 0 m after vertex 2"),
        ([(0, 0, 0), (1, 0, 0)], "shape"),
    ],
)
def test_degenerate_chains_are_refused(chain, message):
    with pytest.raises(ValueError, match=message):
        walls_from_chains([SQUARE, chain])


def test_padding_adds_no_wall():
    alone, padded = (
        walls_from_chains([SQUARE]),
        pad_walls([walls_from_chains([SQUARE]), walls_from_chains([SQUARE, PILLAR])]),
    )
    assert padded.solid.sum(axis=1).tolist() == [4, 8]
    first = jax.tree.map(lambda leaf: leaf[0], padded)
    for x, y in ((1.0, 1.5), (3.9, 0.5), (2.0, 2.0)):
        assert wall_clearance(x, y, first) == pytest.approx(float(wall_clearance(x, y, alone)))


def test_nearest_walls_are_those_of_a_sort():
    """Facing walls by distance, against numpy; inf where there are fewer."""
    walls = jax.tree.map(jnp.asarray, walls_from_chains([SQUARE, PILLAR]))
    found = jax.jit(lambda x, y: nearest_walls(x, y, walls, 6))
    rng = np.random.default_rng(0)
    ax, ay, bx, by, solid = (np.asarray(leaf) for leaf in walls.segments())
    for x, y in rng.uniform(0, 4, (50, 2)).astype(np.float32):
        if 1 <= x <= 2 and 1 <= y <= 2:
            continue
        t = np.clip(((x - ax) * (bx - ax) + (y - ay) * (by - ay)) / ((bx - ax) ** 2 + (by - ay) ** 2), 0, 1)
        squared = (ax + t * (bx - ax) - x) ** 2 + (ay + t * (by - ay) - y) ** 2
        faces = solid & ((bx - ax) * (y - ay) - (by - ay) * (x - ax) > 0)
        expected = np.sort(np.where(faces, squared, np.inf))[:6]
        held = found(x, y)
        np.testing.assert_allclose([float(s) for s, _ in held], expected, rtol=1e-5, atol=1e-7)
        for s, i in held:
            if np.isfinite(s):
                assert squared[int(i)] == pytest.approx(float(s), rel=1e-5, abs=1e-7) and faces[int(i)]
