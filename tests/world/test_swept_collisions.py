"""Swept contacts and distances against plain sub-stepping of the true arc, in float64 and without the world's code."""

import itertools

import jax
import numpy as np

from jaxnav.world import Action, Params

FULL, EVERYDAY = 10_000, 500
SUBSTEPS = 1000
PARAMS = Params()
# Two chords leave the arc by 2.7 mm at full speed and turn; in a sub-step nothing moves by more than 0.5 mm.
MARGIN = 3.3e-3


def test_contacts_and_distances_of_a_step_are_those_of_a_thousand_sub_steps(default, full):
    rng = np.random.default_rng(0)
    total = FULL if full else EVERYDAY
    walls = [_edges(scene.chains) for scene in default.world.scenes]
    kinds = dict.fromkeys(("arrived", "hit_pedestrian", "hit_wall", "nothing", "grazing"), 0)
    played = 0
    while played < total:
        scenes = rng.integers(0, len(walls), 2048, np.int32)  # as many episodes as `steps` is compiled for
        before = jax.device_get(default.resets(jax.random.split(jax.random.key(played), 2048), PARAMS, scenes))
        before = _about_to_touch(before, [walls[scene] for scene in scenes], rng)
        twist = np.clip(rng.uniform((-1.0, -1.5), (2.0, 1.5), (2048, 2)), -1.0, 1.0).astype(np.float32)
        action = Action(twist=twist, request=np.zeros(2048, np.int32))
        after, outcome = jax.device_get(
            default.steps(jax.random.split(jax.random.key(0), 2048), before, action, PARAMS)
        )
        for i in range(min(2048, total - played)):
            to_goal, to_wall, to_person = _clearances(i, before, after, twist[i], walls[scenes[i]])
            assert abs(outcome.pedestrian_distance[i] - to_person.min()) < MARGIN
            # Every event a little earlier or later than it should be, in all combinations.
            margins = itertools.product((-MARGIN, MARGIN), repeat=3)
            possible = {_event(to_goal - a, to_wall - b, to_person - c) for a, b, c in margins}
            found = "arrived" if outcome.arrived[i] else "hit_pedestrian" if outcome.hit_pedestrian[i] else "nothing"
            found = "hit_wall" if outcome.collided[i] and not outcome.hit_pedestrian[i] else found
            assert found in possible
            kinds[found if len(possible) == 1 else "grazing"] += 1
        played += min(2048, total - played)
    assert kinds["grazing"] < 0.05 * total, kinds
    assert min(kinds[kind] for kind in ("arrived", "hit_pedestrian", "hit_wall", "nothing")) > 0.05 * total, kinds


def _edges(chains):
    """`[edges, 4]` ax, ay, bx, by of closed chains of vertices."""
    return np.array([(*a, *b) for chain in chains for a, b in itertools.pairwise([*chain, chain[0]])], float)


def _about_to_touch(states, walls, rng):
    """The states with robots moved beside walls, people and goals moved beside robots: each half of the time."""
    count = len(walls)
    moved = rng.random((3, count)) < 0.5

    def near(x, y, least, most):
        bearing, distance = rng.uniform(-np.pi, np.pi, count), rng.uniform(least, most, count)
        return x + distance * np.cos(bearing), y + distance * np.sin(bearing)

    ax, ay, bx, by = np.array([edges[rng.integers(len(edges))] for edges in walls]).T
    along, off = rng.uniform(0.1, 0.9, count), rng.uniform(0.2, 0.35, count) / np.hypot(bx - ax, by - ay)
    beside = ax + along * (bx - ax) - off * (by - ay), ay + along * (by - ay) + off * (bx - ax)
    robot, people = states.robot, states.pedestrians
    x, y = np.where(moved[0], beside, (robot.x, robot.y))
    goal_x, goal_y = np.where(moved[1], near(x, y, 0.25, 0.6), (robot.goal_x, robot.goal_y))
    person = np.where(moved[2], near(x, y, 0.25, 0.5), (people.x[:, 0], people.y[:, 0]))
    pose = {"x": x, "y": y, "heading": rng.uniform(-np.pi, np.pi, count), "goal_x": goal_x, "goal_y": goal_y}
    pace = dict(zip(("x", "y", "vx", "vy"), [*person, *rng.uniform(-0.6, 0.6, (2, count))], strict=True))
    return states.replace(
        robot=robot.replace(**{name: np.float32(value) for name, value in pose.items()}),
        pedestrians=people.replace(**{name: np.float32(value)[:, None] for name, value in pace.items()}),
    )


def _clearances(i, before, after, twist, edges):
    """How far episode i's robot is from arriving, from the nearest wall and from the person, `[SUBSTEPS + 1]` each."""
    share = np.linspace(0.0, 1.0, SUBSTEPS + 1)
    robot = before.robot
    v, w = 0.5 * PARAMS.max_v * (float(twist[0]) + 1.0), PARAMS.max_w * float(twist[1])
    heading = robot.heading[i] + w * PARAMS.dt * share
    middle = 0.5 * (heading[1:] + heading[:-1])
    x, y = (
        start[i] + np.append(0.0, np.cumsum(v * PARAMS.dt / SUBSTEPS * turn(middle)))
        for start, turn in ((robot.x, np.cos), (robot.y, np.sin))
    )
    to_goal = np.hypot(x - robot.goal_x[i], y - robot.goal_y[i]) - PARAMS.goal_tolerance
    (ax, ay, bx, by), x, y = edges.T, x[:, None], y[:, None]
    s = ((x - ax) * (bx - ax) + (y - ay) * (by - ay)) / ((bx - ax) ** 2 + (by - ay) ** 2)
    s = np.clip(s, 0.0, 1.0)
    to_wall = np.hypot(ax + s * (bx - ax) - x, ay + s * (by - ay) - y).min(axis=1) - PARAMS.robot_radius
    start, end = before.pedestrians, after.pedestrians
    walk_x = start.x[i, 0] + share * (end.x[i, 0] - start.x[i, 0])
    walk_y = start.y[i, 0] + share * (end.y[i, 0] - start.y[i, 0])
    to_person = np.hypot(x[:, 0] - walk_x, y[:, 0] - walk_y) - PARAMS.robot_radius - PARAMS.body_radius
    return to_goal, to_wall, to_person


def _event(to_goal, to_wall, to_person):
    """What happens first; a contact together with the arrival is a contact, with a person rather than with a wall."""
    goal, wall, person = (
        np.argmax(gaps <= 0) if np.any(gaps <= 0) else np.inf for gaps in (to_goal, to_wall, to_person)
    )
    if min(goal, wall, person) == np.inf:
        return "nothing"
    if min(wall, person) > goal:
        return "arrived"
    return "hit_pedestrian" if person <= wall else "hit_wall"
