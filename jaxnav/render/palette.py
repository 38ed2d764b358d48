"""Colours, safe for the colour-blind (Okabe and Ito 2008), the same in every frame and figure."""

from collections.abc import Sequence

from ..world import SCENES

ROBOT = "#0072B2"
PEDESTRIAN = "#D55E00"
GOAL = "#009E73"
LASER = "#56B4E9"
ENCOUNTER = "#CC79A7"
COLLISION = "#C1121F"
WALL = "#3C3F45"
FLOOR = "#FFFFFF"
OUTSIDE = "#ECEEF1"
INK = "#22252A"
FAINT_INK = "#6B7078"

ENDINGS = {"arrived": GOAL, "collision": COLLISION, "time out": "#9A6700"}

_SCENES = (
    "#0072B2", "#E69F00", "#009E73", "#CC79A7", "#D55E00", "#56B4E9", "#6B7078", "#8C564B", "#332288", "#999933",
    "#44AA99", "#882255",
)  # fmt: skip


def scene_colours(names: Sequence[str]) -> dict[str, str]:
    """Colours by scene name. A registered scene always has the same one; other scenes take the remaining ones."""
    order = [*SCENES, *(name for name in names if name not in SCENES)]
    return {name: _SCENES[order.index(name) % len(_SCENES)] for name in names}


def rgb(colour: str) -> tuple[int, ...]:
    """(red, green, blue) in 0-255 of "#RRGGBB"."""
    return tuple(int(colour[i : i + 2], 16) for i in (1, 3, 5))
