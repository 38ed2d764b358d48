"""Random worlds: whatever scene, crowd, parameters and actions are drawn, all is finite, in bounds and consistent.

The static side of a world is drawn once, as the worlds below, each of which is compiled once; all else is drawn.
"""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from jaxnav.world import SCENES, SUITES, Action, Params, World, WorldConfig, check_params
from jaxnav.world.config import OBSERVATION_PARTS
from jaxnav.world.walls import wall_clearance

EPISODES, STEPS = 8, 12
WORLDS = {
    "alone with one": WorldConfig(
        scenes=tuple(name for name, scene in SCENES.items() if scene.crowd in (None, (1, 1))), beams=31, body="legs",
        scan_noise=True, scan_delay=2, control_delay=3,
    ),
    "hard": WorldConfig(
        scenes=(*SUITES["hard"], *SUITES["hard-laser"]), pedestrians=8, nearest=2, max_neighbors=4, beams=45,
        reward="paper-text", observation=OBSERVATION_PARTS, scan_noise=True,
    ),
    "a full square": WorldConfig(
        scenes=("square",), pedestrians=64, nearest=70, max_neighbors=2, wall_neighbors=2, hearing=False,
        observation=("pedestrians", "dialogue", "pedestrian_map"), swept_collisions=False, control_delay=1,
    ),
}  # fmt: skip

# Far beyond what anybody would choose, and zero wherever zero is allowed.
RANGES = {
    "dt": (0.01, 2.0), "max_v": (0.01, 10.0), "max_w": (0.0, 20.0), "robot_radius": (0.01, 0.29),
    "goal_tolerance": (0.0, 5.0), "max_steps": (0.5, 20.0), "scan_range": (0.01, 100.0), "scan_noise_std": (0.0, 10.0),
    "scan_dropout": (0.0, 1.0), "body_radius": (0.0, 0.29), "max_speed": (0.0, 10.0), "awareness": (0.0, 20.0),
    "neighbor_distance": (0.0, 20.0), "time_horizon": (0.01, 50.0), "time_horizon_walls": (0.01, 20.0),
    "encounter_distance": (0.0, 20.0), "encounter_clearance": (0.0, 20.0), "encounter_horizon": (0.0, 50.0),
    "p_pedestrian_first": (0.0, 1.0), "compliance": (0.0, 1.0), "obey_steps": (0.0, 100.0),
    "p_decides_late": (0.0, 1.0), "message_exceptions": (0.0, 1.0), "passing_clearance": (0.0, 10.0),
    "small_talk": (0.0, 1.0),
    **{name: (-1000.0, 1000.0) for name in Params.__dataclass_fields__ if name.startswith("reward_")},
    "safe_distance": (0.0, 20.0), "comfort_distance": (0.0, 20.0),
}  # fmt: skip
# Those that only people of the social force model read: tests/world/people draws them.
SOCIAL_FORCE = {
    "relaxation_time", "pedestrian_force", "pedestrian_force_range", "stride_time", "wall_force", "wall_force_range",
    "view_angle", "unseen_weight",
}  # fmt: skip
WHOLE = {"scan_latency": "scan_delay", "control_latency": "control_delay", "crowd_size": "pedestrians"}


def test_every_parameter_is_drawn():
    assert {*RANGES, *WHOLE, *SOCIAL_FORCE, "preferred_speed"} == set(Params.__dataclass_fields__)


@st.composite
def random_params(draw, config):
    """`Params` of a world of that config: half of them as a rule at their defaults, the others anywhere."""
    chosen = {}
    for name, (low, high) in RANGES.items():
        if draw(st.booleans()):
            chosen[name] = draw(st.floats(float(np.float32(low)), float(np.float32(high)), width=32))
    for name, longest in WHOLE.items():
        chosen[name] = float(draw(st.integers(0, getattr(config, longest))))
    speed = Params().replace(**chosen).max_speed
    chosen["preferred_speed"] = draw(st.one_of(st.just(speed), st.floats(0.0, speed, width=32)))
    params = Params(**chosen)
    check_params(params, config)
    return jax.tree.map(np.float32, params)


