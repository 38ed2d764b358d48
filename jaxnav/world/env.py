"""The world: reset, step and observe one episode. The only file that knows all the others."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np

from . import dialogue, pedestrian, reward, scenes, sensing
from .geometry import closest_approach, norm, time_to_disc, to_frame, unit
from .robot import arc, twist_from_action
from .types import NONE, Fate, Outcome, Params, Pedestrian, Robot, SeenPedestrian, Snapshot, State, WorldConfig
from .walls import pad_walls, time_to_walls, walls_from_chains

# The arc of a step is swept as two chords: at most 3 mm off at full speed and turn.
_CHORDS = 2

_AT_LEAST_ZERO = (
    "max_w", "goal_tolerance", "scan_noise_std", "body_radius", "preferred_speed", "max_speed", "awareness",
    "neighbor_distance", "encounter_distance", "encounter_clearance", "encounter_horizon", "obey_steps",
    "passing_clearance", "safe_distance", "comfort_distance",
)  # fmt: skip
_POSITIVE = ("dt", "max_v", "robot_radius", "max_steps", "scan_range", "time_horizon", "time_horizon_walls")
_PROBABILITIES = ("scan_dropout", "p_pedestrian_first", "compliance", "message_exceptions", "small_talk")


def check_params(params):
    """Raise ValueError naming the first field that is not finite or out of its range; traced values pass."""
    for name, value in params.items():
        if isinstance(value, jax.core.Tracer):
            continue
        value = np.asarray(value)
        if not np.all(np.isfinite(value)):
            raise ValueError(f"world.params.{name} is {value}: give a finite number")
        if name in _POSITIVE and np.any(value <= 0):
            raise ValueError(f"world.params.{name} is {value}: give a number above 0")
        if name in _AT_LEAST_ZERO and np.any(value < 0):
            raise ValueError(f"world.params.{name} is {value}: give a number of at least 0")
        if name in _PROBABILITIES and np.any((value < 0) | (value > 1)):
            raise ValueError(f"world.params.{name} is {value}: give a probability, 0 to 1")
    _check_order(params, "preferred_speed", "max_speed")
    for name in ("robot_radius", "body_radius"):
        value = params[name]
        if not isinstance(value, jax.core.Tracer) and np.any(np.asarray(value) >= scenes.CLEARANCE):
            raise ValueError(
                f"world.params.{name} is {value}: give less than {scenes.CLEARANCE}, the gap from starts to walls"
            )


def _check_order(params, low, high):
    pair = params[low], params[high]
    if not any(isinstance(value, jax.core.Tracer) for value in pair) and np.any(np.asarray(pair[0]) > pair[1]):
        raise ValueError(f"world.params.{high} is {pair[1]}: give at least world.params.{low}, which is {pair[0]}")


class World:
    """A differentiable 2D world with one robot and P pedestrians who talk with it.

    Every method is a pure function of one episode: ``jit`` and ``vmap`` as you like. ``step`` does not reset.
    ValueError: an unknown scene, or more pedestrians than one of the scenes holds.
    """

    def __init__(self, config: WorldConfig = WorldConfig()):
        self.config = config
        self.scenes = tuple(scenes.get(name) for name in config.scenes)
        for scene in self.scenes:
            if config.pedestrians > scene.capacity:
                raise ValueError(
                    f"world.pedestrians is {config.pedestrians}: scene {scene.name} holds at most {scene.capacity}"
                )
        self._wall_table = pad_walls([walls_from_chains(scene.chains) for scene in self.scenes])
        self._floor_table = scenes.floor_table(self.scenes)

    def walls(self, scene):
        """`Walls` of the scene with that index."""
        return _row(self._wall_table, scene)

    def reset(self, key, params: Params, scene=None) -> State:
        """A new episode in a random scene, or in the one with index ``scene``. ValueError: params out of range."""
        check_params(params)
        key_place, key_fate, key_words = jax.random.split(key, 3)
        bits = jax.random.bits(key_words, (self.config.pedestrians + 2,), jnp.uint32)
        choice, seed, words = bits[0], bits[1], bits[2:]
        if scene is None:
            scene = (choice % len(self.scenes)).astype(jnp.int32)
        walls, floors = self.walls(scene), _row(self._floor_table, scene)
        (x, y, heading, goal_x, goal_y), (px, py, pedestrian_goal_x, pedestrian_goal_y) = scenes.place(
            key_place, self.scenes, scene, walls, floors, self.config.pedestrians, params
        )
        zero = jnp.float32(0.0)
        robot = Robot(
            x=x, y=y, heading=heading, v=zero, w=zero, goal_x=goal_x, goal_y=goal_y, start_heading=heading,
            past=jnp.zeros((2, 3)),
        )  # fmt: skip
        ux, uy = unit(pedestrian_goal_x - px, pedestrian_goal_y - py)
        pedestrians = Pedestrian(
            x=px, y=py, vx=params.preferred_speed * ux, vy=params.preferred_speed * uy,
            goal_x=pedestrian_goal_x, goal_y=pedestrian_goal_y,
        )  # fmt: skip
        fates = _draw_fates(key_fate, self.config.pedestrians)
        encounters = jax.vmap(dialogue.start, in_axes=(0, None))(pedestrians, robot)
        encounters = self._advance_encounters(encounters, fates, robot, pedestrians, walls, words, params)
        distance = norm(px - x, py - y) - params.robot_radius - params.body_radius
        return State(
            t=jnp.int32(0), scene=jnp.int32(scene), seed=seed, robot=robot, pedestrians=pedestrians, fates=fates,
            encounters=encounters, min_distance=jnp.min(distance),
        )  # fmt: skip

    def step(self, key, state: State, action, params: Params) -> tuple[State, Outcome]:
        """One control period of ``dt``: talk, walk, drive, touch, and see who speaks next. ``key`` draws the words."""
        walls = self.walls(state.scene)
        before, fates = state.robot, state.fates

        asked = dialogue.address(state.encounters, action.code)
        encounters = jax.vmap(dialogue.receive, in_axes=(0, 0, 0, None))(state.encounters, asked, fates, params)
        fits = jax.vmap(dialogue.fitting_request, in_axes=(None, 0))(before, state.pedestrians)
        fits = jnp.any((asked != NONE) & (asked == fits))

        pedestrians = pedestrian.walk(state.pedestrians, encounters, fates, before, walls, self.config, params)
        robot, path = self._drive(before, action, params)
        arrived, collided, hit_pedestrian, distance = self._contacts(
            path, robot, state.pedestrians, pedestrians, walls, params
        )
        min_distance = jnp.minimum(state.min_distance, distance)

        follows = jnp.any(jax.vmap(dialogue.follows_message, in_axes=(0, None))(encounters, robot))
        goal_before = norm(before.goal_x - before.x, before.goal_y - before.y)
        goal_distance = norm(robot.goal_x - robot.x, robot.goal_y - robot.y)
        terms = reward.reward_terms(
            arrived, collided, goal_before - goal_distance, distance, min_distance, fits, follows, params,
            self.config.reward,
        )  # fmt: skip

        words = jax.random.bits(key, (self.config.pedestrians,), jnp.uint32)
        replies = encounters.reply
        encounters = self._advance_encounters(encounters, fates, robot, pedestrians, walls, words, params)
        t = state.t + 1
        terminated = arrived | collided
        outcome = Outcome(
            reward=sum(terms.values()), reward_terms=terms, terminated=terminated,
            truncated=(t >= params.max_steps) & ~terminated, arrived=arrived, collided=collided,
            hit_pedestrian=hit_pedestrian, requested=jnp.max(asked), reply=jnp.max(replies),
            pedestrian_distance=distance, goal_distance=goal_distance,
        )  # fmt: skip
        new = state.replace(t=t, robot=robot, pedestrians=pedestrians, encounters=encounters, min_distance=min_distance)
        return new, outcome

    def observe(self, state: State, params: Params):
        """`Observation` of a state: a pure function, sensor noise included."""
        return self.render(self.snapshot(state), params)

    def snapshot(self, state: State) -> Snapshot:
        """All that `observe` reads of a state, small: what replay stores."""
        robot, encounters = state.robot, state.encounters
        small = ("message", "message_age", "request", "request_age", "reply")
        return Snapshot(
            t=state.t.astype(jnp.uint16), scene=state.scene.astype(jnp.uint8), seed=state.seed,
            x=robot.x, y=robot.y, heading=robot.heading, v=robot.v, w=robot.w, goal_x=robot.goal_x,
            goal_y=robot.goal_y, turned=robot.start_heading - robot.heading, past=robot.past,
            pedestrians=SeenPedestrian(
                **{name: getattr(state.pedestrians, name) for name in ("x", "y", "vx", "vy")},
                **{name: jnp.minimum(encounters[name], 255).astype(jnp.uint8) for name in small},
                **{name: encounters[name] for name in ("is_open", "pedestrian_first", "utterance")},
            ),
        )  # fmt: skip

    def render(self, snapshot: Snapshot, params: Params):
        """`Observation` of a snapshot: the same, bit for bit, as at the time of acting."""
        return sensing.render(snapshot, self.walls(snapshot.scene), self.config, params)

    def _advance_encounters(self, encounters, fates, robot, pedestrians, walls, words, params):
        return jax.vmap(dialogue.advance, in_axes=(0, 0, None, 0, None, 0, None))(
            encounters, fates, robot, pedestrians, walls, words, params
        )

    def _drive(self, robot, action, params):
        """The robot after the step, and the points of its path, start included."""
        v, w = twist_from_action(action.twist, params)
        poses = [arc(robot.x, robot.y, robot.heading, v, w, params.dt * (i + 1) / _CHORDS) for i in range(_CHORDS)]
        goal = to_frame(robot.goal_x - robot.x, robot.goal_y - robot.y, jnp.cos(robot.heading), jnp.sin(robot.heading))
        now = jnp.stack([*goal, robot.start_heading - robot.heading])
        x, y, heading = poses[-1]
        moved = robot.replace(x=x, y=y, heading=heading, v=v, w=w, past=jnp.stack([robot.past[1], now]))
        return moved, [(robot.x, robot.y), *((x, y) for x, y, _ in poses)]

    def _contacts(self, path, robot, walked_from, walked_to, walls, params):
        """(arrived, collided, hit_pedestrian, surface distance to the nearest pedestrian); the earliest event wins."""
        radius = params.robot_radius + params.body_radius
        arrival = wall_hit = pedestrian_hit = distance = jnp.float32(jnp.inf)
        for i, ((x0, y0), (x1, y1)) in enumerate(itertools.pairwise(path)):
            to_goal = time_to_disc(x0 - robot.goal_x, y0 - robot.goal_y, x1 - x0, y1 - y0, params.goal_tolerance)
            arrival = jnp.minimum(arrival, i + to_goal)
        begin = 0
        if not self.config.swept_collisions:
            begin, path, walked_from = len(path) - 1, [path[-1], path[-1]], walked_to
        chords = len(path) - 1
        for i, ((x0, y0), (x1, y1)) in enumerate(itertools.pairwise(path)):
            ex, ey = x1 - x0, y1 - y0
            wall_time = time_to_walls(x0, y0, ex, ey, walls, params.robot_radius)
            wall_hit = jnp.minimum(wall_hit, begin + i + wall_time)
            walk_x, walk_y = (walked_to.x - walked_from.x) / chords, (walked_to.y - walked_from.y) / chords
            rx, ry = x0 - walked_from.x - i * walk_x, y0 - walked_from.y - i * walk_y
            rex, rey = ex - walk_x, ey - walk_y
            pedestrian_time = jnp.min(time_to_disc(rx, ry, rex, rey, radius))
            pedestrian_hit = jnp.minimum(pedestrian_hit, begin + i + pedestrian_time)
            t = closest_approach(rx, ry, rex, rey)
            distance = jnp.minimum(distance, jnp.min(norm(rx + t * rex, ry + t * rey)) - radius)
        collision = jnp.minimum(wall_hit, pedestrian_hit)
        collided = (collision < jnp.inf) & (collision <= arrival)
        hit_pedestrian = collided & (pedestrian_hit <= wall_hit)
        return (arrival < jnp.inf) & ~collided, collided, hit_pedestrian, distance


def _row(table, scene):
    """What a table of all scenes says of one."""
    return jax.tree.map(lambda leaf: jnp.asarray(leaf)[scene], table)


def _draw_fates(key, pedestrians):
    uniform = jax.random.uniform(key, (5, pedestrians))
    return Fate(
        first=uniform[0], message=uniform[1], compliance=uniform[2],
        reply_delay=(3 * uniform[3]).astype(jnp.int32), commit_delay=2 + (3 * uniform[4]).astype(jnp.int32),
    )  # fmt: skip
