"""The animation of episodes: frames in one GIF with one palette."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image

from ..training.rollout import Episode
from ..world import Params, World
from .frames import draw_frame, scan_episode

_SPEED_UP = 2.0  # against the robot's own time
_HOLD = 1000  # milliseconds for which the last frame of an episode stays
_PALETTE_SIZE = 256


def animate(world: World, params: Params, episodes: Sequence[Episode], path: str | Path) -> None:
    """Write a GIF of `Episode` s, one after the other, at twice real time.

    One palette serves all frames, so that nothing flickers. ValueError: no episodes.
    """
    if not episodes:
        raise ValueError("episodes is empty: give at least one to animate")
    scans = [scan_episode(world, params, episode) for episode in episodes]
    lengths = [len(episode.states.t) for episode in episodes]

    def frame(i: int, t: int) -> np.ndarray:
        return draw_frame(world, params, episodes[i], t, scans=scans[i])

    samples = [frame(i, t) for i, n in enumerate(lengths) for t in sorted({0, n // 3, 2 * n // 3, n - 1})]
    indexed = _Palette(samples)
    images, durations = [], []
    period = round(100 * params.dt / _SPEED_UP) * 10  # GIF counts in hundredths of a second
    for i, n in enumerate(lengths):
        images += [indexed(frame(i, t)) for t in range(n)]
        durations += [period] * (n - 1) + [_HOLD]
    images[0].save(Path(path), format="GIF", save_all=True, append_images=images[1:], duration=durations, loop=0)


class _Palette:
    """The most frequent colours of some frames. Flat areas keep their colours exactly, edges take the nearest ones.

    Pillow's own ``quantize`` finds the nearest only roughly: white paper turns grey.
    """

    def __init__(self, frames: Sequence[np.ndarray]) -> None:
        packed, counts = np.unique(np.concatenate([self._pack(frame).ravel() for frame in frames]), return_counts=True)
        self._colours = self._unpack(packed[np.argsort(-counts, kind="stable")[:_PALETTE_SIZE]])
        self._index = np.full(2**24, -1, np.int16)  # of every colour met so far

    def __call__(self, frame: np.ndarray) -> Image.Image:
        """The frame `[H, W, 3]` as a palette image."""
        packed = self._pack(frame)
        new = np.unique(packed[self._index[packed] < 0])
        if len(new):
            distance = ((self._unpack(new)[:, None].astype(np.int32) - self._colours) ** 2).sum(axis=-1)
            self._index[new] = distance.argmin(axis=1)
        image = Image.fromarray(self._index[packed].astype(np.uint8))
        image.putpalette(self._colours.tobytes())
        return image

    @staticmethod
    def _pack(frame: np.ndarray) -> np.ndarray:
        return frame @ np.array([65536, 256, 1], np.int32)

    @staticmethod
    def _unpack(packed: np.ndarray) -> np.ndarray:
        return np.stack([packed >> 16, packed >> 8 & 255, packed & 255], axis=-1).astype(np.uint8)
