"""The sizes and switches of a world."""

import dataclasses

from ..fields import check, choice, choices, flag, other, part, text, whole

MAX_PEDESTRIANS = 64
OBSERVATION_PARTS = ("scan", "pedestrians", "dialogue", "sensor_map", "pedestrian_map")


def _names(value: object) -> bool:
    """Whether it is a tuple of one or more names, each once."""
    if not isinstance(value, tuple) or not all(isinstance(name, str) for name in value):
        return False
    return len(value) > 0 and len(set(value)) == len(value)


@dataclasses.dataclass(frozen=True)
class WorldConfig:
    """Sizes and switches of a world: static under ``jit`` and hashable. Every float that may vary is in `Params`.

    P is ``pedestrians``, B is ``beams``.
    """

    scenes: tuple[str, ...] = other(
        ("square", "hallway", "crosswalk"),
        holds=_names,
        allowed="a tuple of one or more names of scenes, each once",
        doc="scenes of which each episode draws one",
    )
    pedestrians: int = whole(
        1, low=1, high=MAX_PEDESTRIANS, doc="most pedestrians of an episode; the scene says how many of them are there"
    )
    nearest: int = whole(4, low=1, doc="most pedestrians that are observed, nearest first")
    beams: int = whole(180, low=2, doc="laser beams over [-pi/2, pi/2]")
    observation: tuple[str, ...] = choices(
        ("scan", "pedestrians", "dialogue"), OBSERVATION_PARTS, doc="parts to sense besides pose and twist"
    )
    scan_noise: bool = flag(False, doc="draw range noise and dropouts; off saves one random word a beam")
    hearing: bool = flag(
        True, doc="whether the robot hears; a deaf one observes silence although pedestrians commit all the same"
    )
    people: str = part("orca", ("orca", "social-force", "recorded"), doc="how pedestrians move")
    recording: str = text(
        "",
        allowed="the path of a file in the ETH or UCY format",
        doc="recording that recorded people replay, and around which the scene called recording is",
    )
    reward: str = part(
        "authors-code",
        ("authors-code", "paper-text"),
        doc="reward: as in the paper's code, or as in its text (all terms each step, closeness at arrival)",
    )
    swept_collisions: bool = flag(True, doc="test contact over the whole step; off tests the end of the step only")
    body: str = choice(
        "disc",
        ("disc", "legs"),
        doc="body of a pedestrian for the laser: a disc, or two legs that step, close together while it stands",
    )
    wall_neighbors: int = whole(4, low=1, doc="walls that a pedestrian avoids at once, nearest first")
    max_neighbors: int = whole(10, low=1, doc="other pedestrians that a pedestrian avoids at once, nearest first")
    scan_delay: int = whole(
        0, low=0, unit="steps", doc="largest scan_latency: so many past views are kept in the state and in snapshots"
    )
    control_delay: int = whole(
        0, low=0, unit="steps", doc="largest control_latency: so many past twists are kept in the state"
    )

    def __post_init__(self):
        check(self, "world")
