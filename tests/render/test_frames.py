"""Frames show what the states say, where they say it; the animation keeps them all."""

import dataclasses

import numpy as np
import pytest
from PIL import Image

from jaxnav.render import palette
from jaxnav.render.animation import animate
from jaxnav.render.frames import SIZE, View, draw_frame, scan_episode
from jaxnav.render.words import utterances
from jaxnav.world import SCENES, World, WorldConfig

BAND = 0.155  # share of the height


def _at(frame, point):
    """Colour at a pixel coordinate."""
    column, row = np.floor(point).astype(int)
    return tuple(int(channel) for channel in frame[row, column])


def _count(picture, colour):
    return int((picture == palette.rgb(colour)).all(axis=-1).sum())


def _band(frame, rows=(0.0, 1.0)):
    """The caption band, or the part of it between two shares of its height."""
    height = round(BAND * frame.shape[0])
    top = frame.shape[0] - height
    return frame[top + round(rows[0] * height) : top + round(rows[1] * height)]


def _tail(robot, t, params):
    """A point of the robot's disc behind its centre, clear of the mark of its heading: x, y."""
    back = 0.4 * params.robot_radius
    return robot.x[t] - back * np.cos(robot.heading[t]), robot.y[t] - back * np.sin(robot.heading[t])


def _view(world, episode, size=SIZE):
    return View.of(world.scenes[world.config.scenes.index(episode.scene)], size)


@pytest.mark.parametrize("scene", SCENES.values(), ids=lambda scene: scene.name)
@pytest.mark.parametrize("size", [SIZE, (320, 280), (300, 600), (900, 300)])
def test_a_view_shows_all_walls_above_the_band_undistorted(scene, size):
    view = View.of(scene, size)
    pixels = np.concatenate([view.pixels(*np.array(chain).T) for chain in scene.chains])
    assert pixels.min() >= 0
    assert pixels[:, 0].max() <= size[0]
    assert pixels[:, 1].max() <= size[1] * (1 - BAND) + 1
    np.testing.assert_allclose(view.pixels(1.0, 0.0) - view.pixels(0.0, 0.0), [view.scale, 0.0], atol=1e-9)
    np.testing.assert_allclose(view.pixels(0.0, 1.0) - view.pixels(0.0, 0.0), [0.0, -view.scale], atol=1e-9)


def test_a_frame_is_rgb_of_the_size_asked_for(world, params, episodes):
    for size in (SIZE, (321, 279)):
        frame = draw_frame(world, params, episodes[0], 3, size=size)
        assert frame.shape == (size[1], size[0], 3)
        assert frame.dtype == np.uint8


