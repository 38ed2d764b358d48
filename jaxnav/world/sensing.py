"""Observations, pure functions of a `Snapshot`: pose history, scan, pedestrians, dialogue, grid maps."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from . import delays, dialogue, gait, lidar
from .config import WorldConfig
from .geometry import Vec2, cross2d, to_frame
from .params import Params
from .scenes import SIGHTS
from .types import NONE, Observation, ObservedDialogue, Pedestrian, Robot, SeenPedestrian, Snapshot, View, Walls

GRID = 48
CELL = 0.125  # metres; the map spans 6 x 6 m with the robot at its centre
UNKNOWN, ROBOT = 200 / 255, 100 / 255
MAP_BODY_RADIUS = 0.3


def cell_centres() -> np.ndarray:
    """Centres of the grid cells `[48]`: x by row, ahead first; y by column, left first."""
    return (((GRID - 1) / 2 - np.arange(GRID)) * CELL).astype(np.float32)


def observe_snapshot(
    snapshot: Snapshot, walls: Walls, sight: jax.Array | None, config: WorldConfig, params: Params
) -> Observation:
    """`Observation` of a snapshot; walls: those of its scene; sight: its index into `SIGHTS`, None for all."""
    cos, sin = jnp.cos(snapshot.heading), jnp.sin(snapshot.heading)
    goal = to_frame(snapshot.goal_x - snapshot.x, snapshot.goal_y - snapshot.y, cos, sin)
    seen = snapshot.pedestrians
    parts = {}
    if {"scan", "sensor_map"} & set(config.observation):
        scan = _scan(snapshot, walls, config, params)
        if "scan" in config.observation:
            parts["scan"] = scan
        if "sensor_map" in config.observation:
            parts["sensor_map"] = sensor_map(scan, params)
    if {"pedestrians", "dialogue", "pedestrian_map"} & set(config.observation):
        order = nearest_first(seen, snapshot, config)
        nearest = jax.tree.map(lambda leaf: leaf[order], seen)
        in_sight = nearest.present if sight is None else nearest.present & in_sight_of(snapshot, nearest, walls, sight)
        listed = pedestrian_list(nearest, in_sight, snapshot, cos, sin)
        if "pedestrians" in config.observation:
            parts["pedestrians"], parts["seen"] = listed, in_sight
        if "pedestrian_map" in config.observation:
            parts["pedestrian_map"] = pedestrian_map(listed, in_sight)
        if "dialogue" in config.observation:
            parts["dialogue"] = _dialogue(nearest, config)
    return Observation(
        pose=jnp.concatenate([snapshot.past, jnp.stack([*goal, snapshot.turned])[None]]),
        twist=jnp.stack([snapshot.v, snapshot.w]),
        may_request=jnp.any(dialogue.may_request(seen)),
        **parts,
    )


def view(snapshot: Snapshot) -> View:
    """`View` of the moment of a snapshot."""
    seen = snapshot.pedestrians
    return View(
        t=snapshot.t, x=snapshot.x, y=snapshot.y, heading=snapshot.heading, pedestrian_present=seen.present,
        pedestrian_x=seen.x, pedestrian_y=seen.y, pedestrian_vx=seen.vx, pedestrian_vy=seen.vy,
    )  # fmt: skip


def _scan(snapshot, walls, config, params):
    directions = lidar.beam_directions(config.beams)
    seen = delays.recall(snapshot.past_views, view(snapshot), params.scan_latency)
    origin, heading = Vec2(seen.x, seen.y), Vec2(jnp.cos(seen.heading), jnp.sin(seen.heading))
    ranges = lidar.raycast(origin, heading, walls.near(seen.x, seen.y), directions, params.scan_range)
    # Absent pedestrians stand where no beam goes.
    x = jnp.where(seen.pedestrian_present, seen.pedestrian_x, seen.x + 2.0 * params.scan_range)
    discs, radius = (x, seen.pedestrian_y), params.body_radius
    if config.body == "legs":
        velocity = seen.pedestrian_vx, seen.pedestrian_vy
        discs, radius = gait.legs(*discs, *velocity, seen.t, snapshot.seed, params), gait.leg_radius(params)
    ranges = lidar.raycast_discs(ranges, origin, heading, Vec2(*discs), radius, directions)
    if config.scan_noise:
        key = jax.random.fold_in(jax.random.key(snapshot.seed), seen.t)
        ranges = lidar.add_noise(key, ranges, params)
    return ranges


def nearest_first(seen: SeenPedestrian, snapshot: Snapshot, config: WorldConfig) -> jax.Array:
    """Indices `[K]` of the nearest pedestrians."""
    count = min(config.nearest, config.pedestrians)
    if config.pedestrians == 1:
        return jnp.zeros(1, jnp.int32)
    squared = (seen.x - snapshot.x) ** 2 + (seen.y - snapshot.y) ** 2
    return jax.lax.top_k(-jnp.where(seen.present, squared, jnp.inf), count)[1]


def in_sight_of(
    robot: Robot | Snapshot, pedestrians: Pedestrian | SeenPedestrian, walls: Walls, sight: jax.Array
) -> jax.Array:
    """Whether pedestrians `[K]` are given to the robot: all, those that no wall hides, or none, as `SIGHTS` says."""

    def hidden(blocked, wall):
        ax, ay, bx, by, solid = wall
        robot_side = cross2d(bx - ax, by - ay, robot.x - ax, robot.y - ay)
        their_side = cross2d(bx - ax, by - ay, pedestrians.x - ax, pedestrians.y - ay)
        to_x, to_y = pedestrians.x - robot.x, pedestrians.y - robot.y
        a_side, b_side = (
            cross2d(to_x, to_y, ax - robot.x, ay - robot.y),
            cross2d(to_x, to_y, bx - robot.x, by - robot.y),
        )
        return blocked | (solid & (robot_side * their_side < 0) & (a_side * b_side < 0)), None

    segments = walls.near(robot.x, robot.y).segments()
    blocked = jax.lax.scan(hidden, jnp.zeros(pedestrians.x.shape, bool), segments)[0]
    return (sight == SIGHTS.index("all")) | ((sight == SIGHTS.index("line")) & ~blocked)


def pedestrian_list(
    pedestrians: SeenPedestrian, in_sight: jax.Array, snapshot: Snapshot, cos: jax.Array, sin: jax.Array
) -> jax.Array:
    """`[K, 4]` x, y, vx, vy of pedestrians in the robot frame, 0 where they are not in sight."""
    x, y = to_frame(pedestrians.x - snapshot.x, pedestrians.y - snapshot.y, cos, sin)
    vx, vy = to_frame(pedestrians.vx, pedestrians.vy, cos, sin)
    return jnp.where(in_sight[:, None], jnp.stack([x, y, vx, vy], axis=-1), 0.0)


def _dialogue(seen, config):
    heard = seen.message if config.hearing else jnp.full_like(seen.message, NONE)
    utterance = seen.utterance if config.hearing else jnp.zeros_like(seen.utterance)
    age = seen.message_age if config.hearing else jnp.zeros_like(seen.message_age)
    fields = {
        "is_open": seen.is_open, "pedestrian_first": seen.pedestrian_first, "message": heard, "message_age": age,
        "request": seen.request, "request_age": seen.request_age, "reply": seen.reply,
    }  # fmt: skip
    return ObservedDialogue(utterance=utterance, **{name: leaf.astype(jnp.int32) for name, leaf in fields.items()})


class SensorTables(NamedTuple):
    """The geometry by which a scan becomes a `sensor_map`. Behind the robot nothing is measured.

    beam:     `[24, 48]` index of the beam nearest to the centre of each cell in front of the robot.
    nearest:  `[24, 48]` range from which that beam ends in the cell, m.
    farthest: `[24, 48]` range to which it does, m.
    distance: `[48, 48]` distance of each cell from the robot, m.
    """

    beam: np.ndarray
    nearest: np.ndarray
    farthest: np.ndarray
    distance: np.ndarray


def sensor_tables(beams: int) -> SensorTables:
    """The `SensorTables` of a scan of that many beams."""
    x, y = np.meshgrid(cell_centres(), cell_centres(), indexing="ij")
    distance, angle = np.hypot(x, y), np.arctan2(y, x)
    beam = np.rint((angle + np.pi / 2) / np.pi * (beams - 1)).astype(int)
    half = CELL / 2 / np.maximum(np.abs(np.cos(angle)), np.abs(np.sin(angle)))
    ahead = slice(GRID // 2)
    return SensorTables(beam[ahead], (distance - half)[ahead], (distance + half)[ahead], distance)


def sensor_map(scan: jax.Array, params: Params) -> jax.Array:
    """`[48, 48]` map of a scan: free 1, hit 0, unknown or behind a hit 200 / 255, the robot itself 100 / 255.

    Each cell is judged by the beam nearest to its centre: hit where the range ends within the cell.
    """
    tables = sensor_tables(scan.shape[0])
    # A product with a constant of zeros and ones picks the beams faster than a gather of 1,152 numbers.
    pick = np.zeros((scan.shape[0], tables.beam.size), np.float32)
    pick[tables.beam.ravel(), np.arange(tables.beam.size)] = 1.0
    ranges = jnp.dot(scan, pick, precision="highest").reshape(tables.beam.shape)
    front = jnp.where(ranges < tables.nearest, UNKNOWN, jnp.where(ranges > tables.farthest, 1.0, 0.0))
    whole = jnp.concatenate([front, jnp.full((GRID - GRID // 2, GRID), UNKNOWN)])
    return jnp.where(tables.distance <= params.robot_radius, ROBOT, whole)


def pedestrian_map(listed: jax.Array, in_sight: jax.Array) -> jax.Array:
    """`[3, 48, 48]` occupancy, vx, vy of those ``listed`` `[K, 4]`, in sight and within 3 m; the nearest on top."""
    cells = cell_centres()
    channels = jnp.zeros((3, GRID, GRID))
    for k in reversed(range(listed.shape[0])):
        x, y, vx, vy = listed[k]
        inside = in_sight[k] & (jnp.abs(x) <= 3.0) & (jnp.abs(y) <= 3.0)
        covered = ((cells - x) ** 2)[:, None] + ((cells - y) ** 2)[None, :] <= MAP_BODY_RADIUS**2
        disc = jnp.stack([jnp.float32(1.0), vx, vy])[:, None, None]
        channels = jnp.where(covered & inside, disc, channels)
    return channels
