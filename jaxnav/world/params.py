"""The floats of a world, and the check of their ranges."""

from typing import Any

import numpy as np
from flax import struct
from jax.core import Tracer

from ..fields import check, number, probability
from .config import WorldConfig

CLEARANCE = 0.3  # from starts and goals to walls, m

# Fields that a size of the world bounds.
_BOUNDED = (("scan_latency", "scan_delay"), ("control_latency", "control_delay"), ("crowd_size", "pedestrians"))


class Params(struct.PyTreeNode):
    """Every float of the world: leaves, so that ``vmap`` over them is domain randomisation.

    Sections are those of docs/world.md. `check_params` checks the ranges.
    """

    # Time, robot and episode (section 1)
    dt: float = number(0.4, above=0, unit="s", doc="control period")
    max_v: float = number(0.6, above=0, unit="m/s", doc="top speed of the robot")
    max_w: float = number(0.9, low=0, unit="rad/s", doc="top turning rate of the robot")
    robot_radius: float = number(0.17, above=0, below=CLEARANCE, unit="m", doc="radius of the robot's disc")
    goal_tolerance: float = number(0.3, low=0, unit="m", doc="distance to the goal that counts as arrival")
    max_steps: float = number(100.0, above=0, unit="steps", doc="steps after which an episode is truncated")
    control_latency: float = number(
        0.0, low=0, whole=True, unit="steps", doc="time from an action to its driving, at most world.control-delay"
    )
    # Laser (section 3)
    scan_range: float = number(12.0, above=0, unit="m", doc="longest range")
    scan_noise_std: float = number(0.01, low=0, unit="m", doc="standard deviation of a range (with world.scan-noise)")
    scan_dropout: float = probability(0.01, doc="share of beams that read scan_range (with world.scan-noise)")
    scan_latency: float = number(
        0.0, low=0, whole=True, unit="steps", doc="time from a scan to its observation, at most world.scan-delay"
    )
    # Pedestrians (section 7)
    crowd_size: float = number(
        0.0, low=0, whole=True, doc="number of pedestrians in scenes that don't say it; 0: all of world.pedestrians"
    )
    body_radius: float = number(0.1, low=0, below=CLEARANCE, unit="m", doc="radius of a pedestrian's body")
    preferred_speed: float = number(0.5, low=0, unit="m/s", doc="walking speed of a pedestrian")
    max_speed: float = number(0.5, low=0, unit="m/s", doc="top speed of a pedestrian")
    awareness: float = number(
        0.5, low=0, unit="m", doc="distance at which a pedestrian starts to avoid the robot by itself"
    )
    neighbor_distance: float = number(
        0.5, low=0, unit="m", doc="distance at which pedestrians start to avoid each other"
    )
    time_horizon: float = number(5.0, above=0, unit="s", doc="time for which a velocity is to be free of other agents")
    time_horizon_walls: float = number(1.0, above=0, unit="s", doc="time for which a velocity is to be free of walls")
    # Social force (section 7, world.people social-force)
    relaxation_time: float = number(
        0.5, above=0, unit="s", doc="time in which a social-force pedestrian takes up the velocity it wants"
    )
    pedestrian_force: float = number(
        2.1, low=0, unit="m^2/s^2", doc="potential of another pedestrian, or of the robot, at its own place"
    )
    pedestrian_force_range: float = number(0.3, above=0, unit="m", doc="distance at which that is 1 / e of it")
    stride_time: float = number(2.0, low=0, unit="s", doc="time ahead for which a walker claims the ground before it")
    wall_force: float = number(10.0, low=0, unit="m^2/s^2", doc="potential of a wall at its own place")
    wall_force_range: float = number(0.2, above=0, unit="m", doc="distance at which that is 1 / e of it")
    view_angle: float = number(3.490659, low=0, unit="rad", doc="whole angle that a pedestrian sees")
    unseen_weight: float = probability(0.5, doc="share of its force that one outside of that angle keeps")
    # Dialogue (section 6)
    encounter_distance: float = number(
        3.0, low=0, unit="m", doc="distance at which an encounter may open; grows with walking speed"
    )
    encounter_clearance: float = number(1.0, low=0, unit="m", doc="predicted closest approach below which it opens")
    encounter_horizon: float = number(5.0, low=0, unit="s", doc="time ahead for which that is predicted")
    p_pedestrian_first: float = probability(0.5, doc="probability that the pedestrian speaks first")
    compliance: float = probability(1.0, doc="probability that it agrees to a request")
    obey_steps: float = number(10.0, low=0, unit="steps", doc="steps for which it obeys")
    p_decides_late: float = probability(
        0.0, doc="probability that one with whom nothing is agreed picks a side, late and unannounced"
    )
    message_exceptions: float = probability(0.2, doc="share of messages that don't suit the geometry")
    passing_clearance: float = number(1.0, low=0, unit="m", doc="gap when both keep to the same hand")
    small_talk: float = probability(0.0, doc="probability of small talk in a step")
    # Reward (section 8)
    reward_arrival: float = number(500.0, doc="reward for reaching the goal")
    reward_collision: float = number(-500.0, doc="reward for touching a wall or a pedestrian")
    reward_progress: float = number(200.0, doc="reward for each metre nearer to the goal")
    reward_step: float = number(-5.0, doc="reward for each step")
    reward_closeness: float = number(-50.0, doc="reward for each metre below safe_distance")
    safe_distance: float = number(1.0, low=0, unit="m", doc="surface distance below which closeness costs")
    reward_request: float = number(20.0, doc="r_req, reward for a request that fits")
    reward_response: float = number(4.0, doc="r_res, reward for each step of doing what was asked")
    comfort_distance: float = number(0.5, low=0, unit="m", doc="surface distance of the comfort metric")


def check_params(params: Params, config: WorldConfig = WorldConfig()) -> None:
    """Raise ValueError naming the first field that is not finite or out of its range in a world of that config.

    Traced values pass.
    """
    for name, size in _BOUNDED:
        value, most = getattr(params, name), getattr(config, size)
        if not _traced(value) and not np.all(np.isin(value, range(most + 1))):
            raise ValueError(
                f"world.params.{name} is {value}: give a whole number from 0 to world.{size}, which is {most}"
            )
    check(params, "world.params")
    low, high = params.preferred_speed, params.max_speed
    if not (_traced(low) or _traced(high)) and np.any(np.float32(low) > np.float32(high)):
        raise ValueError(
            f"world.params.max_speed is {high}: give at least world.params.preferred_speed, which is {low}"
        )


def _traced(value: Any) -> bool:
    return isinstance(value, Tracer)