@dataclasses.dataclass(frozen=True)
class Played:
    """`EPISODES` random episodes: states `[E, STEPS + 1]`, observations likewise, outcomes `[E, STEPS]`, numpy.

    clearance: `[E, STEPS + 1, 1 + P]` distance of robot and pedestrians to the nearest wall.
    """

    states: object
    observations: object
    outcomes: object
    clearance: np.ndarray


@pytest.fixture(scope="session")
def play():
    """A function (name of a world, seed, `Params`) -> `Played`; compiles each world once."""

    def program(world):
        def episode(key, params):
            key_reset, *keys = jax.random.split(key, STEPS + 1)

            def step(state, key):
                key_twist, key_request, key_step = jax.random.split(key, 3)
                action = Action(
                    twist=jax.random.uniform(key_twist, (2,), minval=-1.5, maxval=1.5),
                    request=jax.random.randint(key_request, (), 0, 4),
                )
                state, outcome = world.step(key_step, state, action, params)
                return state, (state, outcome)

            first = world.reset(key_reset, params)
            _, (later, outcomes) = jax.lax.scan(step, first, jnp.stack(keys))
            states = jax.tree.map(lambda a, b: jnp.concatenate([a[None], b]), first, later)
            return states, *jax.vmap(look, in_axes=(0, None))(states, params), outcomes

        def look(state, params):
            x = jnp.concatenate([state.robot.x[None], state.pedestrians.x])
            y = jnp.concatenate([state.robot.y[None], state.pedestrians.y])
            return world.observe(state, params), wall_clearance(x, y, world.walls(state.scene))

        return jax.jit(jax.vmap(episode, in_axes=(0, None)))

    programs = {}

    def played(name, seed, params):
        if name not in programs:
            programs[name] = program(World(WORLDS[name]))
        keys = jax.random.split(jax.random.key(seed), EPISODES)
        states, observations, clearance, outcomes = jax.device_get(programs[name](keys, params))
        return Played(states, observations, outcomes, clearance)

    return played


@pytest.mark.parametrize("name", WORLDS)
def test_all_is_finite_in_bounds_and_consistent(name, play, full):
    config = WORLDS[name]

    @settings(max_examples=500 if full else 25)
    @given(st.integers(0, 2**32 - 1), random_params(config))
    @example(0, jax.tree.map(np.float32, Params(max_v=0.1)))  # people who have come far by the time they are met
    def holds(seed, params):
        played = play(name, seed, params)
        assert_finite(played)
        assert_states(played, config, params)
        assert_outcomes(played, params)
        assert_observations(played, config, params)

    holds()


def assert_finite(played):
    for part in (played.states, played.outcomes, played.observations):
        for path, leaf in jax.tree_util.tree_leaves_with_path(part):
            assert np.all(np.isfinite(leaf)), jax.tree_util.keystr(path)


