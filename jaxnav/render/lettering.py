"""Text for OpenCV pictures in a legible typeface: OpenCV's own are strokes."""

import functools
from pathlib import Path

import matplotlib
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from .palette import rgb


def write(
    canvas: np.ndarray, text: str, column: float, row: float, size: int, colour: str, bold: bool = False,
    anchor: str = "l",
) -> int:  # fmt: skip
    """Write a line of text into a uint8 `[H, W, 3]` canvas, its middle at ``row``; return its width in pixels.

    colour: "#RRGGBB"; anchor: "l" starts at ``column``, "m" is centred there. Text beyond the edge is cut.
    """
    mask = _mask(text, size, bold)
    height, width = mask.shape
    left = round(column - width / 2 if anchor == "m" else column)
    top = round(row - height / 2)
    x0, y0 = max(left, 0), max(top, 0)
    x1, y1 = min(left + width, canvas.shape[1]), min(top + height, canvas.shape[0])
    if x0 < x1 and y0 < y1:
        alpha = mask[y0 - top : y1 - top, x0 - left : x1 - left, None]
        patch = canvas[y0:y1, x0:x1]
        patch[:] = np.rint(patch + alpha * (np.array(rgb(colour), np.float32) - patch))
    return width


def text_width(text: str, size: int, bold: bool = False) -> int:
    """Width in pixels of a line of text."""
    return _mask(text, size, bold).shape[1]


@functools.lru_cache(maxsize=512)
def _mask(text: str, size: int, bold: bool) -> np.ndarray:
    """Coverage `[height, width]` in [0, 1] of a line of text; lines of one size have one height."""
    font = _font(size, bold)
    ascent, descent = font.getmetrics()
    image = Image.new("L", (max(1, round(font.getlength(text))), ascent + descent))
    ImageDraw.Draw(image).text((0, 0), text, font=font, fill=255)
    return np.asarray(image, np.float32) / 255.0


@functools.lru_cache(maxsize=32)
def _font(size: int, bold: bool) -> ImageFont.FreeTypeFont:
    # matplotlib carries this one wherever it is installed.
    name = "DejaVuSans-Bold.ttf" if bold else "DejaVuSans.ttf"
    return ImageFont.truetype(str(Path(matplotlib.get_data_path(), "fonts", "ttf", name)), size)
