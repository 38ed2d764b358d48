"""Pedestrians: what they want, what they do when asked, and that neither walls nor each other are walked through."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxnav.world import SCENES, Params, World, WorldConfig
from jaxnav.world.people.intention import preferred_velocity
from jaxnav.world.types import AGREES, LEFT, NONE, REFUSES, RIGHT, STOP
from jaxnav.world.walls import wall_clearance

DIAGONAL = np.sqrt(0.5)


@jax.jit
def _wants(state, params):
    vx, vy = jax.vmap(preferred_velocity, in_axes=(0, 0, 0, None))(
        state.pedestrians, state.encounters, state.traits, params
    )
    return jnp.stack([vx[0], vy[0]])


def heading_for(state, x, y):
    """A state whose pedestrians have a way point before them."""
    count = len(state.pedestrians.x)
    via_x, via_y = np.full(count, x, np.float32), np.full(count, y, np.float32)
    return state.replace(pedestrians=state.pedestrians.replace(via_x=via_x, via_y=via_y, turned=np.zeros(count, bool)))


@pytest.fixture
def wants(situation):
    """Preferred velocity of a pedestrian at (1, 2), in an encounter whose frozen direction is -x through that point."""

    def preferred(goal=(-3.0, 2.0), at=(1.0, 2.0), params=Params(), via=None, **encounter):
        frozen = {"is_open": True, "x": 1.0, "y": 2.0, "ux": -1.0, "uy": 0.0}
        state = situation(pedestrians=[(*at, *goal)], **frozen | encounter)
        return np.asarray(_wants(state if via is None else heading_for(state, *via), params))

    return preferred


def test_walks_to_the_goal_at_its_speed(wants):
    np.testing.assert_allclose(wants(goal=(4.0, 6.0)), [0.3, 0.4], atol=1e-6)


def test_the_last_step_ends_on_the_goal_and_there_it_stays(wants):
    np.testing.assert_allclose(0.4 * wants(goal=(1.06, 2.08)), [0.06, 0.08], atol=1e-6)
    np.testing.assert_allclose(wants(goal=(1.0, 2.0)), [0.0, 0.0], atol=1e-6)


@pytest.mark.parametrize(
    ("request_", "expected"),
    [
        (STOP, (0, 0)),
        # It walks toward -x: its right is +y, its left -y.
        (RIGHT, (-0.5 * DIAGONAL, 0.5 * DIAGONAL)),
        (LEFT, (-0.5 * DIAGONAL, -0.5 * DIAGONAL)),
        (NONE, (0.3, 0.4)),
    ],
    ids=["stop", "margin-right", "margin-left", "none"],
)
def test_granted_requests_act_on_the_frozen_direction_at_the_same_speed(wants, request_, expected):
    """The goal lies elsewhere by now: a margin is turned from the direction at the opening."""
    np.testing.assert_allclose(wants(goal=(4.0, 6.0), request=request_, reply=AGREES), expected, atol=1e-6)


@pytest.mark.parametrize("reply", [NONE, REFUSES])
def test_requests_that_are_not_granted_change_nothing(wants, reply):
    np.testing.assert_allclose(wants(request=STOP, reply=reply), [-0.5, 0], atol=1e-6)


@pytest.mark.parametrize(("message", "side"), [(STOP, 0.0), (RIGHT, 1.0), (LEFT, -1.0)])
def test_a_committed_pedestrian_tracks_the_line_it_announced(wants, message, side):
    """Half of 1.0 m and both radii to its own right (+y here) or left of the line at the opening."""
    committed = {"pedestrian_first": True, "message": message, "message_age": 2}
    there = 2.0 + side * 0.5 * (1.0 + 0.17 + 0.1)
    np.testing.assert_allclose(wants(at=(0.0, there), **committed), [-0.5, 0.0], atol=1e-6)
    back = wants(at=(0.0, there + 0.5), **committed)
    assert back[1] < -0.3
    assert np.hypot(*back) == pytest.approx(0.5, abs=1e-6)
    # One step before it commits it walks to its goal.
    np.testing.assert_allclose(wants(at=(0.0, 2.0), **committed | {"message_age": 1}), [-0.5, 0.0], atol=1e-6)


LATE = Params(p_decides_late=0.6)  # `situation` draws 0.5


@pytest.mark.parametrize(("side_draw", "side"), [(0.0, 1.0), (0.49, 1.0), (0.5, -1.0), (0.99, -1.0)])
def test_who_decides_alone_tracks_a_line_on_the_side_it_drew(wants, side_draw, side):
    """Half of 1.0 m and both radii to its own right (+y here) or left of the line at the opening."""
    alone = {"age": 2, "side_draw": side_draw, "params": LATE}
    there = 2.0 + side * 0.5 * (1.0 + 0.17 + 0.1)
    np.testing.assert_allclose(wants(at=(0.0, there), **alone), [-0.5, 0.0], atol=1e-6)
    # From the middle of its line 72 degrees off, three to one: it has about a second for it.
    np.testing.assert_allclose(wants(at=(1.0, 2.0), **alone), np.array([-0.5, side * 1.5]) / np.sqrt(10), atol=1e-6)
    # It goes there by itself only after its delay, and only if it is one of those who do.
    for changed in ({"age": 1}, {"params": Params(p_decides_late=0.5)}, {"params": Params()}):
        np.testing.assert_allclose(wants(**alone | changed), [-0.5, 0.0], atol=1e-6)


@pytest.mark.parametrize(
    ("request_", "expected"),
    [(STOP, (0, 0)), (RIGHT, (-0.5 * DIAGONAL, 0.5 * DIAGONAL)), (LEFT, (-0.5 * DIAGONAL, -0.5 * DIAGONAL))],
    ids=["stop", "margin-right", "margin-left"],
)
def test_who_has_agreed_obeys_and_decides_nothing_alone(wants, request_, expected):
    late = {"age": 2, "side_draw": 0.0, "params": LATE, "request": request_}
    np.testing.assert_allclose(wants(**late, reply=AGREES), expected, atol=1e-6)
    # Done obeying it keeps to what was agreed: on to its goal. One who refused goes its own way.
    np.testing.assert_allclose(wants(**late, reply=AGREES, request_age=10), [-0.5, 0.0], atol=1e-6)
    np.testing.assert_allclose(wants(**late, reply=REFUSES), np.array([-0.5, 1.5]) / np.sqrt(10), atol=1e-6)


def test_to_its_way_point_it_walks_at_full_speed_by_no_side(wants):
    """However near; committed or decided, it takes a side only once it has turned. What it granted it does at once."""
    to_via = 0.5 * np.array([0.6, 0.8])
    via = {"via": (1.06, 2.08), "goal": (4.0, 2.0)}
    committed = {"pedestrian_first": True, "message": RIGHT, "message_age": 2}
    for encounter in ({}, committed, {"age": 2, "params": LATE}):
        np.testing.assert_allclose(wants(**via, **encounter), to_via, atol=1e-6)
    np.testing.assert_allclose(wants(**via, request=STOP, reply=AGREES), [0.0, 0.0], atol=1e-6)


@pytest.fixture(scope="module")
def walk(walk_in):
    """A step of one pedestrian in the default scenes, near a robot."""
    world = World()
    return jax.jit(lambda state, params: walk_in(world.walls(state.scene), state, world.config, params))


@pytest.mark.parametrize(
    ("encounter", "avoids"),
    [
        ({}, True),
        ({"pedestrian_first": True, "message": STOP, "message_age": 1}, True),
        ({"pedestrian_first": True, "message": STOP, "message_age": 2}, False),
        ({"pedestrian_first": True, "message": STOP, "message_age": 2, "is_open": False}, True),
    ],
    ids=["silent", "announced", "committed", "passed"],
)
def test_the_robot_is_avoided_unless_committed(walk, situation, encounter, avoids):
    state = situation(
        robot=(1.0, 0.05, 0.0), pedestrians=[(0.0, 0.0, 4.0, 0.0)], **{"is_open": True, "ux": 1.0} | encounter
    )
    straight = np.array([0.5, 0.0])
    walked = walk(state, Params(awareness=2.0))
    differs = np.abs(np.array([walked.vx[0], walked.vy[0]]) - straight).max()
    assert (differs > 0.05) == avoids
    np.testing.assert_allclose([walked.x[0], walked.y[0]], 0.4 * np.array([walked.vx[0], walked.vy[0]]), atol=1e-6)


@pytest.mark.parametrize(("awareness", "avoids"), [(1.0, False), (1.1, True)])
def test_awareness_is_the_distance_between_centres_at_which_the_robot_is_avoided(walk, situation, awareness, avoids):
    state = situation(robot=(1.05, 0.0, 0.0), pedestrians=[(0.0, 0.0, 4.0, 0.0)])
    assert (abs(walk(state, Params(awareness=awareness)).vx[0] - 0.5) > 0.005) == avoids


@pytest.mark.parametrize(("p_decides_late", "avoids"), [(0.4, True), (0.6, False)])
def test_who_has_decided_alone_avoids_the_robot_no_more(walk, situation, p_decides_late, avoids):
    """It is on its line already, 0.635 m to the right of where it walked at the opening; the robot stands there."""
    state = situation(robot=(1.0, 0.05, 0.0), pedestrians=[(0.0, 0.0, 4.0, 0.0)], is_open=True, age=2, y=0.635, ux=1.0)
    walked = walk(state, Params(awareness=2.0, p_decides_late=p_decides_late))
    assert (np.abs([walked.vx[0] - 0.5, walked.vy[0]]).max() > 0.05) == avoids


@pytest.mark.parametrize(("x", "turned"), [(0.49, False), (0.51, True)])
def test_it_turns_within_30_cm_of_its_way_point(walk, situation, x, turned):
    """After a step of 0.2 m, 0.31 or 0.29 m are left."""
    state = heading_for(situation(pedestrians=[(x, 0.0, 1.0, 2.0)]), 1.0, 0.0)
    walked = walk(state, Params())
    np.testing.assert_allclose([walked.x[0], walked.y[0]], [x + 0.2, 0.0], atol=1e-5)
    assert walked.turned[0] == turned
    after = walk(state.replace(pedestrians=walked), Params())
    to_goal = np.array([1.0 - walked.x[0], 2.0]) / np.hypot(1.0 - walked.x[0], 2.0)
    np.testing.assert_allclose([after.vx[0], after.vy[0]], 0.5 * to_goal if turned else [0.5, 0.0], atol=1e-5)


def test_it_gets_to_its_goal_by_way_of_its_way_point_and_turns_once(walk, situation):
    state = heading_for(situation(robot=(-4.0, -4.0, 0.0), pedestrians=[(0.0, 0.0, 1.0, 2.0)]), 1.0, 0.0)
    walkers, turned = state.pedestrians, []
    for _ in range(20):
        walkers = walk(state.replace(pedestrians=walkers), Params())
        turned.append(bool(walkers.turned[0]))
    assert turned == [False] * 3 + [True] * 17
    np.testing.assert_allclose([walkers.x[0], walkers.y[0]], [1.0, 2.0], atol=1e-5)


def free(scene, x, y):
    """Whether points lie within the scene's floors."""
    return np.any([(x0 <= x) & (x <= x1) & (y0 <= y) & (y <= y1) for x0, y0, x1, y1 in SCENES[scene].floors], axis=0)