def assert_states(played, config, params):
    states, outcomes = played.states, played.outcomes
    people, encounters = states.pedestrians, states.encounters
    assert np.all(states.t == np.arange(STEPS + 1))
    for leaf in (states.scene, states.seed, people.present, people.goal_x, states.traits.first):
        np.testing.assert_array_equal(leaf, np.broadcast_to(leaf[:, :1], leaf.shape))

    # Who is there: of the scene's crowd as many as the world has slots for, first slots first; else as many as asked.
    usual = int(params.crowd_size) or config.pedestrians
    crowds = np.array([SCENES[scene].crowd or (usual, usual) for scene in config.scenes])
    count = people.present.sum(axis=-1)
    fewest, most = np.minimum(crowds, config.pedestrians)[states.scene].transpose(2, 0, 1)
    assert np.all((fewest <= count) & (count <= most))
    np.testing.assert_array_equal(people.present, np.arange(config.pedestrians) < count[..., None])

    # Nobody walks faster than allowed, nor jumps.
    speed = np.hypot(people.vx, people.vy)
    assert np.all(speed <= params.max_speed * (1 + 1e-5) + 1e-6)
    moved = np.stack([np.diff(people.x, axis=1), np.diff(people.y, axis=1)])
    velocity = np.stack([people.vx[:, 1:], people.vy[:, 1:]])
    np.testing.assert_allclose(moved, params.dt * velocity, atol=1e-4)
    assert np.all(np.diff(people.turned.astype(int), axis=1) >= 0)

    # Nobody walks through a wall, unless a step is longer than the horizon, or than what keeps to the walls nearby that
    # are looked at; the robot's way ends there.
    careful = (params.dt <= params.time_horizon_walls) & (params.dt * params.max_speed <= 0.5)
    there = people.present & careful
    assert np.all(played.clearance[..., 1:][there] >= params.body_radius - 2e-3)
    assert np.all(inside(config, states.scene, people.x, people.y)[there & (played.clearance[..., 1:] > 1e-2)])
    starts = jax.tree.map(lambda leaf: leaf[:, 0], states)
    for x, y in ((starts.robot.x, starts.robot.y), (starts.robot.goal_x, starts.robot.goal_y)):
        assert np.all(inside(config, starts.scene, x[:, None], y[:, None]))
    for x, y in ((people.x, people.y), (people.goal_x, people.goal_y)):
        assert np.all(inside(config, starts.scene, x[:, 0], y[:, 0])[people.present[:, 0]])
    alive = np.cumsum(outcomes.terminated, axis=1) == 0
    if config.swept_collisions:
        assert np.all(played.clearance[:, 1:, 0][alive] >= params.robot_radius - 1e-3)
    robot = states.robot
    driven = np.hypot(np.diff(robot.x, axis=1), np.diff(robot.y, axis=1))
    assert np.all(driven <= params.max_v * params.dt * (1 + 1e-4) + 1e-4)
    assert np.all((robot.v >= 0) & (robot.v <= params.max_v * (1 + 1e-6)))
    assert np.all(np.abs(robot.w) <= params.max_w * (1 + 1e-6))

    # Dialogue.
    assert_dialogue(encounters)
    assert not np.any(encounters.met & ~people.present)
    assert np.all(encounters.is_open <= encounters.met)
    assert np.all(encounters.age >= 0)
    assert not np.any((encounters.message != 0) & ~(encounters.is_open & encounters.pedestrian_first))
    assert not np.any((encounters.request != 0) & (~encounters.is_open | encounters.pedestrian_first))
    assert not np.any((encounters.reply != 0) & (encounters.request == 0))


def inside(config, scene, x, y):
    """Whether points `[..., P]` are in the free space of scenes `[...]`: the chains go around them once, by angle."""
    around = np.zeros((len(config.scenes), *x.shape))
    for number, name in enumerate(config.scenes):
        for chain in SCENES[name].chains:
            to = np.array([complex(*vertex) for vertex in chain]) - (x + 1j * y)[..., None]
            around[number] += np.angle(np.roll(to, -1, axis=-1) / to).sum(axis=-1) / (2 * np.pi)
    chosen = np.take_along_axis(around, np.broadcast_to(scene[..., None], x.shape)[None], axis=0)[0]
    return np.abs(chosen - 1.0) < 1e-3


def assert_dialogue(said):
    for field, count in (("message", 4), ("request", 4), ("reply", 3), ("is_open", 2), ("pedestrian_first", 2)):
        assert np.all((getattr(said, field) >= 0) & (getattr(said, field) < count)), field
    for field in ("message_age", "request_age"):
        assert np.all((getattr(said, field) >= 0) & (getattr(said, field) <= STEPS)), field
    assert np.all(said.utterance <= 2**16)


