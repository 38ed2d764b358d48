"""Frames of an episode, drawn with OpenCV."""

import dataclasses
import functools
from collections.abc import Sequence
from typing import Any

import cv2
import jax
import numpy as np

from ..training.rollout import Episode
from ..world import Params, Scene, World, lidar
from . import palette
from .lettering import text_width, write
from .words import captions, ending, scene_title

SIZE = (640, 560)  # pixels: width, height
_SHIFT = 4  # fractional bits of OpenCV's coordinates: anti-aliased shapes move by a sixteenth of a pixel
_MARGIN = 0.25  # metres around the outermost walls
_BAND = 0.155  # height of the caption band as a share of the frame's


@dataclasses.dataclass(frozen=True)
class View:
    """The place of a scene in a frame: ``scale`` pixels a metre; (left, top) is the pixel of (x, y) = (0, 0)."""

    scale: float
    left: float
    top: float

    @classmethod
    def of(cls, scene: Scene, size: tuple[int, int] = SIZE) -> "View":
        """The view that fits a `Scene` above the caption band, centred; size: (width, height) of the frame."""
        corners = np.concatenate([np.array(chain) for chain in scene.chains])
        low, high = corners.min(axis=0) - _MARGIN, corners.max(axis=0) + _MARGIN
        width, height = size[0], size[1] - _band_height(size)
        scale = min(width / (high[0] - low[0]), height / (high[1] - low[1]))
        middle = (low + high) / 2
        return cls(float(scale), float(width / 2 - scale * middle[0]), float(height / 2 + scale * middle[1]))

    def pixels(self, x: Any, y: Any) -> np.ndarray:
        """World coordinates (any shape) -> pixel coordinates `[..., 2]` (column, row), float; y points up."""
        return np.stack([self.left + self.scale * np.asarray(x), self.top - self.scale * np.asarray(y)], axis=-1)


def scan_episode(world: World, params: Params, episode: Episode) -> np.ndarray | None:
    """The laser's ranges `[n + 1, B]` in every state of an `Episode`, None if the world has no scan."""
    if "scan" not in world.config.observation:
        return None
    return np.asarray(_scans(world, episode.states, params))


@functools.partial(jax.jit, static_argnums=0)
def _scans(world: World, states: Any, params: Params) -> Any:
    return jax.vmap(lambda state: world.observe(state, params).scan)(states)


def draw_frame(
    world: World,
    params: Params,
    episode: Episode,
    t: int,
    size: tuple[int, int] = SIZE,
    scans: np.ndarray | None = None,
) -> np.ndarray:
    """State ``t`` of an `Episode` as a picture: uint8 `[height, width, 3]`, RGB.

    size: (width, height) in pixels; scans: `scan_episode`'s result, to draw many frames of one episode.
    """
    if scans is None:
        scans = scan_episode(world, params, dataclasses.replace(episode, states=_one_state(episode, t)))
        scan = None if scans is None else scans[0]
    else:
        scan = scans[t]
    scene = world.scenes[world.config.scenes.index(episode.scene)]
    canvas = np.empty((size[1], size[0], 3), np.uint8)
    canvas[:] = palette.rgb(palette.OUTSIDE)
    pen = _Pen(canvas, View.of(scene, size))
    chains = [np.array(chain) for chain in scene.chains]
    pen.fill([pen.view.pixels(*chain.T) for chain in chains], palette.FLOOR)
    ends = None if scan is None else _scan_ends(episode.states.robot, t, scan)
    if ends is not None:
        fan = np.concatenate([ends, [[episode.states.robot.x[t], episode.states.robot.y[t]]]])
        pen.fill([pen.view.pixels(*fan.T)], palette.LASER, alpha=0.16)
    for chain in chains:
        x, y = np.append(chain, chain[:1], axis=0).T
        pen.path(x, y, palette.WALL, 2.5)
    if scan is not None and ends is not None:
        x, y = ends[scan < params.scan_range].T
        pen.dots(x, y, palette.LASER, 1.2)
    _draw_goal(pen, episode.states.robot, t, params)
    _draw_agents(pen, episode, t, params)
    _draw_band(canvas, world, episode, t, params)
    return canvas