@pytest.mark.parametrize("scene", range(3), ids=["square", "hallway", "crosswalk"])
def test_nobody_leaves_through_a_wall(scene, random_walks, situation):
    """Goals outside, a crowd, a robot, margins asked and announced: bodies stay within the walls throughout."""
    x, y, clearance = random_walks(scene, situation)
    assert np.all(free(list(SCENES)[scene], x, y))
    assert clearance.min() >= Params().body_radius - 1e-4
    assert np.mean(clearance < 0.15) > 0.2  # many did walk up to a wall


@pytest.fixture(scope="module")
def random_walks(walk_in):
    """(x, y, clearance) `[60, 128, 3]` of crowds of three beside a robot, in the scene with that index."""
    config = WorldConfig(pedestrians=3)
    world = World(config)
    params = Params(awareness=1.0, neighbor_distance=1.0)

    @jax.jit
    @jax.vmap
    def play(state, scene):
        walls = world.walls(scene)

        def step(walkers, _):
            walkers = walk_in(walls, state.replace(pedestrians=walkers), config, params)
            return walkers, (walkers.x, walkers.y, wall_clearance(walkers.x, walkers.y, walls))

        return jax.lax.scan(step, state.pedestrians, None, length=60)[1]

    def walks(scene, situation):
        rng = np.random.default_rng(scene)
        states = []
        for _ in range(128):
            floor = rng.permutation(SCENES[list(SCENES)[scene]].floors)[0]
            x, y = (rng.uniform(floor[i] + 0.15, floor[i + 2] - 0.15, 4) for i in (0, 1))
            direction = rng.uniform(0, 2 * np.pi, 3)
            first, message = rng.integers(0, 2, 3).astype(bool), rng.integers(1, 4, 3)
            states.append(
                situation(
                    robot=(x[3], y[3], 0.0), twist=(0.6, 0.0), scene=scene, is_open=True, pedestrian_first=first,
                    pedestrians=np.stack([x[:3], y[:3], 9 * np.cos(direction), 9 * np.sin(direction)], axis=1),
                    message=message * first, message_age=9, request=message * ~first, request_age=5,
                    reply=rng.integers(0, 3, 3), x=x[:3], y=y[:3], ux=np.cos(direction), uy=np.sin(direction),
                )
            )  # fmt: skip
        states = jax.tree.map(lambda *leaves: np.stack(leaves), *states)
        return jax.tree.map(np.asarray, play(states, np.full(128, scene, np.int32)))

    return walks


