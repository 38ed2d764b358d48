"""Social forces beside closed forms, and step by step beside the same model written in numpy."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxnav.world import Params, World, WorldConfig
from jaxnav.world.people import SocialForce, intend
from jaxnav.world.people.social_force import relaxation, repulsion, view_weight, wall_repulsion

PARAMS = Params()


def test_velocity_relaxes_exponentially_to_the_wanted_one(walk_in, situation):
    """In the open, after t seconds exp(-t / tau) of the difference is left, but for the size of the sub-steps."""
    world = World(WorldConfig(scenes=("square",)))
    params = Params(relaxation_time=0.5, max_speed=2.0, preferred_speed=1.0)
    state = situation(pedestrians=[(0.0, 0.0, 4.0, 0.0)], speed=0.0, robot=(-4.0, -4.0, 0.0))
    walked = walk_in(world.walls(0), state, world.config, params, SocialForce(substeps=400))
    left = np.exp(-0.4 / 0.5)
    assert walked.vx[0] == pytest.approx(1.0 - left, abs=1e-3)
    assert walked.x[0] == pytest.approx(0.4 - 0.5 * (1.0 - left), abs=1e-3)
    np.testing.assert_allclose(relaxation(0.2, 0.0, 1.0, -0.5, params), [1.6, -1.0], rtol=1e-6)


@pytest.mark.parametrize("distance", [0.3, 0.8, 2.0])
@pytest.mark.parametrize("speed", [0.0, 0.5])
def test_force_of_one_straight_ahead(distance, speed):
    """Who walks away from us, beyond it: b^2 = d (d + s), db/dd = (d + s / 2) / b, s the stride ahead of it."""
    stride = speed * PARAMS.stride_time
    b = np.sqrt(distance * (distance + stride))
    size = 2.1 / 0.3 * np.exp(-b / 0.3) * (distance + stride / 2) / b
    np.testing.assert_allclose(repulsion(-distance, 0.0, speed, 0.0, PARAMS), [-size, 0.0], rtol=1e-5)


def test_it_is_minus_the_gradient_of_its_potential():
    """V0 exp(-b / sigma), with the semi-minor axis b of the ellipse through the point."""

    def potential(dx, dy, vx, vy):
        sx, sy = 2.0 * vx, 2.0 * vy
        both = jnp.hypot(dx, dy) + jnp.hypot(dx - sx, dy - sy)
        return 2.1 * jnp.exp(-0.5 * jnp.sqrt(both**2 - sx**2 - sy**2) / 0.3)

    where = jnp.asarray(np.random.default_rng(0).normal(0.0, 0.6, (4, 200)), jnp.float32)
    gradient = jax.vmap(jax.grad(potential, argnums=(0, 1)))(*where)
    force = jax.vmap(lambda *at: repulsion(*at, PARAMS))(*where)
    # Within a centimetre of the way between the foci the ellipse is kept as thin as that.
    far = np.asarray(jax.vmap(potential)(*where)) < 2.1 * np.exp(-0.02 / 0.3)
    assert far.sum() > 190
    np.testing.assert_allclose(np.stack(force)[:, far], -np.stack(gradient)[:, far], rtol=1e-2, atol=1e-3)


@pytest.mark.parametrize(("degrees", "weight"), [(0, 1.0), (99, 1.0), (-99, 1.0), (101, 0.5), (180, 0.5)])
def test_what_is_outside_of_200_degrees_counts_half(degrees, weight):
    """The one who pushes stands so many degrees off the direction in which we want to go."""
    angle = np.deg2rad(30.0 + degrees)
    want = np.cos(np.deg2rad(30.0)), np.sin(np.deg2rad(30.0))
    assert view_weight(*want, -3.0 * np.cos(angle), -3.0 * np.sin(angle), PARAMS) == weight


def test_walls_push_from_their_nearest_points_and_a_corner_once():
    x, y = jnp.float32(0.3), jnp.float32(0.4)
    wall, onward = (-1.0, 0.0, 1.0, 0.0, jnp.bool_(True)), (1.0, 0.0, 1.0, -2.0, jnp.bool_(True))
    size = 10.0 / 0.2 * np.exp(-0.4 / 0.2)
    np.testing.assert_allclose(wall_repulsion(x, y, [wall], PARAMS), [0.0, size], atol=1e-5)
    away = np.array([0.6, 0.8])  # half a metre from the corner at (1, 0)
    at = jnp.asarray(np.array([1.0, 0.0]) + 0.5 * away, jnp.float32)
    both = wall_repulsion(*at, [wall, onward], PARAMS)
    np.testing.assert_allclose(both, 50.0 * np.exp(-0.5 / 0.2) * away, rtol=1e-4)


def independent(people, robot, wanted, ignores, segments, present, p, substeps=16):
    """The model again, in numpy, a pedestrian at a time: (x, y, vx, vy) `[P, 4]` a step later.

    people: `[P, 4]`; robot: x, y, vx, vy; wanted: `[P, 2]`; segments: of each pedestrian, the walls that it minds.
    """
    h = p.dt / substeps
    people = np.array(people, float)
    for k in range(substeps):
        place = np.append(people, [[robot[0] + k * h * robot[2], robot[1] + k * h * robot[3], *robot[2:]]], axis=0)
        new = people.copy()
        for i, (here, velocity) in enumerate(zip(people[:, :2], people[:, 2:], strict=True)):
            force = (wanted[i] - velocity) / p.relaxation_time
            for j, other in enumerate(place):
                is_robot = j == len(people)
                if j == i or (not is_robot and not present[j]) or (is_robot and ignores[i]):
                    continue
                r = here - other[:2]
                if np.linalg.norm(r) >= (p.awareness if is_robot else p.neighbor_distance):
                    continue
                s = other[2:] * p.stride_time
                n1, n2 = np.linalg.norm(r), np.linalg.norm(r - s)
                b = max(0.5 * np.sqrt(max((n1 + n2) ** 2 - s @ s, 0.0)), 0.01)
                push = p.pedestrian_force / p.pedestrian_force_range * np.exp(-b / p.pedestrian_force_range)
                push = push * (n1 + n2) / (4 * b) * (r / n1 + (r - s) / n2)
                e = wanted[i] / max(np.linalg.norm(wanted[i]), 1e-9)
                sees = e @ -push >= np.linalg.norm(push) * np.cos(p.view_angle / 2)
                force = force + push * (1.0 if sees else p.unseen_weight)
            corners = []
            for a, c in segments[i]:
                t = np.clip((here - a) @ (c - a) / ((c - a) @ (c - a)), 0, 1)
                q = a + t * (c - a)
                if any(np.allclose(q, corner, atol=1e-4) for corner in corners):
                    continue
                corners.append(q)
                d = np.linalg.norm(here - q)
                force = force + p.wall_force / p.wall_force_range * np.exp(-d / p.wall_force_range) * (here - q) / d
            velocity = velocity + h * force
            velocity = velocity * min(1.0, p.max_speed / np.linalg.norm(velocity))
            new[i] = [*(here + h * velocity), *velocity]
        people = new
    return people


CROSS = [  # of the scene called crosswalk, counter-clockwise
    (-1.3, -5), (1.3, -5), (1.3, -1.3), (5, -1.3), (5, 1.3), (1.3, 1.3), (1.3, 5), (-1.3, 5), (-1.3, 1.3), (-5, 1.3),
    (-5, -1.3), (-1.3, -1.3),
]  # fmt: skip


def minded(here, count=4):
    """The nearest walls of the crosswalk that face a point."""
    found = []
    for a, b in zip(np.array(CROSS), np.roll(CROSS, -1, axis=0), strict=True):
        (ex, ey), (px, py) = b - a, here - a
        if ex * py - ey * px > 0:
            t = np.clip((here - a) @ (b - a) / ((b - a) @ (b - a)), 0, 1)
            found.append((np.linalg.norm(here - a - t * (b - a)), a, b))
    return [(a, b) for _, a, b in sorted(found, key=lambda wall: wall[0])[:count]]


@pytest.fixture(scope="module")
def step(walk_in):
    """A step of five pedestrians in the crosswalk, worlds at once."""
    world = World(WorldConfig(scenes=("crosswalk",), pedestrians=5))

    def one(state, params):
        return walk_in(world.walls(0), state, world.config, params, SocialForce())

    return jax.jit(jax.vmap(one, in_axes=(0, None)))


PEOPLE = Params(awareness=2.0, neighbor_distance=3.0, preferred_speed=1.0, max_speed=1.3)


def crowds(situation, count, seed=0):
    """States `[count]` of five pedestrians and a robot around the crossing; the last isn't there, some ignore it."""
    rng = np.random.default_rng(seed)
    states = []
    for _ in range(count):
        at = rng.uniform(-1.1, 1.1, (6, 2)) + rng.choice([0.0, 2.0, -2.0], (6, 1)) * rng.permutation([1, 0])
        state = situation(
            robot=(*at[5], rng.uniform(-3, 3)), twist=(0.5, 0.0), is_open=rng.random(5) < 0.5, pedestrian_first=True,
            pedestrians=np.append(at[:5], rng.uniform(-6, 6, (5, 2)), axis=1), message=1, message_age=9, speed=0.9,
            x=at[:5, 0], y=at[:5, 1], ux=1.0,
        )  # fmt: skip
        people = state.pedestrians.replace(present=np.arange(5) < 4)
        states.append(state.replace(pedestrians=people))
    return jax.tree.map(lambda *leaves: np.stack(leaves), *states)


