"""Recorded people: where they were, when they were there, whatever the robot does; and the scene around them."""

import os
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxnav.world import Action, Params, World, WorldConfig
from jaxnav.world.people import Recorded, Rows, read_recording, recording_scene, visits
from jaxnav.world.people.recorded import make_table
from jaxnav.world.people.recording import instants

# Number 1 walks to +x for 20 instants, 2 back from instant 5 to 9, and 3 stands from 12 on; a frame is 1/15 s.
WALKS = {1: (0, 20, (0.0, 0.0), (0.4, 0.0)), 2: (5, 5, (8.0, 1.0), (-0.4, 0.0)), 3: (12, 5, (4.0, 2.0), (0.0, 0.0))}


def rows_of(walks, period=6):
    rows = [
        (780 + period * (first + k), person, x + k * dx, y + k * dy)
        for person, (first, count, (x, y), (dx, dy)) in walks.items()
        for k in range(count)
    ]
    return Rows(*np.array(sorted(rows), float).T)


@pytest.fixture
def write(tmp_path):
    """A function (rows, columns) -> path of a file in the ETH format, or in that of four columns."""

    def to_file(rows, columns=8):
        lines = [
            (f, n, x, 0, y, 9, 0, 9) if columns == 8 else (f, n, x, y) for f, n, x, y in zip(*rows, strict=True)
        ]  # fmt: skip
        path = tmp_path / "recording.txt"
        path.write_text("\n".join(" ".join(map(str, line)) for line in lines), encoding="utf-8")
        return str(path)

    return to_file


@pytest.mark.parametrize("columns", [8, 4])
def test_both_formats_are_read(write, columns):
    rows = rows_of(WALKS)
    for ours, theirs in zip(read_recording(write(rows, columns)), rows, strict=True):
        np.testing.assert_allclose(ours, theirs)


def test_people_go_evenly_between_annotations_and_come_again_after_a_gap():
    """Every second annotation of 1 is missing; 2 is away for three periods."""
    rows = rows_of({1: (0, 9, (0.0, 0.0), (0.4, 0.1)), 2: (0, 9, (5.0, 0.0), (0.0, 0.4))})
    instant = (rows.frame - 780) / 6
    missing = ((rows.id == 1) & (instant % 2 == 1)) | ((rows.id == 2) & (instant > 3) & (instant < 6))
    one, two, again = visits(Rows(*(field[~missing] for field in rows)))
    np.testing.assert_allclose(one.places, np.arange(9)[:, None] * [0.4, 0.1], atol=1e-9)
    assert (two.first, len(two.places), again.first, len(again.places)) == (0, 4, 6, 3)


def test_whoever_finds_no_place_is_left_out_and_places_stay_empty_between_two():
    people = visits(rows_of(WALKS))
    table = make_table(people, 2)
    there = table[:, :, 6] > 0
    assert np.flatnonzero(there[:, 1]).tolist() == [5, 6, 7, 8, 9, 12, 13, 14, 15, 16]
    # Until it comes it is where it will enter, and afterwards where its next one will.
    np.testing.assert_allclose(table[:5, 1, :2], [[8.0, 1.0]] * 5)
    np.testing.assert_allclose(table[10:12, 1, :2], [[4.0, 2.0]] * 2)
    np.testing.assert_allclose(table[5:10, 1, 2:4], [[-1.0, 0.0]] * 5, atol=1e-6)
    assert make_table(people, 1).shape == (20, 1, 7)
    # Somebody who comes in the very instant after gets another place.
    close = visits(rows_of({1: (0, 3, (0.0, 0.0), (0.4, 0.0)), 2: (3, 3, (0.0, 1.0), (0.4, 0.0))}))
    assert make_table(close, 2)[:, :, 6].sum(axis=0).tolist() == [3.0, 3.0]
    assert make_table(close, 1)[:, :, 6].sum() == 3.0


@pytest.fixture(scope="module")
def world():
    rows = rows_of(WALKS)
    config = WorldConfig(scenes=("recording",), pedestrians=2, scan_delay=2, observation=("scan", "pedestrians"))
    return World(config, [recording_scene(rows)], people=Recorded(rows))


@pytest.fixture(scope="module")
def play(world):
    """States `[n + 1]`, outcomes `[n]` and observations `[n]` of the episode of a seed, the robot at a fixed place."""
    reset, step, observe = jax.jit(world.reset), jax.jit(world.step), jax.jit(world.observe)

    def episode(params, steps, place=None, request=0, start=0.0):
        state = reset(jax.random.key(3), params)
        if place is not None:
            people = world.people._at(jnp.float32(start), state.pedestrians)
            robot = state.robot.replace(x=jnp.float32(place[0]), y=jnp.float32(place[1]), heading=jnp.float32(0.0))
            state = state.replace(robot=robot, pedestrians=people, people_memory=jnp.float32(start))
        states, outcomes, seen = [state], [], []
        for _ in range(steps):
            action = Action(twist=jnp.array([-1.0, 0.0]), request=jnp.int32(request))
            state, outcome = step(jax.random.key(0), state, action, params)
            states.append(state)
            outcomes.append(outcome)
            seen.append(observe(state, params))
        return states, outcomes, seen

    return episode


