"""The types of the world: action, walls, state, snapshot, observation, outcome.

Every type here is a pytree of scalars for *one* episode; ``vmap`` adds the batch. ``P`` is the number of pedestrians
of the world, ``K = min(nearest, P)`` the number that is observed, ``B`` the number of laser beams. Lengths are metres,
times seconds, angles radians counter-clockwise; the robot frame has x forward and y left.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

# Requests of the robot to a pedestrian, and messages of a pedestrian to the robot (docs/world.md section 6).
REQUESTS = ("none", "stop", "margin-right", "margin-left")
MESSAGES = ("silence", "robot stop", "robot right", "robot left")
REPLIES = ("none", "agrees", "refuses")
NONE, STOP, RIGHT, LEFT = range(4)
AGREES, REFUSES = 1, 2


class Action(struct.PyTreeNode):
    """twist: `[2]` in [-1, 1], scaled to [0, max_v] and [-max_w, max_w]; request: int, an index into `REQUESTS`."""

    twist: jax.Array
    request: jax.Array


class WallCells(struct.PyTreeNode):
    """Walls that can be seen, or touched within a step, from each square cell of a large floor plan.

    walls:      `[rows, columns, K]` int32 indices into the solid walls of all chains, padded with -1.
    x, y:       lower left corner of cell (0, 0); a body beyond the last cell counts as in it.
    size:       side of a cell, m.
    scan_range: longest range of the laser for which the lists are complete, m.
    margin:     longest way from its cell, body included, on which a robot touches only walls that are listed, m.
    """

    walls: jax.Array
    x: float
    y: float
    size: float
    scan_range: float
    margin: float


class Walls(struct.PyTreeNode):
    """Closed polygon chains drawn with one pen: wall i joins vertex i to vertex i + 1 where ``solid[i]``.

    Padding repeats the last vertex. Free space lies to the left of every wall.

    x, y:   `[W + 1]` vertices.
    solid:  `[W]` bool, False where the pen is lifted between two chains.
    before: `[W]` index of the vertex before vertex i in its chain.
    after:  `[W]` index of the vertex after vertex i + 1 in its chain.
    cells:  lists of nearby walls for `near`, None for a floor plan of few.
    listed: `[K]` indices of the walls that count, the result of `near`; None where all count.
    """

    x: jax.Array | np.ndarray
    y: jax.Array | np.ndarray
    solid: jax.Array | np.ndarray
    before: jax.Array | np.ndarray
    after: jax.Array | np.ndarray
    cells: WallCells | None = None
    listed: jax.Array | None = None

    def near(self, x: jax.Array, y: jax.Array) -> "Walls":
        """These walls, of which only those ``listed`` `[K]` count: all that can be seen or touched from (x, y)."""
        if self.cells is None:
            return self
        cells = self.cells
        rows, columns, _ = cells.walls.shape
        column = jnp.clip(jnp.floor((x - cells.x) / cells.size), 0, columns - 1).astype(jnp.int32)
        row = jnp.clip(jnp.floor((y - cells.y) / cells.size), 0, rows - 1).astype(jnp.int32)
        return self.replace(cells=None, listed=jnp.asarray(cells.walls)[row, column])

    def segments(self) -> tuple[Any, Any, Any, Any, Any]:
        """(ax, ay, bx, by, solid), each `[W]`, or `[K]` where only some are listed: both ends of every wall."""
        if self.listed is None:
            return self.x[:-1], self.y[:-1], self.x[1:], self.y[1:], self.solid
        i = jnp.maximum(self.listed, 0)
        x, y, solid = jnp.asarray(self.x), jnp.asarray(self.y), jnp.asarray(self.solid)
        return x[i], y[i], x[i + 1], y[i + 1], solid[i] & (self.listed >= 0)


class Robot(struct.PyTreeNode):
    """The robot.

    x, y, heading:  pose.
    v, w:           twist of the last step.
    goal_x, goal_y: its goal.
    start_heading:  heading at reset.
    past:           `[2, 3]` goal in the robot frame and turned angle at t - 2 and t - 1, zeros before the start.
    """

    x: jax.Array
    y: jax.Array
    heading: jax.Array
    v: jax.Array
    w: jax.Array
    goal_x: jax.Array
    goal_y: jax.Array
    start_heading: jax.Array
    past: jax.Array


class Pedestrian(struct.PyTreeNode):
    """A pedestrian. In `State` every field is `[P]`.

    x, y:           position.
    vx, vy:         velocity.
    goal_x, goal_y: the end of its way.
    via_x, via_y:   the point by way of which it walks there.
    turned:         whether it has passed that point.
    present:        whether it is there now; an absent one counts for nobody.
    """

    x: jax.Array
    y: jax.Array
    vx: jax.Array
    vy: jax.Array
    goal_x: jax.Array
    goal_y: jax.Array
    via_x: jax.Array
    via_y: jax.Array
    turned: jax.Array
    present: jax.Array

    def target(self) -> tuple[jax.Array, jax.Array]:
        """(x, y) of where it walks to now."""
        return jnp.where(self.turned, self.goal_x, self.via_x), jnp.where(self.turned, self.goal_y, self.via_y)


class PedestrianTraits(struct.PyTreeNode):
    """Chance in a pedestrian's one encounter, drawn at reset. In `State` every field is `[P]`.

    first:        uniform in [0, 1), compared with the probability of speaking first.
    message:      likewise, with that of a message that doesn't suit the geometry.
    compliance:   likewise, with that of agreeing to a request.
    decides:      likewise, with that of picking a side late.
    side:         likewise, below a half for its right.
    reply_delay:  0-2 steps from request to reply.
    commit_delay: 2-4 steps from message to commitment.
    decide_delay: 1-4 steps from opening to a decision of its own.
    """

    first: jax.Array
    message: jax.Array
    compliance: jax.Array
    decides: jax.Array
    side: jax.Array
    reply_delay: jax.Array
    commit_delay: jax.Array
    decide_delay: jax.Array


class Encounter(struct.PyTreeNode):
    """The state of the dialogue with a pedestrian. In `State` every field is `[P]`.

    met:                bool, an encounter has opened in this episode.
    is_open:            bool, it is open: the gate.
    age:                steps since it opened.
    pedestrian_first:   bool, the pedestrian begins.
    message:            index into `MESSAGES`, said by the pedestrian.
    message_age:        steps for which the message has held.
    request:            index into `REQUESTS`, asked by the robot.
    request_age:        steps since it was asked.
    reply:              index into `REPLIES`, the answer to it.
    utterance:          uint32 that chooses the wording, 0 while nothing is said.
    distance:           distance of pedestrian and robot after the last step, m.
    grown:              steps for which it has grown.
    x, y, ux, uy:       line of the pedestrian, a point and a unit vector, frozen at opening and at its way point.
    robot_x, robot_y, robot_ux, robot_uy: line of the robot to its goal, frozen at opening.
    """

    met: jax.Array
    is_open: jax.Array
    age: jax.Array
    pedestrian_first: jax.Array
    message: jax.Array
    message_age: jax.Array
    request: jax.Array
    request_age: jax.Array
    reply: jax.Array
    utterance: jax.Array
    distance: jax.Array
    grown: jax.Array
    x: jax.Array
    y: jax.Array
    ux: jax.Array
    uy: jax.Array
    robot_x: jax.Array
    robot_y: jax.Array
    robot_ux: jax.Array
    robot_uy: jax.Array


class View(struct.PyTreeNode):
    """The moment at which a scan is taken.

    t:                  step.
    x, y, heading:      the robot's pose.
    pedestrian_present: `[P]` bool.
    pedestrian_x, pedestrian_y, pedestrian_vx, pedestrian_vy: `[P]` positions and velocities.
    """

    t: jax.Array
    x: jax.Array
    y: jax.Array
    heading: jax.Array
    pedestrian_present: jax.Array
    pedestrian_x: jax.Array
    pedestrian_y: jax.Array
    pedestrian_vx: jax.Array
    pedestrian_vy: jax.Array


class State(struct.PyTreeNode):
    """One episode.

    t:             steps taken.
    scene:         index into ``World.scenes``.
    seed:          uint32 of the sensor noise.
    robot:         `Robot`.
    pedestrians:   `Pedestrian` `[P]`.
    traits:        `PedestrianTraits` `[P]`.
    encounters:    `Encounter` `[P]`.
    min_distance:  smallest surface distance to a pedestrian so far, m.
    past_views:    `View` `[scan_delay]`, newest first; None where that is 0.
    past_twists:   `[control_delay, 2]` past actions, newest first; None where that is 0.
    people_memory: memory of the model of pedestrians; None for one without.
    """

    t: jax.Array
    scene: jax.Array
    seed: jax.Array
    robot: Robot
    pedestrians: Pedestrian
    traits: PedestrianTraits
    encounters: Encounter
    min_distance: jax.Array
    past_views: View | None = None
    past_twists: jax.Array | None = None
    people_memory: Any = None


class SeenPedestrian(struct.PyTreeNode):
    """The part of a pedestrian and its encounter that `observe` reads. In `Snapshot` every field is `[P]`.

    present:          bool, it is there now.
    x, y:             position.
    vx, vy:           velocity.
    is_open:          bool, the encounter is open.
    pedestrian_first: bool, the pedestrian begins.
    message:          index into `MESSAGES`, said by the pedestrian.
    message_age:      steps for which the message has held.
    request:          index into `REQUESTS`, asked by the robot.
    request_age:      steps since it was asked.
    reply:            index into `REPLIES`, the answer to it.
    utterance:        uint32 that chooses the wording, 0 while nothing is said.
    """

    present: jax.Array
    x: jax.Array
    y: jax.Array
    vx: jax.Array
    vy: jax.Array
    is_open: jax.Array
    pedestrian_first: jax.Array
    message: jax.Array
    message_age: jax.Array
    request: jax.Array
    request_age: jax.Array
    reply: jax.Array
    utterance: jax.Array


class Snapshot(struct.PyTreeNode):
    """All that `observe` reads, in the smallest types that hold it: what replay stores instead of observations.

    91 bytes with one pedestrian, 28 more for each further one; a step of ``scan_delay`` adds 14 and 17 a pedestrian.

    t:              steps taken.
    scene:          index into ``World.scenes``.
    seed:           uint32 of the sensor noise.
    x, y, heading:  the robot's pose.
    v, w:           its twist of the last step.
    goal_x, goal_y: its goal.
    turned:         start heading - heading.
    past:           as in `Robot`.
    pedestrians:    `SeenPedestrian` `[P]`.
    past_views:     as in `State`.
    """

    t: jax.Array
    scene: jax.Array
    seed: jax.Array
    x: jax.Array
    y: jax.Array
    heading: jax.Array
    v: jax.Array
    w: jax.Array
    goal_x: jax.Array
    goal_y: jax.Array
    turned: jax.Array
    past: jax.Array
    pedestrians: SeenPedestrian
    past_views: View | None = None


class ObservedDialogue(struct.PyTreeNode):
    """The dialogue with each observed pedestrian, `[K]` int32 each, `utterance` uint32; all zero while silent.

    is_open:          1 while the encounter is open.
    pedestrian_first: 1 where the pedestrian begins.
    message:          index into `MESSAGES`, said by the pedestrian.
    message_age:      steps for which the message has held.
    request:          index into `REQUESTS`, asked by the robot.
    request_age:      steps since it was asked.
    reply:            index into `REPLIES`, the answer to it.
    utterance:        chooses the wording, 0 while nothing is said.
    """

    is_open: jax.Array
    pedestrian_first: jax.Array
    message: jax.Array
    message_age: jax.Array
    request: jax.Array
    request_age: jax.Array
    reply: jax.Array
    utterance: jax.Array


class Observation(struct.PyTreeNode):
    """The robot's senses. Parts that ``WorldConfig.observation`` leaves out are None.

    pose:            `[3, 3]` goal x, goal y in the robot frame and turned angle at t - 2, t - 1, t.
    twist:           `[2]` own v and w of the last step.
    may_request:     bool, whether a request other than none counts now.
    scan:            `[B]` ranges, ``scan_range`` where nothing is hit.
    pedestrians:     `[K, 4]` x, y, vx, vy in the robot frame, robot velocity not subtracted; nearest first.
    seen:            `[K]` bool, whether there is such a pedestrian and the robot sees it; else its row is 0.
    dialogue:        `ObservedDialogue` in the same order.
    sensor_map:      `[48, 48]` grid around the robot: free 1, unknown 200 / 255, robot 100 / 255, hit 0.
    pedestrian_map:  `[3, 48, 48]` occupancy, vx, vy.
    """

    pose: jax.Array
    twist: jax.Array
    may_request: jax.Array
    scan: jax.Array | None = None
    pedestrians: jax.Array | None = None
    seen: jax.Array | None = None
    dialogue: ObservedDialogue | None = None
    sensor_map: jax.Array | None = None
    pedestrian_map: jax.Array | None = None


class Outcome(struct.PyTreeNode):
    """The result of a step.

    reward:              sum of ``reward_terms``.
    reward_terms:        scalars by name, of the reward function.
    terminated:          bool, arrival or collision.
    truncated:           bool, out of time and not terminated.
    arrived:             bool, at the goal.
    collided:            bool, with a wall or a pedestrian.
    hit_pedestrian:      bool, with a pedestrian; implies ``collided``.
    requested:           the request that counted in this step.
    reply:               the answer that came in this step or holds.
    pedestrian_distance: smallest surface distance to a pedestrian within the step, m.
    goal_distance:       distance to the goal at the end of the step, m.
    """

    reward: jax.Array
    reward_terms: dict[str, jax.Array]
    terminated: jax.Array
    truncated: jax.Array
    arrived: jax.Array
    collided: jax.Array
    hit_pedestrian: jax.Array
    requested: jax.Array
    reply: jax.Array
    pedestrian_distance: jax.Array
    goal_distance: jax.Array