def assert_outcomes(played, params):
    states, outcomes = played.states, played.outcomes
    np.testing.assert_array_equal(outcomes.terminated, outcomes.arrived | outcomes.collided)
    assert not np.any(outcomes.arrived & outcomes.collided)
    assert not np.any(outcomes.hit_pedestrian & ~outcomes.collided)
    np.testing.assert_array_equal(outcomes.truncated, (states.t[:, 1:] >= params.max_steps) & ~outcomes.terminated)
    assert np.all((outcomes.requested >= 0) & (outcomes.requested < 4))
    assert np.all((outcomes.reply >= 0) & (outcomes.reply < 3))

    terms = np.stack(list(outcomes.reward_terms.values()))
    np.testing.assert_allclose(outcomes.reward, terms.sum(axis=0), rtol=1e-5, atol=1e-5 * (1 + np.abs(terms).max()))
    goal = np.where(outcomes.collided, params.reward_collision, outcomes.arrived * params.reward_arrival)
    np.testing.assert_array_equal(outcomes.reward_terms["goal"], goal)

    assert np.all(outcomes.pedestrian_distance >= -(params.robot_radius + params.body_radius) - 1e-5)
    least = np.minimum.accumulate(outcomes.pedestrian_distance, axis=1)
    np.testing.assert_array_equal(states.min_distance[:, 1:], np.minimum(least, states.min_distance[:, :1]))
    robot = jax.tree.map(lambda leaf: leaf[:, 1:], states.robot)
    gap = np.hypot(robot.goal_x - robot.x, robot.goal_y - robot.y)
    np.testing.assert_allclose(outcomes.goal_distance, gap, rtol=1e-4, atol=1e-4)
    assert np.all(outcomes.goal_distance[~outcomes.terminated] >= params.goal_tolerance - 1e-3)


def assert_observations(played, config, params):
    seen, states = played.observations, played.states
    parts = {name: getattr(seen, name) for name in OBSERVATION_PARTS}
    assert {name for name, part in parts.items() if part is not None} == set(config.observation)
    np.testing.assert_array_equal(seen.twist, np.stack([states.robot.v, states.robot.w], axis=-1))
    open_ = states.encounters.is_open & ~states.encounters.pedestrian_first & (states.encounters.request == 0)
    np.testing.assert_array_equal(seen.may_request, open_.any(axis=-1))
    known = min(config.nearest, config.pedestrians)
    if seen.scan is not None:
        assert seen.scan.shape[2:] == (config.beams,)
        assert np.all((seen.scan >= 0) & (seen.scan <= params.scan_range * (1 + 1e-6)))
    if seen.pedestrians is not None:
        assert seen.pedestrians.shape[2:] == (known, 4)
        assert np.all(seen.pedestrians[~seen.seen] == 0)
        assert np.all(seen.seen.sum(axis=-1) <= states.pedestrians.present.sum(axis=-1))
        distance = np.hypot(seen.pedestrians[..., 0], seen.pedestrians[..., 1])
        nearer = seen.seen[..., 1:] & seen.seen[..., :-1]
        assert np.all(np.diff(distance, axis=-1)[nearer] >= -1e-4)
    if seen.dialogue is not None:
        assert seen.dialogue.message.shape[2:] == (known,)
        assert_dialogue(seen.dialogue)
        assert config.hearing or not np.any(seen.dialogue.message | seen.dialogue.utterance)
    if seen.sensor_map is not None:
        assert np.all(np.isin(seen.sensor_map, np.float32([0, 100 / 255, 200 / 255, 1])))
    if seen.pedestrian_map is not None:
        occupied, vx, vy = np.moveaxis(seen.pedestrian_map, 2, 0)
        assert np.all(np.isin(occupied, (0.0, 1.0)))
        assert not np.any(np.abs(vx[occupied == 0]) + np.abs(vy[occupied == 0]))
        assert np.all(np.hypot(vx, vy) <= params.max_speed * (1 + 1e-4) + 1e-4)
