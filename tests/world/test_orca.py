"""ORCA: half-planes against closed forms."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxnav.world import orca
from jaxnav.world.geometry import Vec2
from jaxnav.world.people.neighbors import near_walls
from jaxnav.world.walls import walls_from_chains


@jax.jit
def half_plane(px, py, vx, vy, other_vx, other_vy, *others):
    return orca.agent_half_plane(Vec2(px, py), Vec2(vx, vy), Vec2(other_vx, other_vy), *others)


def violation(plane, vx, vy):
    return float(plane.violation(Vec2(vx, vy)))


def permitted_border(plane):
    """(point of the border nearest to the origin, normal toward the permitted side)."""
    normal = np.array(plane.direction.left())
    return normal * (normal @ np.array(plane.point)), normal


def test_head_on_each_takes_half_of_the_avoidance():
    """Two agents heading for each other: the half-planes mirror each other, and both on the border just touch."""
    p, speed, radius, horizon = np.array([4.0, 0.1]), 0.5, 0.4, 5.0
    mine = half_plane(*p, speed, 0.0, -speed, 0.0, radius, horizon, 0.4, True)
    other = half_plane(*-p, -speed, 0.0, speed, 0.0, radius, horizon, 0.4, True)
    (_, normal), (_, normal_of_other) = permitted_border(mine), permitted_border(other)
    np.testing.assert_allclose(normal, -normal_of_other, atol=1e-6)
    v = np.array([speed, 0.0]) + normal * violation(mine, speed, 0.0)
    v_other = np.array([-speed, 0.0]) + normal_of_other * violation(other, -speed, 0.0)
    assert violation(mine, speed, 0.0) == pytest.approx(violation(other, -speed, 0.0), abs=1e-6)
    times = np.linspace(0, horizon, 20001)[:, None]
    assert np.linalg.norm(p + times * (v_other - v), axis=1).min() == pytest.approx(radius, abs=1e-4)


def test_agent_on_the_cut_off_circle_stays_on_it():
    """Relative velocity at the front of the obstacle p / tau - r / tau: no change is demanded."""
    v = (2.0 - 0.5) / 5.0
    plane = half_plane(2.0, 0.0, v, 0.0, 0.0, 0.0, 0.5, 5.0, 0.4, True)
    point, normal = permitted_border(plane)
    np.testing.assert_allclose(point, [v, 0.0], atol=1e-6)
    np.testing.assert_allclose(normal, [-1.0, 0.0], atol=1e-6)


@pytest.mark.parametrize("side", [1, -1])
def test_agent_on_a_leg_stays_on_it(side):
    """A velocity along the tangent from the origin to the disc, beyond the cut-off: the border is the leg itself."""
    angle = side * np.arcsin(0.5 / 2.0)
    v = 0.8 * np.array([np.cos(angle), np.sin(angle)])
    plane = half_plane(2.0, 0.0, *v, 0.0, 0.0, 0.5, 5.0, 0.4, True)
    point, normal = permitted_border(plane)
    np.testing.assert_allclose(point, [0, 0], atol=1e-6)
    np.testing.assert_allclose(normal, [-side * np.sin(angle), side * np.cos(angle)], atol=1e-6)
    assert violation(plane, 0.8, 0.0) == pytest.approx(0.8 * 0.25, abs=1e-6)


def test_overlapping_agents_part_within_a_step_half_each():
    """At rest, 0.3 m of overlap, dt 0.4 s: each has to leave with 0.3 / 0.4 / 2."""
    plane = half_plane(0.2, 0.0, 0.0, 0.0, 0.0, 0.0, 0.5, 5.0, 0.4, True)
    assert violation(plane, 0.0, 0.0) == pytest.approx(0.375, abs=1e-5)
    assert violation(plane, -0.375, 0.0) == pytest.approx(0.0, abs=1e-5)


def wall_planes(chain, position, velocity, radius=0.2, horizon=2.0, reach=2.0):
    """Active half-planes of an agent beside one chain, as (point of the border nearest to the origin, normal)."""
    walls = jax.tree.map(jnp.asarray, walls_from_chains([chain]))
    near = near_walls(*map(jnp.float32, position), walls, reach, 4)
    planes = orca.wall_half_planes(near, Vec2(*velocity), radius, horizon)
    return [permitted_border(plane) for plane in planes if plane.active]


ROOM = [(-5, -5), (5, -5), (5, 5), (-5, 5)]
PILLAR = [(-1, -1), (-1, 1), (1, 1), (1, -1)]  # free space outside


@pytest.mark.parametrize("gap", [0.5, 0.01])
def test_a_flat_wall_is_reached_no_sooner_than_the_horizon(gap):
    """Toward the wall at most gap / horizon, and nothing else."""
    [(point, normal)] = wall_planes(ROOM, (0.0, 5.0 - 0.2 - gap), (0.1, 0.4))
    np.testing.assert_allclose(normal, [0.0, -1.0], atol=1e-6)
    np.testing.assert_allclose(point, [0.0, gap / 2.0], atol=1e-6)


def test_in_touch_with_a_wall_no_velocity_goes_into_it():
    """An overlap isn't undone by force, as in RVO2: it only can't grow."""
    [(point, normal)] = wall_planes(ROOM, (0.0, 4.9), (0.3, 0.0))
    np.testing.assert_allclose(normal, [0.0, -1.0], atol=1e-6)
    np.testing.assert_allclose(point, [0.0, 0.0], atol=1e-6)


def test_both_walls_of_a_corner_of_the_room_count():
    planes = wall_planes(ROOM, (4.5, 4.6), (0.3, 0.3))
    normals = sorted((round(float(n[0]), 5), round(float(n[1]), 5)) for _, n in planes)
    assert normals == [(-1.0, 0.0), (0.0, -1.0)]


def test_around_the_corner_of_a_pillar_the_leg_is_the_tangent():
    """Walking past the corner of a pillar: the border is the tangent from the agent to the corner's disc."""
    corner, agent = np.array([-1.0, 1.0]), np.array([-2.0, 0.9])
    direction = corner - agent
    half_angle = np.arcsin(0.2 / np.linalg.norm(direction))
    tangent = np.arctan2(direction[1], direction[0]) + half_angle
    velocity = 0.9 * np.array([np.cos(tangent - 0.05), np.sin(tangent - 0.05)])  # just inside
    planes = wall_planes(PILLAR, agent, velocity)
    point, normal = max(planes, key=lambda plane: plane[1] @ (plane[0] - velocity))
    np.testing.assert_allclose(normal, [-np.sin(tangent), np.cos(tangent)], atol=1e-5)
    np.testing.assert_allclose(point, [0.0, 0.0], atol=1e-5)


def test_walls_are_ignored_from_behind_and_beyond_reach():
    assert wall_planes(PILLAR, (0.0, 0.9), (0.0, 0.3), reach=0.5) == []  # inside the pillar
    assert wall_planes(ROOM, (0.0, 0.0), (0.0, 0.5)) == []


def test_a_wall_behind_another_adds_nothing():
    """Two parallel pillar sides ahead: the far one's velocity obstacle lies within what the near one forbids."""
    near, far = [(-1, 1), (-1, 2), (1, 2), (1, 1)], [(-0.5, 2.2), (-0.5, 3), (0.5, 3), (0.5, 2.2)]
    walls = jax.tree.map(jnp.asarray, walls_from_chains([near, far]))
    seen = near_walls(jnp.float32(0.0), jnp.float32(0.5), walls, 5.0, 4)
    planes = orca.wall_half_planes(seen, Vec2(0.0, 0.4), 0.2, 2.0)
    assert sum(bool(wall.active) for wall in seen) == 2
    assert sum(bool(plane.active) for plane in planes) == 1
