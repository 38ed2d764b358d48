"""What the robot senses, as a pure function of a `Snapshot`: pose history, scan, pedestrians, dialogue, grid maps."""

import jax
import jax.numpy as jnp
import numpy as np

from . import dialogue, lidar
from .geometry import to_frame, unit
from .types import NONE, Observation, ObservedDialogue

GRID = 48
CELL = 0.125  # metres; the map spans 6 x 6 m with the robot at its centre
_UNKNOWN, _ROBOT = 200 / 255, 100 / 255
_MAP_BODY_RADIUS = 0.3
_LEG_OFFSET = 0.1  # from the middle of a pedestrian to each leg


def _cells():
    """Centres of the grid cells `[48]`: x by row, ahead first; y by column, left first."""
    return (((GRID - 1) / 2 - np.arange(GRID)) * CELL).astype(np.float32)


def render(snapshot, walls, config, params):
    """`Observation` of a snapshot; ``walls`` are those of its scene."""
    cos, sin = jnp.cos(snapshot.heading), jnp.sin(snapshot.heading)
    goal = to_frame(snapshot.goal_x - snapshot.x, snapshot.goal_y - snapshot.y, cos, sin)
    seen = snapshot.pedestrians
    parts = {}
    if {"scan", "sensor_map"} & set(config.observation):
        scan = _scan(snapshot, cos, sin, walls, config, params)
        if "scan" in config.observation:
            parts["scan"] = scan
        if "sensor_map" in config.observation:
            parts["sensor_map"] = sensor_map(scan, params)
    if {"pedestrians", "dialogue", "pedestrian_map"} & set(config.observation):
        order = _nearest(seen, snapshot, config)
        listed = pedestrian_list(jax.tree.map(lambda leaf: leaf[order], seen), snapshot, cos, sin)
        if "pedestrians" in config.observation:
            parts["pedestrians"] = listed
        if "pedestrian_map" in config.observation:
            parts["pedestrian_map"] = pedestrian_map(listed)
        if "dialogue" in config.observation:
            parts["dialogue"] = _dialogue(jax.tree.map(lambda leaf: leaf[order], seen), config)
    return Observation(
        pose=jnp.concatenate([snapshot.past, jnp.stack([*goal, snapshot.turned])[None]]),
        twist=jnp.stack([snapshot.v, snapshot.w]),
        may_request=jnp.any(dialogue.may_request(seen)),
        **parts,
    )


def _scan(snapshot, cos, sin, walls, config, params):
    directions = lidar.beam_directions(config.beams)
    x, y, seen = snapshot.x, snapshot.y, snapshot.pedestrians
    ranges = lidar.raycast(x, y, cos, sin, walls, directions, params.scan_range)
    for side in (-_LEG_OFFSET, _LEG_OFFSET) if config.body == "legs" else (0.0,):
        # Across the way it walks; the legs of one who stands are together.
        ux, uy = unit(seen.vx, seen.vy)
        disc_x, disc_y = seen.x - side * uy, seen.y + side * ux
        ranges = lidar.raycast_discs(ranges, x, y, cos, sin, disc_x, disc_y, params.body_radius, directions)
    if config.scan_noise:
        key = jax.random.fold_in(jax.random.key(snapshot.seed), snapshot.t)
        ranges = lidar.add_noise(key, ranges, params)
    return ranges


def _nearest(seen, snapshot, config):
    """Indices `[K]` of the nearest pedestrians."""
    count = min(config.nearest, config.pedestrians)
    if config.pedestrians == 1:
        return jnp.zeros(1, jnp.int32)
    return jax.lax.top_k(-((seen.x - snapshot.x) ** 2 + (seen.y - snapshot.y) ** 2), count)[1]


def pedestrian_list(seen, snapshot, cos, sin):
    """`[K, 4]` x, y, vx, vy of pedestrians in the robot frame."""
    x, y = to_frame(seen.x - snapshot.x, seen.y - snapshot.y, cos, sin)
    vx, vy = to_frame(seen.vx, seen.vy, cos, sin)
    return jnp.stack([x, y, vx, vy], axis=-1)


def _dialogue(seen, config):
    heard = seen.message if config.hearing else jnp.full_like(seen.message, NONE)
    utterance = seen.utterance if config.hearing else jnp.zeros_like(seen.utterance)
    age = seen.message_age if config.hearing else jnp.zeros_like(seen.message_age)
    fields = {
        "is_open": seen.is_open, "pedestrian_first": seen.pedestrian_first, "message": heard, "message_age": age,
        "request": seen.request, "request_age": seen.request_age, "reply": seen.reply,
    }  # fmt: skip
    return ObservedDialogue(utterance=utterance, **{name: leaf.astype(jnp.int32) for name, leaf in fields.items()})


def sensor_map(scan, params):
    """`[48, 48]` map of a scan: free 1, hit 0, unknown or behind a hit 200 / 255, the robot itself 100 / 255.

    Each cell is judged by the beam nearest to its centre: hit where the range ends within the cell.
    """
    x, y = np.meshgrid(_cells(), _cells(), indexing="ij")
    distance, angle = np.hypot(x, y), np.arctan2(y, x)
    beam = np.rint((angle + np.pi / 2) / np.pi * (scan.shape[0] - 1)).astype(int)
    ahead = GRID // 2  # rows in front of the robot: behind it nothing is measured
    half = CELL / 2 / np.maximum(np.abs(np.cos(angle)), np.abs(np.sin(angle)))
    # A product with a constant of zeros and ones picks the beams faster than a gather of 1,152 numbers.
    pick = np.zeros((scan.shape[0], ahead * GRID), np.float32)
    pick[beam[:ahead].ravel(), np.arange(ahead * GRID)] = 1.0
    ranges = jnp.dot(scan, pick, precision="highest").reshape(ahead, GRID)
    nearer, farther = ranges < (distance - half)[:ahead], ranges > (distance + half)[:ahead]
    front = jnp.where(nearer, _UNKNOWN, jnp.where(farther, 1.0, 0.0))
    whole = jnp.concatenate([front, jnp.full((GRID - ahead, GRID), _UNKNOWN)])
    return jnp.where(distance <= params.robot_radius, _ROBOT, whole)


def pedestrian_map(listed):
    """`[3, 48, 48]` occupancy, vx, vy of the pedestrians ``listed`` `[K, 4]` within 3 m; the nearest on top."""
    cells = _cells()
    channels = jnp.zeros((3, GRID, GRID))
    for k in reversed(range(listed.shape[0])):
        x, y, vx, vy = listed[k]
        inside = (jnp.abs(x) <= 3.0) & (jnp.abs(y) <= 3.0)
        covered = ((cells - x) ** 2)[:, None] + ((cells - y) ** 2)[None, :] <= _MAP_BODY_RADIUS**2
        disc = jnp.stack([jnp.float32(1.0), vx, vy])[:, None, None]
        channels = jnp.where(covered & inside, disc, channels)
    return channels
