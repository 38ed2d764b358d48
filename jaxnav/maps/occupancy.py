"""Occupancy maps in the format of ROS map_server: a yaml file that describes an image."""

import dataclasses
import math
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml

FREE, OCCUPIED, UNKNOWN = range(3)
MODES = ("trinary", "scale", "raw")
_FARTHEST = 10_000.0  # m, of an origin


@dataclasses.dataclass(frozen=True, eq=False)
class OccupancyMap:
    """An occupancy grid of a building.

    cells:      `[rows, columns]` uint8 of FREE, OCCUPIED, UNKNOWN; row 0 has the lowest y (the image's last row).
    resolution: side of a cell, m.
    origin:     (x, y, yaw) of the outer corner of cell (0, 0) in the world; rows and columns are turned by yaw.
    """

    cells: np.ndarray
    resolution: float
    origin: tuple[float, float, float]

    def to_world(self, points: np.ndarray) -> np.ndarray:
        """World coordinates of ``points`` `[..., 2]`: (column, row) in cells from the outer corner of cell (0, 0)."""
        x, y, yaw = self.origin
        cos, sin = np.cos(yaw), np.sin(yaw)
        return (x, y) + self.resolution * np.asarray(points) @ np.array([[cos, sin], [-sin, cos]])

    def to_cells(self, points: np.ndarray) -> np.ndarray:
        """(column, row) in cells of world ``points`` `[..., 2]`: the inverse of `to_world`."""
        x, y, yaw = self.origin
        cos, sin = np.cos(yaw), np.sin(yaw)
        return (np.asarray(points) - (x, y)) @ np.array([[cos, -sin], [sin, cos]]) / self.resolution


def read(path: str | Path) -> OccupancyMap:
    """The map that a yaml file describes; its fields mean what they mean to map_server (wiki.ros.org/map_server).

    ValueError: a file is missing or unreadable, a field is missing or wrong, or the image's pixels are no bytes, for
    which the thresholds are meant. It names the file, the field and the remedy.
    """
    path = Path(path)
    fields = _read_yaml(path)
    resolution = _number(path, fields, "resolution")
    if resolution <= 0:
        raise ValueError(f"map {path}: resolution is {resolution}: give the metres of a pixel, above 0")
    free_thresh, occupied_thresh = (_number(path, fields, name) for name in ("free_thresh", "occupied_thresh"))
    if not 0 <= free_thresh < occupied_thresh <= 1:
        raise ValueError(
            f"map {path}: free_thresh is {free_thresh} and occupied_thresh {occupied_thresh}: "
            "give 0 <= free_thresh < occupied_thresh <= 1"
        )
    negate = _field(path, fields, "negate")
    if negate not in (0, 1):
        raise ValueError(f"map {path}: negate is {negate!r}: give 0 or 1")
    mode = fields.get("mode", "trinary")
    if mode not in MODES:
        raise ValueError(f"map {path}: mode is {mode!r}: choose from {', '.join(MODES)}")
    image = _read_image(path, fields)
    cells = _classify(image, bool(negate), free_thresh, occupied_thresh, mode)
    return OccupancyMap(cells=cells[::-1], resolution=resolution, origin=_origin(path, fields))


def _classify(image: np.ndarray, negate: bool, free_thresh: float, occupied_thresh: float, mode: str) -> np.ndarray:
    """FREE, OCCUPIED or UNKNOWN for every pixel of an image `[rows, columns]` or `[rows, columns, channels]`.

    Shades between the thresholds, a gradient in mode scale, are UNKNOWN. In mode raw a pixel is the percentage itself,
    and unknown above 100.
    """
    channels = np.atleast_3d(image).astype(np.float64)
    transparent = np.zeros(image.shape[:2], bool)
    # Mode trinary averages alpha in with the colours, as map_server always has.
    if channels.shape[2] == 4 and mode != "trinary":
        transparent = channels[..., 3] < 255
        channels = channels[..., :3]
    shade = channels.mean(axis=2)
    if mode == "raw":
        occupancy, unknown = shade / 100.0, shade > 100
    else:
        occupancy = (shade if negate else 255.0 - shade) / 255.0
        unknown = transparent
    cells = np.where(occupancy > occupied_thresh, OCCUPIED, np.where(occupancy < free_thresh, FREE, UNKNOWN))
    return np.where(unknown, UNKNOWN, cells).astype(np.uint8)


def _read_yaml(path: Path) -> dict[str, Any]:
    try:
        fields = yaml.safe_load(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise ValueError(f"map {path} is missing: give the path of a map's yaml file") from None
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        reason = str(error).splitlines()[0]
        raise ValueError(f"map {path} can't be read ({reason}): give the yaml file of a ROS map_server map") from None
    if not isinstance(fields, dict):
        raise ValueError(f"map {path} holds no fields: give the yaml file of a ROS map_server map")
    return fields


def _read_image(path: Path, fields: dict[str, Any]) -> np.ndarray:
    name = _field(path, fields, "image")
    if not isinstance(name, str) or not name:
        raise ValueError(f"map {path}: image is {name!r}: give the path of the map's image")
    file = path.parent / name
    if not file.is_file():
        raise ValueError(f"map {path}: image {file} is missing: put it there or correct the field image")
    level = cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)  # the error below says it
    try:
        image = cv2.imread(str(file), cv2.IMREAD_UNCHANGED)
    except cv2.error:  # larger than OpenCV takes
        image = None
    finally:
        cv2.utils.logging.setLogLevel(level)
    if image is None:
        raise ValueError(f"map {path}: image {file} can't be read: save it as pgm or png")
    if image.dtype != np.uint8:
        raise ValueError(
            f"map {path}: image {file} has {8 * image.itemsize} bits a channel, but free_thresh and occupied_thresh "
            "are for 8: save it with 8"
        )
    return image


def _field(path: Path, fields: dict[str, Any], name: str) -> Any:
    if name not in fields:
        raise ValueError(f"map {path} has no field {name}: add it, as ROS map_server requires")
    return fields[name]


def _number(path: Path, fields: dict[str, Any], name: str) -> float:
    return _finite(path, name, _field(path, fields, name))


def _origin(path: Path, fields: dict[str, Any]) -> tuple[float, float, float]:
    origin = _field(path, fields, "origin")
    if not isinstance(origin, list) or len(origin) != 3:
        raise ValueError(f"map {path}: origin is {origin!r}: give [x, y, yaw], metres and radians")
    x, y, yaw = (_finite(path, "origin", value) for value in origin)
    if max(abs(x), abs(y)) > _FARTHEST:
        raise ValueError(
            f"map {path}: origin is {origin!r}, farther than {_FARTHEST / 1000:g} km: the world is in single "
            "precision, which can't tell millimetres apart there; give an origin near 0"
        )
    return x, y, yaw


def _finite(path: Path, name: str, value: Any) -> float:
    try:
        # PyYAML takes 5e-2, without a decimal point, for a string; map_server for a number.
        number = math.nan if isinstance(value, bool) else float(value)
    except (TypeError, ValueError, OverflowError):
        number = math.nan
    if not math.isfinite(number):
        raise ValueError(f"map {path}: {name} is {value!r}: give a finite number")
    return number