def test_crowds_walk_as_in_numpy(step, situation, full):
    """Steps of random worlds, to 0.1 mm in 98 % of them; in the others somebody is at an ellipse's end, or a limit."""
    count = 200 if full else 20
    states = crowds(situation, count)
    intends = jax.jit(jax.vmap(intend, in_axes=(0, 0, 0, None)))
    moved, errors = [], []
    for _ in range(5):
        before = states.pedestrians
        walked = jax.tree.map(np.asarray, step(states, PEOPLE))
        intentions = intends(before, states.encounters, states.traits, PEOPLE)
        wanted = np.stack([intentions.vx, intentions.vy], axis=-1)
        for w in range(count):
            people = np.stack([before.x[w], before.y[w], before.vx[w], before.vy[w]], axis=-1).astype(float)
            robot = jax.tree.map(lambda leaf, w=w: leaf[w], states.robot)
            robot = robot.x, robot.y, robot.v * np.cos(robot.heading), robot.v * np.sin(robot.heading)
            segments = [minded(here) for here in people[:, :2]]
            there = independent(
                people, robot, wanted[w], intentions.ignores_robot[w], segments, before.present[w], PEOPLE
            )
            ours = np.stack([walked.x[w], walked.y[w], walked.vx[w], walked.vy[w]], axis=-1)
            errors.append(np.abs(ours[:4] - there[:4]).max(axis=0))
            moved.append(np.abs(ours[:4, 2:] - wanted[w][:4]).max())
        states = states.replace(pedestrians=walked)
    assert np.all(np.quantile(errors, 0.98, axis=0) < [1e-4, 1e-4, 1e-3, 1e-3])
    assert np.max(errors) < 0.05
    assert np.mean(np.array(moved) > 0.1) > 0.5  # most are pushed


