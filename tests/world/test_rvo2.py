"""Crowds beside RVO2 itself (pyrvo, bindings of the C++ library): the same new velocities, walls and all."""

import jax
import jax.numpy as jnp
import numpy as np
import pyrvo
import pytest

from jaxnav.world import Params, WorldConfig
from jaxnav.world.walls import pad_walls, walls_from_chains

AGENTS, STEPS = 20, 20
CONFIG = WorldConfig(pedestrians=AGENTS, wall_neighbors=12)
PARAMS = Params(neighbor_distance=3.0, time_horizon=3.0, time_horizon_walls=2.0, body_radius=0.2)
FAR = 1e3  # where agents stand that a crowd doesn't have
AGREEMENT = 1e-4  # metres a second
NOWHERE = [[(FAR, FAR), (FAR + 1, FAR), (FAR, FAR + 1)]]


def polygon(rng, centre):
    """A solid of 2 to 6 corners, some of them reflex, around ``centre``: clockwise, free space to the left."""
    kind = rng.integers(4)
    turn = rng.uniform(0, 2 * np.pi)
    if kind == 0:  # a wall without thickness
        corners = np.array([[-0.7, 0.0], [0.7, 0.0]])
    elif kind == 1:
        half = rng.uniform(0.2, 0.6, 2)
        corners = half * np.array([[-1, -1], [-1, 1], [1, 1], [1, -1]])
    elif kind == 2:  # an L
        corners = 0.35 * np.array([[-1, -1], [-1, 2], [0, 2], [0, 0], [2, 0], [2, -1]])
    else:
        angles = -np.sort(rng.uniform(0, 2 * np.pi, rng.integers(3, 6)))
        corners = rng.uniform(0.3, 0.7) * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    return centre + corners @ np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])


def outside(points, corners):
    """Whether points are not in a polygon: by the number of edges to their right."""
    a, b = corners, np.roll(corners, -1, axis=0)
    spans = (a[:, 1] > points[:, None, 1]) != (b[:, 1] > points[:, None, 1])
    with np.errstate(divide="ignore", invalid="ignore"):
        x = a[:, 0] + (points[:, None, 1] - a[:, 1]) * (b[:, 0] - a[:, 0]) / (b[:, 1] - a[:, 1])
    return np.sum(spans & (x > points[:, None, 0]), axis=1) % 2 == 0


def random_crowd(rng, with_walls):
    """(positions, goals `[n, 2]`, chains): solids in a ring, agents between them, nobody in touch."""
    chains = []
    if with_walls:
        angles = rng.uniform(0, 2 * np.pi) + np.arange(4) * np.pi / 2
        centres = rng.uniform(1.2, 1.6, 4)[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1)
        chains = [polygon(rng, centre) for centre in centres[: rng.integers(1, 5)]]
    count, size = rng.integers(2, AGENTS + 1), rng.uniform(2.5, 4.0)
    positions = np.zeros((0, 2))
    while len(positions) < count:
        at = rng.uniform(-size, size, 2) / 2
        clear = all(outside(at[None], chain)[0] for chain in chains)
        if clear and np.all(np.hypot(*(positions - at).T) > 0.42):
            positions = np.vstack([positions, at])
        size += 0.02
    return positions, rng.uniform(-3, 3, (count, 2)), chains


def chains_of(simulator):
    """The walls that RVO2 searches, as chains of ours: where one crosses the line of another it splits them."""
    left = set(range(simulator.get_num_obstacle_vertices()))
    chains = []
    while left:
        vertex, chain = min(left), []
        while vertex in left:
            left.remove(vertex)
            chain.append(simulator.get_obstacle_vertex(vertex).to_tuple())
            vertex = simulator.get_prev_obstacle_vertex(vertex)  # their solids have the inside to the left
        chains.append(chain)
    return chains


def walk_in_rvo2(positions, goals, chains):
    """(`[STEPS + 1, n, 4]` positions and velocities, chains of the walls as RVO2 has split them)."""
    simulator = pyrvo.RVOSimulator(
        PARAMS.dt, PARAMS.neighbor_distance, CONFIG.max_neighbors, PARAMS.time_horizon, PARAMS.time_horizon_walls,
        PARAMS.body_radius, PARAMS.max_speed,
    )  # fmt: skip
    for chain in chains:
        simulator.add_obstacle([tuple(map(float, vertex)) for vertex in chain[::-1]])
    simulator.process_obstacles()
    for at in positions:
        simulator.add_agent(tuple(at))
    record = []
    for _ in range(STEPS):
        states = [
            (*simulator.get_agent_position(i).to_tuple(), *simulator.get_agent_velocity(i).to_tuple())
            for i in range(len(positions))
        ]
        record.append(states)
        for i, (x, y, _, _) in enumerate(states):
            to_x, to_y = goals[i] - (x, y)
            away = np.hypot(to_x, to_y)
            speed = min(PARAMS.preferred_speed, away / PARAMS.dt)
            simulator.set_agent_pref_velocity(i, (speed * to_x / away, speed * to_y / away))
        simulator.do_step()
    record.append([(0.0, 0.0, *simulator.get_agent_velocity(i).to_tuple()) for i in range(len(positions))])
    return np.array(record), chains_of(simulator)


