"""The laser against MuJoCo's rangefinders: the same boxes and cylinders, seen from the same poses.

MuJoCo computes in float64, the world in float32. A beam that passes a corner or the tangent of a cylinder within
1e-6 rad may see either side of it: these are few, and counted apart.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxnav.world import lidar
from jaxnav.world.geometry import Vec2
from jaxnav.world.walls import walls_from_chains

ROOMS = 25
POSES, POSES_IN_FULL = 2, 40  # in each room
BEAMS, RANGE = 180, 12.0
ARENA = 8.0  # half the side of a room
ROBOT = 0.17  # a robot of this radius touches things at most
GRAZING = 1e-6
ANGLES = np.linspace(-np.pi / 2, np.pi / 2, BEAMS)


class Room:
    """Ten boxes, from posts to blocks and turned at random, and fifteen cylinders of one radius in a square arena."""

    def __init__(self, rng):
        size = np.exp(rng.uniform(np.log(0.05), np.log(1.5), (10, 2)))
        self.boxes = np.column_stack([rng.uniform(-6.5, 6.5, (10, 2)), size, rng.uniform(-np.pi, np.pi, 10)])
        self.cylinders = rng.uniform(-7.0, 7.0, (15, 2))
        self.radius = rng.choice([0.05, 0.1, 0.3])

    def corners(self):
        """`[10, 4, 2]`, clockwise: free space, to the left of every wall, is outside of a box."""
        signs = np.array([[-1, -1], [-1, 1], [1, 1], [1, -1]])
        cos, sin = np.cos(self.boxes[:, 4]), np.sin(self.boxes[:, 4])
        turn = np.array([[cos, sin], [-sin, cos]]).transpose(2, 0, 1)
        return (signs * self.boxes[:, None, 2:4]) @ turn + self.boxes[:, None, :2]

    def walls(self):
        arena = ARENA * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
        return walls_from_chains([arena, *self.corners()])

    def is_free(self, x, y):
        """Whether the robot's disc fits in there."""
        dx, dy = x - self.boxes[:, 0], y - self.boxes[:, 1]
        cos, sin = np.cos(self.boxes[:, 4]), np.sin(self.boxes[:, 4])
        outside = np.abs([cos * dx + sin * dy, cos * dy - sin * dx]) - self.boxes[:, 2:4].T
        to_boxes = np.hypot(*np.maximum(outside, 0.0)).min()
        to_cylinders = np.hypot(*(self.cylinders - [x, y]).T).min() - self.radius
        return min(to_boxes, to_cylinders) > ROBOT

    def poses(self, rng, count):
        """`[count, 3]` x, y, heading in float32."""
        places = rng.uniform(-ARENA + ROBOT, ARENA - ROBOT, (50 * count, 2)).astype(np.float32)
        places = np.array([place for place in places if self.is_free(*place)])[:count]
        return np.column_stack([places, rng.uniform(-np.pi, np.pi, count).astype(np.float32)])

    def grazing(self, x, y, heading):
        """Whether each beam passes a corner or a tangent within `GRAZING`."""
        corners = self.corners().reshape(-1, 2) - [x, y]
        cylinders = self.cylinders - [x, y]
        middle = np.arctan2(cylinders[:, 1], cylinders[:, 0])
        half = np.arcsin(self.radius / np.hypot(*cylinders.T))
        edges = np.concatenate([np.arctan2(corners[:, 1], corners[:, 0]), middle - half, middle + half])
        apart = (heading + ANGLES[:, None] - edges + np.pi) % (2 * np.pi) - np.pi
        return np.abs(apart).min(axis=1) <= GRAZING


class Rangefinders:
    """MuJoCo's model of a room, with ``BEAMS`` rangefinders on a body that can be put anywhere."""

    def __init__(self, mujoco, room):
        solid = [*room.boxes]  # and the arena as four boxes around it
        solid += [((ARENA + 1) * x, (ARENA + 1) * y, ARENA + 2, 1.0, 0.0) for x, y in ((0, 1), (0, -1))]
        solid += [((ARENA + 1) * x, (ARENA + 1) * y, 1.0, ARENA, 0.0) for x, y in ((1, 0), (-1, 0))]
        geoms = [
            f'<geom type="box" pos="{x} {y} 0" size="{half_x} {half_y} 1" euler="0 0 {angle}"/>'
            for x, y, half_x, half_y, angle in solid
        ]
        geoms += [f'<geom type="cylinder" pos="{x} {y} 0" size="{room.radius} 1"/>' for x, y in room.cylinders]
        sites = [f'<site name="{i}" zaxis="{np.cos(a)} {np.sin(a)} 0"/>' for i, a in enumerate(ANGLES)]
        self._mujoco = mujoco
        self._model = mujoco.MjModel.from_xml_string(
            f"""<mujoco><compiler angle="radian"/>
            <worldbody>{"".join(geoms)}<body mocap="true">{"".join(sites)}</body></worldbody>
            <sensor>{"".join(f'<rangefinder site="{i}"/>' for i in range(BEAMS))}</sensor></mujoco>"""
        )
        self._data = mujoco.MjData(self._model)

    def scan(self, x, y, heading):
        """Ranges `[B]` in float64."""
        self._data.mocap_pos[0] = x, y, 0
        self._data.mocap_quat[0] = np.cos(heading / 2), 0, 0, np.sin(heading / 2)
        self._mujoco.mj_forward(self._model, self._data)
        ranges = np.array(self._data.sensordata)
        return np.where(ranges < 0, RANGE, np.minimum(ranges, RANGE))  # -1 is a miss


@jax.jit
def scans(poses, walls, discs, radius):
    """Ranges `[poses, B]`."""

    def one(x, y, heading):
        cos, sin, directions = jnp.cos(heading), jnp.sin(heading), lidar.beam_directions(BEAMS)
        ranges = lidar.raycast(Vec2(x, y), Vec2(cos, sin), walls, directions, RANGE)
        return lidar.raycast_discs(ranges, Vec2(x, y), Vec2(cos, sin), Vec2(*discs.T), radius, directions)

    return jax.vmap(one)(*poses.T)


def test_ranges_are_those_of_mujocos_rangefinders(full):
    """In full 1,000 poses: 2 of 180,000 beams graze, and the others are 2.6e-5 m off at most (5e-5 m, other seeds)."""
    mujoco = pytest.importorskip("mujoco")
    rng = np.random.default_rng(0)
    errors, grazing, ranges = [], [], []
    for _ in range(ROOMS):
        room = Room(rng)
        poses = room.poses(rng, POSES_IN_FULL if full else POSES)
        truth = Rangefinders(mujoco, room)
        exact = np.array([truth.scan(*pose) for pose in poses.astype(float)])
        measured = scans(poses, room.walls(), room.cylinders.astype(np.float32), np.float32(room.radius))
        errors.append(np.abs(measured - exact))
        grazing.append([room.grazing(*pose) for pose in poses.astype(float)])
        ranges.append(exact)
    errors, grazing, ranges = (np.concatenate(parts) for parts in (errors, grazing, ranges))
    assert errors.shape == (ROOMS * (POSES_IN_FULL if full else POSES), BEAMS)
    assert errors[~grazing].max() <= 1e-4
    assert np.mean(errors > 2e-5) < 1e-3
    assert grazing.mean() < 1e-4
    # Misses, long and short ranges are all among them.
    assert (ranges == RANGE).any() and ranges.min() < 0.2 and np.median(ranges) > 1.0
