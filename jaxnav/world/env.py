"""The world: reset, step and observe one episode. The only file that knows all the others."""

import functools
import itertools
import operator
from collections.abc import Iterable

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

from . import delays, dialogue, placement, scenes, sensing
from .config import WorldConfig
from .geometry import Vec2, closest_approach, norm, time_to_disc, to_frame
from .params import Params, check_params
from .people import (
    BUILT_IN_PEOPLE,
    RECORDING,
    PedestrianModel,
    Surroundings,
    advance,
    check_model,
    check_step,
    choose_people,
    read_recording,
    recording_scene,
)
from .reward import RewardFunction, StepEvents, check_reward, find_reward
from .robot import arc, twist_from_action
from .types import (
    NONE,
    Action,
    Observation,
    Outcome,
    PedestrianTraits,
    Robot,
    SeenPedestrian,
    Snapshot,
    State,
    Walls,
)
from .walls import pad_walls, time_to_walls, walls_from_chains

# The arc of a step is swept as two chords: at most 3 mm off at full speed and turn.
_CHORDS = 2


def body_reach(params: Params) -> np.ndarray:
    """Reach of the robot's body on a chord of its path, from where it starts, itself included, m (numpy)."""
    max_v, dt, radius = (np.asarray(getattr(params, name)) for name in ("max_v", "dt", "robot_radius"))
    return max_v * dt / _CHORDS + radius