def test_sixteen_substeps_are_enough(walk_in, situation):
    """Within 2.5 cm of 128 of them in nine of ten steps; forces at an ellipse's ends are singular."""
    world = World(WorldConfig(scenes=("crosswalk",), pedestrians=5))

    @jax.jit
    @jax.vmap
    def both(state):
        few, many = (walk_in(world.walls(0), state, world.config, PEOPLE, SocialForce(n)) for n in (16, 128))
        return jnp.hypot(few.x - many.x, few.y - many.y)

    apart = np.asarray(both(crowds(situation, 100, seed=1)))[:, :4]
    assert np.quantile(apart, 0.9) < 0.025


def test_gradients_are_finite_and_by_parameters_those_of_finite_differences(walk_in, situation):
    world = World(WorldConfig(scenes=("crosswalk",), pedestrians=5))

    def end(params, state):
        walked = walk_in(world.walls(0), state, world.config, params, SocialForce())
        return jnp.sum(walked.x[:4] + walked.y[:4])

    states = crowds(situation, 10, seed=2)
    params = jax.tree.map(jnp.float32, PEOPLE)
    gradients = jax.jit(jax.vmap(jax.grad(end), in_axes=(None, 0)))(params, states)
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(gradients))
    values = jax.jit(jax.vmap(end, in_axes=(None, 0)))
    for name in ("relaxation_time", "pedestrian_force", "wall_force", "wall_force_range"):
        h = 0.002 * getattr(params, name)
        up, down = (values(params.replace(**{name: getattr(params, name) + s * h}), states) for s in (1, -1))
        near = np.isclose((up - down) / (2 * h), getattr(gradients, name), rtol=0.05, atol=5e-3)
        assert near.mean() >= 0.7, (name, near.mean())  # elsewhere somebody crosses a limit of view or distance


@pytest.mark.parametrize(
    ("ignores", "awareness", "pushed"), [(False, 1.5, True), (True, 1.5, False), (False, 0.5, False)]
)
def test_the_robot_repels_within_awareness_unless_they_are_committed(
    walk_in, situation, ignores, awareness, pushed
):  # fmt: skip
    world = World(WorldConfig(scenes=("square",)))
    state = situation(
        robot=(1.0, 0.05, 0.0), twist=(0.0, 0.0), pedestrians=[(0.0, 0.0, 4.0, 0.0)], is_open=True, ux=1.0, message=1,
        pedestrian_first=True, message_age=9 if ignores else 0,
    )  # fmt: skip
    params = Params(awareness=awareness)
    walked = walk_in(world.walls(0), state, world.config, params, SocialForce())
    assert (walked.vx[0] < 0.49) == pushed
