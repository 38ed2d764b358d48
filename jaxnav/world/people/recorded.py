"""People who were recorded: they walk where they walked, whatever the robot does (docs/world.md section 7)."""

import dataclasses
from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np

from ..config import WorldConfig
from ..geometry import norm
from ..params import Params
from ..scenes import Scene
from ..types import Pedestrian
from ..walls import is_inside
from .intention import Intention
from .model import PedestrianModel, Surroundings
from .recording import ANNOTATION_PERIOD, Rows, Visit, read_recording, visits

_TRIES = 16  # start times that are drawn, of which the first is taken that leaves the robot room
_ROOM = 1.5  # from the robot to anybody at the start, m
_EPISODE = 100  # instants before the end of a recording in which no episode starts, if it is longer
_X, _Y, _VX, _VY, _GOAL_X, _GOAL_Y, _PRESENT = range(7)


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class Recorded(PedestrianModel):
    """People of a recording, in one of ETH's or UCY's formats. They don't see the robot, and never stop for it.

    An episode starts at a time of the recording that is drawn from its seed, with somebody there and nobody within
    1.5 m of the robot (or as far away as sixteen draws allow). People are ``present`` from the instant at which they
    enter to that at which they leave; between annotations they go straight and evenly, and so at any ``dt``. A world
    of P pedestrians holds P at once: whoever comes when all places are taken is left out, for all of its visit. An
    episode that outlasts the recording goes on without people.

    They take no part in dialogue: encounters open, as with anybody who comes near, but they never speak, and what they
    are asked they don't answer.

    rows: the recording; None for the file that ``world.recording`` names. table: `[T, P, 7]` x, y, vx, vy, where the
    visit ends (x, y), and whether it is there, at instants 0.4 s apart; starts: `[S]` those at which an episode may
    start. Both are made by `prepare`.
    """

    rows: Rows | None = None
    table: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros((0, 0, 7), np.float32))
    starts: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros(0, int))
    talks = False

    def __repr__(self):
        return "Recorded()"

    def prepare(self, config: WorldConfig, scenes: Sequence[Scene]) -> "Recorded":
        """This recording for P pedestrians; ValueError: no or no such file, or somebody walks outside of a scene."""
        if self.rows is None and not config.recording:
            raise ValueError("world.recording is empty: name the file of the recording that world.people asks for")
        rows = read_recording(config.recording) if self.rows is None else self.rows
        for scene in scenes:
            outside = ~is_inside(rows.x, rows.y, scene.chains)
            if outside.any():
                i = int(np.argmax(outside))
                raise ValueError(
                    f"world.scenes names {scene.name}, outside of whose walls somebody of the recording walks, at "
                    f"({rows.x[i]:.2f}, {rows.y[i]:.2f}): choose recording, or a scene of your own around it"
                )
        table = make_table(visits(rows), config.pedestrians)
        somebody = np.flatnonzero(table[:, :, _PRESENT].any(axis=1))
        early = somebody[somebody < len(table) - _EPISODE]
        return dataclasses.replace(self, rows=rows, table=table, starts=(early if len(early) else somebody))

    def start(
        self, pedestrians: Pedestrian, surroundings: Surroundings, config: WorldConfig, params: Params
    ) -> tuple[Pedestrian, jax.Array]:
        """(people at a time of the recording, its instant, float32)."""
        del config, params
        robot = surroundings.robot
        drawn = jax.random.randint(jax.random.key(surroundings.seed), (_TRIES,), 0, len(self.starts))
        instants = jnp.asarray(self.starts)[drawn]
        people = jnp.asarray(self.table)[instants]
        away = norm(people[..., _X] - robot.x, people[..., _Y] - robot.y)
        away = jnp.min(jnp.where(people[..., _PRESENT] > 0, away, jnp.inf), axis=1)
        instant = instants[jnp.argmax(jnp.minimum(away, _ROOM))].astype(jnp.float32)
        return self._at(instant, pedestrians), instant

    def step(
        self, pedestrians: Pedestrian, memory: jax.Array, intentions: Intention, surroundings: Surroundings,
        config: WorldConfig, params: Params,
    ) -> tuple[Pedestrian, jax.Array]:  # fmt: skip
        """(people a time of ``dt`` later, the start's instant): by the clock alone."""
        del intentions, config
        return self._at(memory + (surroundings.t + 1) * (params.dt / ANNOTATION_PERIOD), pedestrians), memory

    def _at(self, instant, pedestrians):
        """People at an instant, which may lie between two of the table."""
        last = len(self.table) - 1
        after = jnp.clip(jnp.ceil(instant - 1e-3), 0, last)
        before = jnp.maximum(after - 1, 0)
        share = jnp.clip(instant - before, 0.0, 1.0)
        share = jnp.where(share > 0.998, 1.0, share)
        late, early = (jnp.asarray(self.table)[row.astype(jnp.int32)] for row in (after, before))
        x, y = (late[:, i] - (1.0 - share) * (late[:, i] - early[:, i]) for i in (_X, _Y))
        there = (late[:, _PRESENT] > 0) & ((early[:, _PRESENT] > 0) | (share == 1.0)) & (instant <= last + 1e-3)
        goal_x, goal_y = late[:, _GOAL_X], late[:, _GOAL_Y]
        return pedestrians.replace(
            x=x, y=y, vx=late[:, _VX], vy=late[:, _VY], goal_x=goal_x, goal_y=goal_y, via_x=goal_x, via_y=goal_y,
            turned=jnp.ones_like(there), present=there,
        )  # fmt: skip


def make_table(people: list[Visit], places: int) -> np.ndarray:
    """`[T, places, 7]` float32, as `Recorded` says, of visits in the order in which they begin.

    A place that somebody has left stays empty for an instant at least, so that nobody turns into somebody else. Empty,
    it is where its next visitor will enter, or where its last one has left.
    """
    length = max(visit.first + len(visit.places) for visit in people)
    table = np.zeros((length, places, 7), np.float32)
    free_from = np.zeros(places, int)
    for first, way in people:
        place = int(np.argmax(free_from <= first))
        if free_from[place] > first:
            continue
        stop = first + len(way)
        steps = np.diff(way, axis=0) / ANNOTATION_PERIOD if len(way) > 1 else np.zeros((1, 2))
        rows = table[first:stop, place]
        rows[:, [_X, _Y]] = way
        # How it came here; one who has just come, how it goes on.
        rows[:, [_VX, _VY]] = steps[np.maximum(np.arange(len(way)) - 1, 0)]
        rows[:, [_GOAL_X, _GOAL_Y]], rows[:, _PRESENT] = way[-1], 1.0
        empty = table[max(free_from[place] - 1, 0) : first, place]
        empty[:, [_X, _Y]], empty[:, [_GOAL_X, _GOAL_Y]] = way[0], way[-1]
        table[stop:, place][:, [_X, _Y, _GOAL_X, _GOAL_Y]] = np.tile(way[-1], 2)
        free_from[place] = stop + 1
    return table