class _Pen:
    """Draws on a canvas in world coordinates, anti-aliased. Lengths are metres, widths of lines pixels at `SIZE`."""

    def __init__(self, canvas: np.ndarray, view: View) -> None:
        self.canvas, self.view = canvas, view
        self._stroke = canvas.shape[1] / SIZE[0]

    def _width(self, width: float) -> int:
        return max(1, round(width * self._stroke))

    def fill(self, polygons: Sequence[np.ndarray], colour: str, alpha: float = 1.0) -> None:
        """Fill polygons given in pixels, by the even-odd rule, so that pillars stay solid."""
        target = self.canvas if alpha == 1.0 else self.canvas.copy()
        cv2.fillPoly(target, [_fixed(polygon) for polygon in polygons], palette.rgb(colour), cv2.LINE_AA, _SHIFT)
        if alpha < 1.0:
            cv2.addWeighted(target, alpha, self.canvas, 1.0 - alpha, 0.0, dst=self.canvas)

    def path(self, x: Any, y: Any, colour: str, width: float) -> None:
        points = _fixed(self.view.pixels(x, y))
        cv2.polylines(self.canvas, [points], False, palette.rgb(colour), self._width(width), cv2.LINE_AA, _SHIFT)

    def arrow(self, x: Any, y: Any, dx: Any, dy: Any, colour: str, width: float) -> None:
        start, end = self.view.pixels([x, x + dx], [y, y + dy])
        length = np.hypot(*(end - start))
        if length < 1.0:
            return
        tip = min(0.5, 6.0 * self._stroke / length)
        tail, head = _fixed(start).tolist(), _fixed(end).tolist()
        cv2.arrowedLine(self.canvas, tail, head, palette.rgb(colour), self._width(width), cv2.LINE_AA, _SHIFT, tip)

    def disc(self, x: Any, y: Any, radius: Any, colour: str, width: float | None = None) -> None:
        """A disc, or a circle where a line width is given."""
        centre = tuple(map(int, _fixed(self.view.pixels(x, y))))
        thickness = cv2.FILLED if width is None else self._width(width)
        radius = round(radius * self.view.scale * 2**_SHIFT)
        cv2.circle(self.canvas, centre, radius, palette.rgb(colour), thickness, cv2.LINE_AA, _SHIFT)

    def dots(self, x: Any, y: Any, colour: str, radius: float) -> None:
        """Many small discs; radius in pixels at `SIZE`."""
        channels, radius = palette.rgb(colour), max(1, round(radius * self._stroke * 2**_SHIFT))
        for centre in _fixed(self.view.pixels(x, y)).tolist():
            cv2.circle(self.canvas, centre, radius, channels, cv2.FILLED, cv2.LINE_AA, _SHIFT)


def _draw_goal(pen: _Pen, robot: Any, t: int, params: Params) -> None:
    x, y = robot.goal_x[t], robot.goal_y[t]
    pen.disc(x, y, params.goal_tolerance, _tint(palette.GOAL, 0.22))
    pen.disc(x, y, params.goal_tolerance, palette.GOAL, 1)
    pen.fill([pen.view.pixels(*_star(x, y, 0.6 * params.goal_tolerance))], palette.GOAL)


def _scan_ends(robot: Any, t: int, scan: np.ndarray) -> np.ndarray:
    """End points `[B, 2]` of the beams in the world."""
    beam_x, beam_y = lidar.beam_directions(len(scan))
    cos, sin = np.cos(robot.heading[t]), np.sin(robot.heading[t])
    x = robot.x[t] + scan * (cos * beam_x - sin * beam_y)
    return np.stack([x, robot.y[t] + scan * (sin * beam_x + cos * beam_y)], axis=-1)


def _draw_agents(pen: _Pen, episode: Episode, t: int, params: Params) -> None:
    robot, walkers, encounters = episode.states.robot, episode.states.pedestrians, episode.states.encounters
    there = np.flatnonzero(walkers.present[t]).tolist()
    for i in there:
        since = episode.since(t, i)
        pen.path(walkers.x[since : t + 1, i], walkers.y[since : t + 1, i], _tint(palette.PEDESTRIAN, 0.5), 2)
    pen.path(robot.x[: t + 1], robot.y[: t + 1], _tint(palette.ROBOT, 0.5), 2)
    x, y, heading = robot.x[t], robot.y[t], robot.heading[t]
    for i in np.flatnonzero(encounters.is_open[t]):
        pen.path([x, walkers.x[t, i]], [y, walkers.y[t, i]], palette.ENCOUNTER, 1.5)
    rim = 1.5 / pen.view.scale
    pen.disc(x, y, params.robot_radius + rim, palette.FLOOR)
    pen.disc(x, y, params.robot_radius, palette.ROBOT)
    reach = params.robot_radius * np.array([0.25, 0.9])
    pen.path(x + reach * np.cos(heading), y + reach * np.sin(heading), palette.FLOOR, 2)
    # On top of the robot: in a collision the smaller disc would vanish beneath it.
    for i in there:
        px, py = walkers.x[t, i], walkers.y[t, i]
        pen.arrow(px, py, walkers.vx[t, i], walkers.vy[t, i], palette.PEDESTRIAN, 2)
        pen.disc(px, py, params.body_radius + rim, palette.FLOOR)
        pen.disc(px, py, params.body_radius, palette.PEDESTRIAN)
    if len(episode.present) > 1:
        size = _font_size(pen.canvas, 11)
        for i in there:
            # Beside the pedestrian, on the side that it walks away from.
            column, row = pen.view.pixels(walkers.x[t, i], walkers.y[t, i])
            gap = params.body_radius * pen.view.scale + 0.75 * size
            away = -1.0 if walkers.vx[t, i] > 0 else 1.0
            write(pen.canvas, str(i + 1), column + away * gap, row, size, palette.PEDESTRIAN, bold=True, anchor="m")
    if t == len(episode.outcomes.arrived) and ending(episode) == "collision":
        pen.disc(x, y, 2.2 * params.robot_radius, palette.COLLISION, 3)