@pytest.fixture(scope="module")
def walk(situation, walk_in):
    """Velocities `[N, AGENTS, 2]` that ORCA people choose for crowds `[N, AGENTS, 6]`; the robot is far away."""
    still = situation(robot=(3 * FAR, 0.0, 0.0), pedestrians=np.zeros((AGENTS, 4)))

    def step(crowd, walls):
        fields = dict(zip(("x", "y", "vx", "vy", "goal_x", "goal_y"), crowd.T, strict=True))
        pedestrians = still.pedestrians.replace(**fields)
        walked = walk_in(walls, still.replace(pedestrians=pedestrians), CONFIG, PARAMS)
        return jnp.stack([walked.vx, walked.vy], axis=-1)

    return jax.jit(jax.vmap(step))


def test_crowds_walk_as_in_rvo2(walk, full):
    """New velocities of 2 to 20 agents, in the open and among walls, 20 steps: the C++ library's, to 1e-4 m/s.

    At full size nine of 215,500 differ, most of them in pairs: there the relative velocity lies on the axis of the
    velocity obstacle, and rounding decides on which side the two pass. All of them must be of that kind: moved by a
    few millionths, some of them at least, our agents choose as RVO2 did.
    """
    rng = np.random.default_rng(0)
    states, expected, walls = [], [], []
    for number in range(1000 if full else 50):
        positions, goals, chains = random_crowd(rng, with_walls=number % 2 == 1)
        record, chains = walk_in_rvo2(positions, goals, chains)
        count = len(positions)
        padded = np.zeros((STEPS, AGENTS, 6), np.float32)
        padded[..., 0] = padded[..., 4] = FAR + 10 * np.arange(AGENTS)
        padded[:, :count, :4], padded[:, :count, 4:] = record[:-1], goals
        states.append(padded)
        expected.append(np.pad(record[1:, :, 2:], ((0, 0), (0, AGENTS - count), (0, 0)), constant_values=np.nan))
        walls += [walls_from_chains(chains or NOWHERE)] * STEPS
    states, expected, walls = np.concatenate(states), np.concatenate(expected), pad_walls(walls)
    error = np.abs(np.asarray(walk(states, walls)) - expected).max(axis=-1)
    present = np.isfinite(error)
    assert present.sum() > 10_000
    assert np.mean(error[present] <= AGREEMENT) >= 0.999
    for step, agent in np.argwhere(error > AGREEMENT):
        moved = np.repeat(states[step][None], len(states), axis=0)
        moved[..., :4] += rng.uniform(-4e-6, 4e-6, (*moved.shape[:2], 4))
        here = jax.tree.map(lambda leaf, step=step: np.repeat(leaf[step][None], len(states), axis=0), walls)
        others = np.asarray(walk(moved, here))[:, agent]
        assert np.abs(others - expected[step, agent]).max(axis=-1).min() < 1e-3, (step, agent, error[step, agent])


def crowd_of(rng, count, size):
    """Positions, velocities and goals `[count, 2]` of a random crowd in a square of that size, nobody overlapping."""
    while True:
        at = rng.uniform(-size / 2, size / 2, (count, 2))
        gaps = np.linalg.norm(at[:, None] - at[None], axis=-1) + np.eye(count)
        if gaps.min() > 0.28:
            return at, rng.uniform(-0.4, 0.4, (count, 2)), rng.uniform(-4, 4, (count, 2))


@pytest.fixture(scope="module")
def walk_freely(walk_in):
    """A step of six pedestrians and the robot without walls, whose `walk` sees all within 3 m; `[N]` crowds at once."""
    config = WorldConfig(pedestrians=6)
    nothing = jax.tree.map(jnp.asarray, walls_from_chains(NOWHERE))

    def step(state, params):
        return walk_in(nothing, state, config, params)

    return jax.jit(jax.vmap(step, in_axes=(0, None)))


@pytest.mark.parametrize("size", [1.2, 2.0, 4.0])
def test_the_robot_is_one_of_the_agents(size, walk_freely, situation):
    """Six pedestrians who see a robot of another size, dense (infeasible) to sparse."""
    params = Params(awareness=3.0, neighbor_distance=3.0)
    rng = np.random.default_rng(0)
    states, expected = [], []
    for _ in range(60):
        at, velocity, goals = crowd_of(rng, 7, size)
        simulator = pyrvo.RVOSimulator(
            params.dt, 3.0, 10, params.time_horizon, 1.0, params.body_radius, params.max_speed
        )
        for i in range(7):
            simulator.add_agent(tuple(at[i]))
            simulator.set_agent_velocity(i, tuple(velocity[i]))
            away = np.linalg.norm(goals[i] - at[i])
            speed = min(params.preferred_speed, away / params.dt)
            simulator.set_agent_pref_velocity(i, tuple(speed * (goals[i] - at[i]) / away))
        simulator.set_agent_radius(6, params.robot_radius)
        simulator.do_step()
        expected.append([[*simulator.get_agent_velocity(i).to_tuple()] for i in range(6)])
        heading = np.arctan2(velocity[6, 1], velocity[6, 0])
        state = situation(
            robot=(*at[6], heading), twist=(np.linalg.norm(velocity[6]), 0.0), pedestrians=np.hstack([at, goals])[:6]
        )
        vx, vy = velocity[:6].T.astype(np.float32)
        states.append(state.replace(pedestrians=state.pedestrians.replace(vx=vx, vy=vy)))
    walked = walk_freely(jax.tree.map(lambda *leaves: np.stack(leaves), *states), params)
    np.testing.assert_allclose(np.stack([walked.vx, walked.vy], axis=-1), expected, atol=1e-4)