def test_two_who_walk_at_each_other_never_overlap(situation, walk_in):
    """ORCA's promise, from any headings of an encounter, exactly head-on ones among them."""
    config = WorldConfig(pedestrians=2)
    world = World(config)
    params = Params(awareness=3.0, neighbor_distance=10.0)

    def meet(offset, angle):
        ux, uy = jnp.cos(angle), jnp.sin(angle)
        state = jax.tree.map(jnp.asarray, situation(robot=(-4.8, -4.8, 0.0), pedestrians=[(0, 0, 0, 0)] * 2))
        x, y = jnp.stack([-2.0, 2.0 * ux]), jnp.stack([0.0, offset + 2.0 * uy])
        walkers = state.pedestrians.replace(
            x=x, y=y, goal_x=jnp.stack([2.0, -2.0 * ux]), goal_y=jnp.stack([0.0, offset - 2.0 * uy]),
            vx=jnp.stack([0.5, -0.5 * ux]), vy=jnp.stack([0.0, -0.5 * uy]),
        )  # fmt: skip

        def step(walkers, _):
            walkers = walk_in(world.walls(0), state.replace(pedestrians=walkers), config, params)
            return walkers, jnp.hypot(walkers.x[1] - walkers.x[0], walkers.y[1] - walkers.y[0])

        return jax.lax.scan(step, walkers, None, length=40)[1]

    offsets, angles = np.meshgrid(np.linspace(-0.4, 0.4, 9), np.linspace(-2.0, 2.0, 9))
    distances = np.asarray(jax.jit(jax.vmap(meet))(jnp.array(offsets.ravel()), jnp.array(angles.ravel())))
    assert distances.min() >= 2 * params.body_radius - 1e-3
    assert np.median(distances.min(axis=1)) < 0.5  # they do meet
