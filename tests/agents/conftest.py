"""Observations and batches of them that no world has made."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxnav.agents.learner import Batch
from jaxnav.world import Observation
from jaxnav.world.types import ObservedDialogue

BEAMS, PEOPLE = 14, 2  # sectors of the scan are of one beam and of two


def blank_observation(may_request=True, shape=()):
    """An `Observation` of zeros: a bandit's only state."""
    people = (*shape, PEOPLE)
    fields = ("is_open", "pedestrian_first", "message", "message_age", "request", "request_age", "reply")
    return Observation(
        pose=jnp.zeros((*shape, 3, 3)),
        twist=jnp.zeros((*shape, 2)),
        may_request=jnp.full(shape, may_request),
        scan=jnp.zeros((*shape, BEAMS)),
        pedestrians=jnp.zeros((*people, 4)),
        seen=jnp.zeros(people, bool),
        dialogue=ObservedDialogue(
            utterance=jnp.zeros(people, jnp.uint32), **{name: jnp.zeros(people, jnp.int32) for name in fields}
        ),
    )


def random_observation(rng, shape=()):
    """An `Observation` `[*shape, ...]` of everything at once: people, some of them seen, who speak and are asked; and
    rows of nobody, which are zero."""
    people = (*shape, PEOPLE)
    below = {
        "is_open": 2, "pedestrian_first": 2, "message": 4, "message_age": 15, "request": 4, "request_age": 15,
        "reply": 3, "utterance": 2**32,
    }  # fmt: skip
    somebody, seen = rng.random(people) < 0.75, rng.random(people) < 0.7
    dialogue = {
        name: (somebody * rng.integers(0, end, people)).astype(np.uint32 if name == "utterance" else np.int32)
        for name, end in below.items()
    }
    pedestrians = rng.normal(size=(*people, 4)) * [2.0, 2.0, 0.5, 0.5]
    return Observation(
        pose=np.float32(rng.normal(size=(*shape, 3, 3)) * [3.0, 3.0, 1.0]),
        twist=np.float32(rng.uniform(-1.0, 1.0, (*shape, 2))),
        may_request=rng.random(shape) < 0.6,
        scan=np.float32(rng.uniform(0.1, 6.0, (*shape, BEAMS))),
        pedestrians=np.float32(pedestrians * (somebody & seen)[..., None]),
        seen=somebody & seen,
        dialogue=ObservedDialogue(**dialogue),
    )


def random_batch(rng, shape, requests=4, **given):
    """A `Batch` `[*shape, ...]` of nothing in particular; ``given`` fields instead of random ones."""
    observation = random_observation(rng, shape)
    ended = rng.random(shape) < 0.5
    batch = Batch(
        observation=observation,
        next_observation=random_observation(rng, shape),
        twist=np.float32(np.tanh(rng.normal(size=(*shape, 2)))),
        request=np.where(observation.may_request, rng.integers(0, requests, shape), 0).astype(np.int32),
        reward=np.float32(rng.normal(size=shape)),
        terminated=ended & (rng.random(shape) < 0.5),
        ended=ended,
        steps=np.ones(shape, np.int32),
    )
    return batch.replace(**given)


@pytest.fixture(scope="session", name="blank_observation")
def _blank_observation():
    return blank_observation


@pytest.fixture(scope="session", name="random_observation")
def _random_observation():
    return random_observation


@pytest.fixture(scope="session", name="random_batch")
def _random_batch():
    return random_batch