def test_everything_is_drawn_where_the_state_says(world, params, episodes):
    for episode in (episodes[0], episodes[10]):
        view = _view(world, episode)
        robot, walkers = episode.states.robot, episode.states.pedestrians
        scans = scan_episode(world, params, episode)
        start = draw_frame(world, params, episode, 0, scans=scans)
        assert _at(start, view.pixels(robot.goal_x[0], robot.goal_y[0])) == palette.rgb(palette.GOAL)
        for t in range(0, len(robot.x) // 2, 2):
            frame = draw_frame(world, params, episode, t, scans=scans)
            assert _at(frame, view.pixels(*_tail(robot, t, params))) == palette.rgb(palette.ROBOT)
            ahead = 0.6 * params.robot_radius
            nose = view.pixels(
                robot.x[t] + ahead * np.cos(robot.heading[t]), robot.y[t] + ahead * np.sin(robot.heading[t])
            )
            assert min(_at(frame, nose)) > 200  # the white mark of its heading
            assert _at(frame, view.pixels(walkers.x[t, 0], walkers.y[t, 0])) == palette.rgb(palette.PEDESTRIAN)


def test_the_path_so_far_is_drawn_and_the_rest_is_not(params, find):
    silent = World(WorldConfig(scenes=("square", "hallway"), observation=()))
    episode = find(ending="arrived", speaker="robot")
    view, robot = _view(silent, episode), episode.states.robot
    t = len(robot.x) // 2
    frame = draw_frame(silent, params, episode, t)
    past = _at(frame, view.pixels(robot.x[2], robot.y[2]))
    assert past[2] > past[0] + 50  # a tint of the robot's blue
    assert _at(frame, view.pixels(robot.x[t + 4], robot.y[t + 4])) == palette.rgb(palette.FLOOR)


def test_the_scan_is_a_fan_that_ends_at_what_it_hits(world, params, episodes):
    episode, t = episodes[0], 0
    view, robot = _view(world, episode), episode.states.robot
    scans = scan_episode(world, params, episode)
    assert scans.shape == (len(robot.x), world.config.beams)
    frame = draw_frame(world, params, episode, t, scans=scans)
    heading, middle = robot.heading[t], world.config.beams // 2
    # The beam that looks where the robot does, from an even number of them: half a beam to the left.
    angle = heading + np.pi / (world.config.beams - 1) / 2
    reach = scans[t, middle]

    def colour(distance):
        return _at(frame, view.pixels(robot.x[t] + distance * np.cos(angle), robot.y[t] + distance * np.sin(angle)))

    paper = np.array(palette.rgb(palette.FLOOR))
    tint = np.rint(paper + 0.16 * (np.array(palette.rgb(palette.LASER)) - paper))
    np.testing.assert_allclose(colour(0.5 * reach), tint, atol=1)
    assert colour(-0.5) == palette.rgb(palette.FLOOR)  # behind the robot nothing is measured
    np.testing.assert_array_equal(draw_frame(world, params, episode, t), frame)


def test_a_world_without_a_scan_has_walls_but_no_fan(crowd, params):
    world, episodes = crowd
    assert scan_episode(world, params, episodes[0]) is None
    for episode in (episodes[0], episodes[-1]):
        frame, view = draw_frame(world, params, episode, 0), _view(world, episode)
        assert _count(frame, palette.LASER) == 0
        walls = world.walls(int(episode.states.scene[0]))
        for x, y in zip(walls.x, walls.y, strict=True):
            assert _at(frame, view.pixels(x, y)) == palette.rgb(palette.WALL)
            assert _at(frame, view.pixels(0.95 * x, 0.95 * y)) == palette.rgb(palette.FLOOR)
            assert _at(frame, view.pixels(1.04 * x, 1.04 * y)) == palette.rgb(palette.OUTSIDE)


def test_an_open_encounter_joins_the_two(world, params, find):
    episode = find(speaker="robot")
    view, states = _view(world, episode), episode.states
    opened = int(np.argmax(states.encounters.is_open[:, 0]))
    for t, joined in ((opened - 1, False), (opened, True)):
        between = view.pixels((states.robot.x[t] + states.pedestrians.x[t, 0]) / 2,
                              (states.robot.y[t] + states.pedestrians.y[t, 0]) / 2)  # fmt: skip
        colour = np.array(_at(draw_frame(world, params, episode, t), between), int)
        assert (np.abs(colour - palette.rgb(palette.ENCOUNTER)).max() < 40) == joined


@pytest.mark.parametrize(("speaker", "ink"), [("robot", palette.ROBOT), ("pedestrian", "#A84600")])
def test_the_caption_appears_with_the_words(world, params, find, speaker, ink):
    episode = find(speaker=speaker)
    spoken = next(said for said in utterances(episode) if said.speaker == speaker)
    before, after = (_band(draw_frame(world, params, episode, t), (0.35, 1.0)) for t in (spoken.t - 1, spoken.t))
    assert _count(before, ink) == 0
    assert _count(after, ink) > 80


def test_captions_keep_their_margin_however_small_the_frame(crowd, params):
    world, episodes = crowd
    asked = np.full_like(episodes[0].states.encounters.request, 1)
    encounters = episodes[0].states.encounters.replace(request=asked, reply=asked, request_age=asked)
    talkative = dataclasses.replace(episodes[0], states=episodes[0].states.replace(encounters=encounters))
    for size in (SIZE, (420, 560), (240, 210)):
        lines = _band(draw_frame(world, params, talkative, 1, size=size), (0.35, 1.0))
        assert (lines < 128).any(axis=(1, 2)).sum() > 8
        assert (lines[:, -4:] == 255).all()
        assert (lines[-1] == 255).all()


@pytest.mark.parametrize("end", ["arrived", "collision", "time out"])
def test_the_last_frame_tells_how_it_ended(world, params, find, end):
    episode = find(ending=end)
    last = len(episode.states.t) - 1
    ink = palette.ENDINGS[end]
    # Left of the legend, which has colours of its own.
    before, after = (_band(draw_frame(world, params, episode, t), (0.0, 0.35))[:, :400] for t in (last - 1, last))
    assert _count(before, ink) == 0
    assert _count(after, ink) > 50


def test_a_collision_is_ringed(world, params, find):
    episode = find(ending="collision")
    last = len(episode.states.t) - 1
    view, robot = _view(world, episode), episode.states.robot
    rim = view.pixels(robot.x[last], robot.y[last] - 2.2 * params.robot_radius)
    assert _at(draw_frame(world, params, episode, last), rim) == palette.rgb(palette.COLLISION)


def test_all_of_a_crowd_are_drawn(crowd, params):
    world, episodes = crowd
    for episode in episodes:
        view, walkers = _view(world, episode), episode.states.pedestrians
        frame = draw_frame(world, params, episode, 0)
        for x, y in zip(walkers.x[0], walkers.y[0], strict=True):
            column, row = np.floor(view.pixels(x, y)).astype(int)
            # Not all of the disc: another's number or rim may lie on it.
            assert _count(frame[row - 3 : row + 4, column - 3 : column + 4], palette.PEDESTRIAN) > 12


def test_the_animation_holds_every_state_at_twice_real_time(world, params, find, tmp_path):
    shown = [find(ending="collision"), find(ending="arrived", speaker="robot")]
    animate(world, params, shown, tmp_path / "episode.gif")
    lengths = [len(episode.states.t) for episode in shown]
    with Image.open(tmp_path / "episode.gif") as gif:
        assert gif.size == SIZE
        assert gif.n_frames == sum(lengths)
        assert gif.info["loop"] == 0
        durations, pictures = [], []
        for i in range(gif.n_frames):
            gif.seek(i)
            durations.append(gif.info["duration"])
            pictures.append(np.asarray(gif.convert("RGB")))
    assert durations == [*[200] * (lengths[0] - 1), 1000, *[200] * (lengths[1] - 1), 1000]
    t, second = 4, shown[1]
    drawn, kept = draw_frame(world, params, second, t), pictures[lengths[0] + t]
    robot = second.states.robot
    assert _at(kept, _view(world, second).pixels(*_tail(robot, t, params))) == palette.rgb(palette.ROBOT)
    error = np.abs(kept.astype(int) - drawn)
    assert error.mean() < 0.5
    assert (error.max(axis=-1) > 60).mean() < 1e-3
    assert (tmp_path / "episode.gif").stat().st_size < 2_000_000


def test_nothing_to_animate_is_an_error(world, params, tmp_path):
    with pytest.raises(ValueError, match="episodes is empty"):
        animate(world, params, [], tmp_path / "episode.gif")