class World:
    """A differentiable 2D world with one robot and P pedestrians who talk with it.

    Every method is a pure function of one episode: ``jit`` and ``vmap`` as you like. ``step`` does not reset.
    own_scenes: scenes that ``config.scenes`` may name beside those of `SCENES`; people: how pedestrians move, instead
    of the model that ``config.people`` names; reward: instead of the one that ``config.reward`` names. ValueError: an
    unknown scene, model or reward, two scenes of one name, one of your own that starts somebody in a wall or in
    somebody else, more pedestrians than a scene holds, a model or a reward of another signature.
    """

    def __init__(
        self,
        config: WorldConfig = WorldConfig(),
        own_scenes: Iterable[scenes.Scene] = (),
        people: PedestrianModel | None = None,
        reward: RewardFunction | None = None,
    ) -> None:
        self.config = config
        self._reward = find_reward(config.reward) if reward is None else reward
        check_reward(self._reward, config.reward if reward is None else getattr(reward, "__name__", repr(reward)))
        own_scenes = list(own_scenes)
        if RECORDING in config.scenes and RECORDING not in [scene.name for scene in own_scenes]:
            own_scenes.append(recording_scene(read_recording(config.recording)))
        self.scenes = scenes.choose(config.scenes, own_scenes)
        for scene in self.scenes:
            least, most = scene.crowd or (1, config.pedestrians)
            if most > scene.capacity:
                raise ValueError(f"world.pedestrians is {most}: scene {scene.name} holds at most {scene.capacity}")
            if config.pedestrians < least:
                raise ValueError(
                    f"world.pedestrians is {config.pedestrians}: scene {scene.name} needs at least {least}"
                )
        own = [scene for scene in self.scenes if scene.name not in scenes.BUILT_IN]  # the others are tested
        if own:
            placement.check_starts(own, config.pedestrians)
        model = choose_people(config) if people is None else people
        check_model(model)
        self._model = model
        self.people = model.prepare(config, self.scenes)
        self._wall_table = pad_walls([walls_from_chains(scene.chains) for scene in self.scenes])
        # Only a floor plan of its own looks walls up by cell; beside other scenes it tests all of them.
        self._cells = self.scenes[0].cells if len(self.scenes) == 1 else None
        if self._cells is not None:
            # Counted with those that aren't solid, as `Walls` counts.
            number = np.append(np.flatnonzero(self._wall_table.solid[0]), -1).astype(np.int32)
            self._cells = self._cells.replace(walls=number[self._cells.walls])
        self._floor_table = placement.floor_table(self.scenes)
        # None where every scene gives all pedestrians: then nothing is asked about sight.
        sight = np.array([scenes.SIGHTS.index(scene.sight) for scene in self.scenes])
        self._sight = sight if sight.any() else None
        if people is not None or config.people not in BUILT_IN_PEOPLE:
            check_step(self.people, self.reset, self.walls, config, Params(**self.scenes[0].params))

    def with_config(self, config: WorldConfig) -> "World":
        """A world of the same scenes, people and reward, of another size or with other observations."""
        own = [scene for scene in self.scenes if scenes.SCENES.get(scene.name) is not scene]
        return World(config, own, self._model, self._reward)

    def walls(self, scene: jax.Array | int) -> Walls:
        """`Walls` of the scene with that index."""
        if len(self.scenes) > 1:
            return _row(self._wall_table, scene)
        # One scene is a constant: nothing is looked up.
        return jax.tree.map(lambda leaf: jnp.asarray(leaf[0]), self._wall_table).replace(cells=self._cells)

    def _key(self):
        # Whatever two worlds have to share to be the same: then what was compiled for one serves the other.
        return self.config, tuple(id(scene) for scene in self.scenes), id(self._model), id(self._reward)

    def __eq__(self, other):
        return isinstance(other, World) and self._key() == other._key()

    def __hash__(self):
        return hash(self._key())

    @property
    def default_params(self) -> Params:
        """`Params` of the people in its scenes; ValueError where they are not the same people."""
        return scenes.params_of(self.scenes)

    def reset(
        self, key: jax.Array, params: Params, scene: jax.Array | int | None = None, seed: jax.Array | int | None = None
    ) -> State:
        """A new episode in a random scene, or in the one with index ``scene``. ValueError: either is out of range.

        seed: uint32, of its sensor noise; drawn if not given.
        """
        check_params(params, self.config)
        if isinstance(scene, int | np.integer) and not 0 <= scene < len(self.scenes):
            raise ValueError(f"scene is {scene}: give an index into world.scenes, 0 to {len(self.scenes) - 1}")
        self._check_cells(params)
        key_place, key_traits, key_words = jax.random.split(key, 3)
        bits = jax.random.bits(key_words, (self.config.pedestrians + 2,), jnp.uint32)
        choice, words = bits[0], bits[2:]
        seed = bits[1] if seed is None else jnp.asarray(seed, jnp.uint32)
        if scene is None:
            scene = (choice % len(self.scenes)).astype(jnp.int32)
        walls, floors = self.walls(scene), _row(self._floor_table, scene)
        (x, y, heading, goal_x, goal_y), pedestrians = placement.place(
            key_place, self.scenes, scene, walls, floors, self.config.pedestrians, params
        )
        zero = jnp.zeros(())
        robot = Robot(
            x=x, y=y, heading=heading, v=zero, w=zero, goal_x=goal_x, goal_y=goal_y, start_heading=heading,
            past=jnp.zeros((2, 3)),
        )  # fmt: skip
        surroundings = Surroundings(robot=robot, walls=walls, t=jnp.int32(0), seed=seed)
        pedestrians, memory = self.people.start(pedestrians, surroundings, self.config, params)
        traits = _draw_traits(key_traits, self.config.pedestrians)
        if not self.people.talks:
            traits = dialogue.mute(traits)
        encounters = jax.vmap(dialogue.start, in_axes=(0, None))(pedestrians, robot)
        turns = jnp.zeros(self.config.pedestrians, bool)
        encounters = self._advance_encounters(encounters, traits, robot, pedestrians, turns, walls, words, params)
        distance = norm(pedestrians.x - x, pedestrians.y - y) - params.robot_radius - params.body_radius
        distance = jnp.where(pedestrians.present, distance, jnp.inf)
        state = State(
            t=jnp.int32(0), scene=jnp.int32(scene), seed=seed, robot=robot, pedestrians=pedestrians, traits=traits,
            encounters=encounters, min_distance=jnp.min(distance), people_memory=memory,
        )  # fmt: skip
        return state.replace(
            past_views=delays.start(sensing.view(self.snapshot(state)), self.config.scan_delay),
            past_twists=delays.start(jnp.array([-1.0, 0.0]), self.config.control_delay),  # the robot stands
        )

    def _check_cells(self, params):
        """ValueError where the cells leave out walls that the laser may hit, or the robot touch. Traced values pass."""
        if self._cells is None:
            return
        scan_range = params.scan_range
        moves = {name: getattr(params, name) for name in ("dt", "max_v", "robot_radius")}
        loaded = f"scene {self.scenes[0].name} was loaded for up to"
        if not isinstance(scan_range, Tracer) and np.any(np.asarray(scan_range) > self._cells.scan_range):
            raise ValueError(
                f"world.params.scan_range is {scan_range}: {loaded} {self._cells.scan_range} m; "
                "load it for a longer one"
            )
        if any(isinstance(value, Tracer) for value in moves.values()):
            return
        reach = np.max(body_reach(params))
        if reach > self._cells.margin + 1e-6:  # a micrometre for rounding: params may be of single precision
            values = ", ".join(f"world.params.{name} is {value}" for name, value in moves.items())
            raise ValueError(
                f"{values}: in half a step the robot's body gets {reach:.4g} m far, but {loaded} "
                f"{self._cells.margin:.4g} m; give smaller ones, or load it with such a margin"
            )

    def step(self, key: jax.Array, state: State, action: Action, params: Params) -> tuple[State, Outcome]:
        """One control period of ``dt``: talk, walk, drive, touch, and see who speaks next. ``key`` draws the words."""
        walls = self.walls(state.scene)
        before, traits = state.robot, state.traits

        asked = dialogue.address(state.encounters, action.request)
        encounters = jax.vmap(dialogue.receive, in_axes=(0, 0, 0, None))(state.encounters, asked, traits, params)
        fits = jax.vmap(dialogue.fitting_request, in_axes=(None, 0))(before, state.pedestrians)
        fits = jnp.any((asked != NONE) & (asked == fits))

        surroundings = Surroundings(robot=before, walls=walls, t=state.t, seed=state.seed)
        pedestrians, memory = advance(
            self.people, state.pedestrians, state.people_memory, encounters, traits, surroundings, self.config, params
        )
        twist = delays.recall(state.past_twists, action.twist, params.control_latency)
        robot, path = self._drive(before, twist, params)
        arrived, collided, hit_pedestrian, distance = self._contacts(
            path, robot, state.pedestrians, pedestrians, walls, params
        )
        min_distance = jnp.minimum(state.min_distance, distance)

        follows = jnp.any(jax.vmap(dialogue.follows_message, in_axes=(0, None))(encounters, robot))
        goal_before = norm(before.goal_x - before.x, before.goal_y - before.y)
        goal_distance = norm(robot.goal_x - robot.x, robot.goal_y - robot.y)
        events = StepEvents(
            arrived=arrived, collided=collided, hit_pedestrian=hit_pedestrian,
            progress=goal_before - goal_distance, goal_distance=goal_distance, distance=distance,
            min_distance=min_distance, requested=jnp.max(asked), fits=fits, follows=follows, v=robot.v, w=robot.w,
        )  # fmt: skip
        kind = events.progress.dtype  # of the world's floats: x64 keeps its digits
        terms = {name: jnp.asarray(term, kind) for name, term in self._reward(events, params).items()}

        words = jax.random.bits(key, (self.config.pedestrians,), jnp.uint32)
        replies = encounters.reply
        turns = pedestrians.turned & ~state.pedestrians.turned
        encounters = self._advance_encounters(encounters, traits, robot, pedestrians, turns, walls, words, params)
        t = state.t + 1
        terminated = arrived | collided
        outcome = Outcome(
            reward=functools.reduce(operator.add, terms.values()), reward_terms=terms, terminated=terminated,
            truncated=(t >= params.max_steps) & ~terminated, arrived=arrived, collided=collided,
            hit_pedestrian=hit_pedestrian, requested=jnp.max(asked), reply=jnp.max(replies),
            pedestrian_distance=distance, goal_distance=goal_distance,
        )  # fmt: skip
        new = state.replace(
            t=t, robot=robot, pedestrians=pedestrians, encounters=encounters, min_distance=min_distance,
            people_memory=memory,
            past_views=delays.push(state.past_views, sensing.view(self.snapshot(state))),
            past_twists=delays.push(state.past_twists, action.twist),
        )  # fmt: skip
        return new, outcome

    def observe(self, state: State, params: Params) -> Observation:
        """`Observation` of a state: a pure function, sensor noise included."""
        return self.observe_snapshot(self.snapshot(state), params)

    def snapshot(self, state: State) -> Snapshot:
        """All that `observe` reads of a state, in small types: replay stores it."""
        robot, encounters = state.robot, state.encounters
        small = ("message", "message_age", "request", "request_age", "reply")
        return Snapshot(
            t=state.t.astype(jnp.uint16), scene=state.scene.astype(jnp.uint8), seed=state.seed,
            x=robot.x, y=robot.y, heading=robot.heading, v=robot.v, w=robot.w, goal_x=robot.goal_x,
            goal_y=robot.goal_y, turned=robot.start_heading - robot.heading, past=robot.past,
            pedestrians=SeenPedestrian(
                **{name: getattr(state.pedestrians, name) for name in ("present", "x", "y", "vx", "vy")},
                **{name: jnp.minimum(getattr(encounters, name), 255).astype(jnp.uint8) for name in small},
                **{name: getattr(encounters, name) for name in ("is_open", "pedestrian_first", "utterance")},
            ),
            past_views=state.past_views,
        )  # fmt: skip

    def observe_snapshot(self, snapshot: Snapshot, params: Params) -> Observation:
        """`Observation` of a snapshot: the same, bit for bit, as at the time of acting."""
        sight = None if self._sight is None else jnp.asarray(self._sight)[snapshot.scene]
        return sensing.observe_snapshot(snapshot, self.walls(snapshot.scene), sight, self.config, params)

    def _advance_encounters(self, encounters, traits, robot, pedestrians, turns, walls, words, params):
        if not self.people.talks:
            params = params.replace(small_talk=0.0)
        return jax.vmap(dialogue.advance, in_axes=(0, 0, None, 0, 0, None, 0, None))(
            encounters, traits, robot, pedestrians, turns, walls, words, params
        )

    def _drive(self, robot, twist, params):
        """The robot after the step, and the points of its path, start included."""
        v, w = twist_from_action(twist, params)
        poses = [arc(robot.x, robot.y, robot.heading, v, w, params.dt * (i + 1) / _CHORDS) for i in range(_CHORDS)]
        goal = to_frame(robot.goal_x - robot.x, robot.goal_y - robot.y, jnp.cos(robot.heading), jnp.sin(robot.heading))
        now = jnp.stack([*goal, robot.start_heading - robot.heading])
        x, y, heading = poses[-1]
        moved = robot.replace(x=x, y=y, heading=heading, v=v, w=w, past=jnp.stack([robot.past[1], now]))
        return moved, [(robot.x, robot.y), *((x, y) for x, y, _ in poses)]

    def _contacts(self, path, robot, walked_from, walked_to, walls, params):
        """(arrived, collided, hit_pedestrian, surface distance to the nearest pedestrian); the earliest event wins."""
        radius = params.robot_radius + params.body_radius
        # A pedestrian that has just come hasn't walked there: it stands where it appears.
        walked_from = walked_from.replace(
            x=jnp.where(walked_from.present, walked_from.x, walked_to.x),
            y=jnp.where(walked_from.present, walked_from.y, walked_to.y),
        )
        arrival = wall_hit = pedestrian_hit = distance = jnp.asarray(jnp.inf)
        for i, ((x0, y0), (x1, y1)) in enumerate(itertools.pairwise(path)):
            from_goal = Vec2(x0 - robot.goal_x, y0 - robot.goal_y)
            to_goal = time_to_disc(from_goal, Vec2(x1 - x0, y1 - y0), params.goal_tolerance)
            arrival = jnp.minimum(arrival, i + to_goal)
        begin = 0
        if not self.config.swept_collisions:
            begin, path, walked_from = len(path) - 1, [path[-1], path[-1]], walked_to
        chords = len(path) - 1
        for i, ((x0, y0), (x1, y1)) in enumerate(itertools.pairwise(path)):
            ex, ey = x1 - x0, y1 - y0
            wall_time = time_to_walls(Vec2(x0, y0), Vec2(ex, ey), walls.near(x0, y0), params.robot_radius)
            wall_hit = jnp.minimum(wall_hit, begin + i + wall_time)
            walk_x, walk_y = (walked_to.x - walked_from.x) / chords, (walked_to.y - walked_from.y) / chords
            rx, ry = x0 - walked_from.x - i * walk_x, y0 - walked_from.y - i * walk_y
            rex, rey = ex - walk_x, ey - walk_y
            pedestrian_time = time_to_disc(Vec2(rx, ry), Vec2(rex, rey), radius)
            pedestrian_time = jnp.min(jnp.where(walked_to.present, pedestrian_time, jnp.inf))
            pedestrian_hit = jnp.minimum(pedestrian_hit, begin + i + pedestrian_time)
            t = closest_approach(Vec2(rx, ry), Vec2(rex, rey))
            gap = jnp.where(walked_to.present, norm(rx + t * rex, ry + t * rey) - radius, jnp.inf)
            distance = jnp.minimum(distance, jnp.min(gap))
        collision = jnp.minimum(wall_hit, pedestrian_hit)
        collided = (collision < jnp.inf) & (collision <= arrival)
        hit_pedestrian = collided & (pedestrian_hit <= wall_hit)
        return (arrival < jnp.inf) & ~collided, collided, hit_pedestrian, distance


def _row(table, scene):
    """The row of one scene in a table of all."""
    return jax.tree.map(lambda leaf: jnp.asarray(leaf)[scene], table)


def _draw_traits(key, pedestrians):
    uniform = jax.random.uniform(key, (8, pedestrians))
    return PedestrianTraits(
        first=uniform[0], message=uniform[1], compliance=uniform[2], decides=uniform[3], side=uniform[4],
        reply_delay=(3 * uniform[5]).astype(jnp.int32), commit_delay=2 + (3 * uniform[6]).astype(jnp.int32),
        decide_delay=1 + (4 * uniform[7]).astype(jnp.int32),
    )  # fmt: skip