def _draw_band(canvas: np.ndarray, world: World, episode: Episode, t: int, params: Params) -> None:
    height, width = canvas.shape[:2]
    band = _band_height((width, height))
    top = height - band
    canvas[top:] = 255
    canvas[top : top + max(1, round(height / 560))] = palette.rgb("#C9CDD3")
    unit = band / 87.0
    left, rows = 14 * width / SIZE[0], [top + unit * row for row in (19, 45, 69)]
    size = _font_size(canvas, 14)
    column = left + write(canvas, scene_title(episode.scene), left, rows[0], size, palette.INK, bold=True) + size
    column += write(canvas, f"{t * params.dt:.1f} s", column, rows[0], size, palette.FAINT_INK)
    # A place of its own where there is room, so that it doesn't depend on the width of the digits.
    column = max(column + size, left + 12.5 * size)
    end = ending(episode)
    if end and t == len(episode.outcomes.arrived):
        write(canvas, end.upper(), column, rows[0], size, palette.ENDINGS[end], bold=True)
    _draw_legend(canvas, width - left, rows[0], _font_size(canvas, 12))
    inks = {"robot": palette.ROBOT, "pedestrian": "#A84600", "": palette.FAINT_INK}
    size = _font_size(canvas, 16)
    for row, (speaker, sentence) in zip(rows[1:], captions(episode, t, world.config.hearing), strict=False):
        room = width - 2 * left
        fitting = min(size, int(size * room / text_width(sentence, size)))
        write(canvas, sentence, left, row, fitting, inks[speaker])


def _draw_legend(canvas: np.ndarray, right: float, row: float, size: int) -> None:
    for name, colour in (("goal", palette.GOAL), ("pedestrian", palette.PEDESTRIAN), ("robot", palette.ROBOT)):
        right -= text_width(name, size)
        write(canvas, name, right, row, size, palette.FAINT_INK)
        right -= 0.8 * size
        if name == "goal":
            star = np.stack(_star(right, -row, 0.48 * size), axis=-1) * (1, -1)
            cv2.fillPoly(canvas, [_fixed(star)], palette.rgb(colour), cv2.LINE_AA, _SHIFT)
        else:
            centre = tuple(map(int, _fixed(np.array([right, row]))))
            radius = round((0.4 if name == "robot" else 0.3) * size * 2**_SHIFT)
            cv2.circle(canvas, centre, radius, palette.rgb(colour), cv2.FILLED, cv2.LINE_AA, _SHIFT)
        right -= 1.3 * size


def _font_size(canvas: np.ndarray, pixels: float) -> int:
    """Font size for a canvas, from the size at `SIZE`."""
    return max(6, round(pixels * min(canvas.shape[1] / SIZE[0], canvas.shape[0] / SIZE[1])))


def _band_height(size: tuple[int, int]) -> int:
    return round(_BAND * size[1])


def _one_state(episode: Episode, t: int) -> Any:
    return jax.tree.map(lambda leaf: leaf[t : t + 1], episode.states)


def _star(x: float, y: float, radius: float) -> tuple[np.ndarray, np.ndarray]:
    """Ten corners of a star that stands upright."""
    angles = np.pi / 2 + np.arange(10) * np.pi / 5
    reach = radius * np.where(np.arange(10) % 2, 0.42, 1.0)
    return x + reach * np.cos(angles), y + reach * np.sin(angles)


def _fixed(points: Any) -> np.ndarray:
    """Pixel coordinates as the fixed-point numbers OpenCV draws with; pixel centres are whole numbers there."""
    return np.rint((np.asarray(points, np.float64) - 0.5) * 2**_SHIFT).astype(np.int32)


def _tint(colour: str, strength: float) -> str:
    """``colour`` mixed with white."""
    channels = [round(255 + strength * (channel - 255)) for channel in palette.rgb(colour)]
    return "#{:02X}{:02X}{:02X}".format(*channels)
