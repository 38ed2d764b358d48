"""Episodes recorded once for all tests of the pictures, with a robot that talks and heeds."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flax import struct

from jaxnav.agents.scripted import StraightLine
from jaxnav.render.words import ending as ending_of
from jaxnav.render.words import utterances
from jaxnav.training.rollout import record
from jaxnav.world import Action, Params, World, WorldConfig, dialogue


@struct.dataclass
class Talker:
    """Drives straight and asks for what fits; stands still while it is asked to stop."""

    def __call__(self, state, world, params):
        action = StraightLine()(state, world, params)
        encounters = state.encounters
        fitting = jax.vmap(dialogue.fitting_request, in_axes=(None, 0))(state.robot, state.pedestrians)
        stops = jnp.any(encounters.is_open & (encounters.message == 1))
        forward = jnp.where(stops, -1.0, action.twist[0])
        return Action(twist=action.twist.at[0].set(forward), request=fitting[jnp.argmin(encounters.distance)])


@pytest.fixture(scope="session")
def params():
    return Params(max_steps=28.0)


@pytest.fixture(scope="session")
def world():
    # Two scenes of four walls: with the crosswalk's twelve, recording takes twice as long to compile.
    return World(WorldConfig(scenes=("square", "hallway")))


@pytest.fixture(scope="session")
def episodes(world, params):
    """Ten episodes of each scene with one pedestrian, a list of `Episode`: arrivals, collisions and time-outs."""
    scenes = jnp.repeat(jnp.arange(2), 10)
    return record(world, params, Talker(), jax.random.split(jax.random.key(0), 20), scenes, int(params.max_steps))


@pytest.fixture(scope="session")
def crowd(episodes):
    """(World, list of `Episode`) with five pedestrians and no scan: the robot of one episode among those of five."""
    world = World(WorldConfig(scenes=("square", "hallway"), pedestrians=5, observation=("pedestrians", "dialogue")))
    crowded = []
    for first in (0, 5, 10, 15):
        group = episodes[first : first + 5]
        length = min(len(episode.states.t) for episode in group)

        def gather(*leaves, length=length):
            return np.concatenate([leaf[:length] for leaf in leaves], axis=1)

        fields = {
            name: jax.tree.map(gather, *(getattr(episode.states, name) for episode in group))
            for name in ("pedestrians", "traits", "encounters")
        }
        shortest = next(episode for episode in group if len(episode.states.t) == length)
        crowded.append(dataclasses.replace(shortest, states=shortest.states.replace(**fields)))
    return world, crowded


@pytest.fixture(scope="session")
def find(episodes):
    """find(ending=None, speaker=None): the first episode that ended so and in which that one spoke."""

    def search(ending=None, speaker=None):
        for episode in episodes:
            if ending in (None, ending_of(episode)) and (
                speaker is None or any(said.speaker == speaker for said in utterances(episode))
            ):
                return episode
        raise LookupError(f"no recorded episode with {ending}, {speaker}: choose another seed")

    return search