@pytest.mark.parametrize("dt", [0.4, 0.2])
def test_they_are_where_they_were_and_come_and_go(play, dt):
    states, _, _ = play(Params(dt=dt), int(8 / dt), place=(-0.5, -0.8))
    time = dt * np.arange(len(states)) / 0.4
    x = np.array([state.pedestrians.x for state in states])
    there = np.array([state.pedestrians.present for state in states])
    np.testing.assert_array_equal(there[:, 0], time < 19.01)
    np.testing.assert_array_equal(there[:, 1], ((time > 4.99) & (time < 9.01)) | ((time > 11.99) & (time < 16.01)))
    np.testing.assert_allclose(x[there[:, 0], 0], 0.4 * time[there[:, 0]], atol=1e-4)
    now = (time > 4.99) & (time < 9.01)
    np.testing.assert_allclose(x[now, 1], 8.0 - 0.4 * (time[now] - 5), atol=1e-4)


def test_who_comes_is_touched_scanned_and_met_from_then_on(play):
    """The robot stands half a metre before the place at which number 2 enters at instant 5, and it walks over it."""
    params = Params(scan_latency=2.0)
    states, outcomes, seen = play(params, 11, place=(7.0, 1.0))
    nearest = np.array([outcome.pedestrian_distance for outcome in outcomes])
    first = 8.0 - 7.0 - 0.27
    np.testing.assert_allclose(nearest[4], first, atol=1e-5)  # it stands where it appears
    assert nearest[3] > 3.0  # before, only number 1
    assert [bool(outcome.collided) for outcome in outcomes[:8]] == [False] * 6 + [True] * 2
    # A scan that is two steps old shows nobody who wasn't there then, although it is seen now.
    ahead = np.array([observation.scan[90] for observation in seen])
    assert ahead[5] > 1.5 and ahead[6] == pytest.approx(0.9, abs=0.02)
    assert [bool(observation.seen.any()) for observation in seen[:6]] == [True] * 6
    met = np.array([state.encounters.met[1] for state in states])
    assert not met[:5].any() and met[5] and not met[10]  # gone, so may be met anew


def test_they_neither_speak_nor_answer(play):
    """Not even small talk, and the robot asks at every step."""
    states, outcomes, _ = play(Params(p_pedestrian_first=1.0, small_talk=1.0), 10, place=(2.5, 0.0), request=1)
    assert any(bool(state.encounters.is_open[0]) for state in states)
    assert max(int(outcome.requested) for outcome in outcomes) == 1
    assert max(int(outcome.reply) for outcome in outcomes) == 0
    for state in states:
        assert not state.encounters.message.any() and not state.encounters.utterance.any()


def test_the_episode_starts_at_a_time_of_its_seed_with_somebody_there_and_room_for_the_robot(world):
    params = Params()
    resets = jax.jit(jax.vmap(world.reset, in_axes=(0, None)))
    states = resets(jax.random.split(jax.random.key(1), 256), params)
    assert states.pedestrians.present.any(axis=1).all()
    assert len(np.unique(states.people_memory)) > 10
    away = np.hypot(states.pedestrians.x - states.robot.x[:, None], states.pedestrians.y - states.robot.y[:, None])
    assert np.mean(np.where(states.pedestrians.present, away, np.inf).min(axis=1) >= 1.5) > 0.95
    # Across the flow, which runs along x.
    along = np.abs([states.robot.goal_x - states.robot.x, states.robot.goal_y - states.robot.y])
    assert np.median(along[1] / along[0]) > 1.0
    floor = world.scenes[0].floors[0]
    assert np.all((states.robot.x > floor[0]) & (states.robot.x < floor[2]))


@pytest.mark.parametrize(
    ("config", "lines", "message"),
    [
        ({"people": "recorded"}, "", "world.recording is empty: name the file"),
        ({"people": "recorded", "recording": "gone.txt"}, "", "gone.txt: can't be read"),
        ({"people": "recorded"}, "1 2 3 4 5", "line 1 has 5 columns: give 8 or 4"),
        ({"people": "recorded"}, "1 2 3 x", "line 1 is not all numbers"),
        ({"people": "recorded"}, "1 2 3 4\n1 2 3 4", "id 2 stands twice in frame 1"),
        ({"people": "recorded"}, "1 1 30 4\n2 1 31 4", "world.scenes names square, outside of whose walls"),
    ],
)
def test_what_is_wrong_is_named(tmp_path, monkeypatch, config, lines, message):
    monkeypatch.chdir(tmp_path)
    if lines:
        Path("mine.txt").write_text(lines, encoding="utf-8")
        config = config | {"recording": "mine.txt"}
    with pytest.raises(ValueError, match=message):
        World(WorldConfig(scenes=("square",), **config))


@pytest.mark.skipif("JAXNAV_DATA" not in os.environ, reason="JAXNAV_DATA is not set")
def test_people_of_eth():
    """By name: of 360 people 27 are there at once at most, and 16 places hold 95 % of their time."""
    path = Path(os.environ["JAXNAV_DATA"]) / "eth_walking" / "seq_eth.obsmat.txt"
    config = WorldConfig(scenes=("recording",), pedestrians=32, people="recorded", recording=str(path))
    world = World(config)
    rows = read_recording(path)
    table = world.people.table
    assert table[:, :, 6].sum(axis=1).max() == 27
    at = instants(rows.frame)
    assert at.max() + 1 == len(table) and len(np.unique(at)) == len(np.unique(rows.frame))
    gap = np.hypot(table[at, :, 0] - rows.x[:, None], table[at, :, 1] - rows.y[:, None])
    assert np.where(table[at, :, 6] > 0, gap, np.inf).min(axis=1).max() < 1e-4
    few = make_table(visits(rows), 16)[:, :, 6].sum()
    assert few / table[:, :, 6].sum() == pytest.approx(0.946, abs=1e-3)
