"""Models of pedestrians as the world takes them: by name or given, checked, and remembered for."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxnav.world import PEDESTRIAN_MODELS, Action, Params, PedestrianModel, World, WorldConfig, register_people
from jaxnav.world.people import OrcaPeople, SocialForce


class Ghosts(PedestrianModel):
    """They go as they wish, through everything, and every second step they aren't there; the memory counts steps."""

    def start(self, pedestrians, surroundings, config, params):
        return pedestrians, jnp.int32(10)

    def step(self, pedestrians, memory, intentions, surroundings, config, params):
        x, y = pedestrians.x + params.dt * intentions.vx, pedestrians.y + params.dt * intentions.vy
        there = jnp.broadcast_to(memory % 2 == 1, pedestrians.present.shape)
        return pedestrians.replace(x=x, y=y, vx=intentions.vx, vy=intentions.vy, present=there), memory + 1


def test_a_model_of_ones_own_by_name_and_given(monkeypatch):
    monkeypatch.delitem(PEDESTRIAN_MODELS, "ghosts", raising=False)
    register_people("ghosts", Ghosts())
    assert isinstance(World(WorldConfig(people="ghosts")).people, Ghosts)
    with pytest.raises(ValueError, match="'ghosts' are registered already"):
        register_people("ghosts", Ghosts())
    del PEDESTRIAN_MODELS["ghosts"]
    world = World(WorldConfig(scenes=("square",)), people=Ghosts())
    states = [world.reset(jax.random.key(0), Params())]
    step = jax.jit(world.step)
    for _ in range(3):
        action = Action(twist=jnp.array([-1.0, 0.0]), request=jnp.int32(0))
        state, outcome = step(jax.random.key(0), states[-1], action, Params())
        states.append(state)
        assert bool(jnp.isinf(outcome.pedestrian_distance)) == (not state.pedestrians.present[0])
    assert [int(state.people_memory) for state in states] == [10, 11, 12, 13]
    assert [bool(state.pedestrians.present[0]) for state in states] == [True, False, True, False]
    way = np.hypot(np.diff([s.pedestrians.x[0] for s in states]), np.diff([s.pedestrians.y[0] for s in states]))
    np.testing.assert_allclose(way, 0.2, atol=1e-5)


def lacking(**parts):
    return type("Lacking", (PedestrianModel,), parts)()


@pytest.mark.parametrize(
    ("model", "message"),
    [
        (object(), "it has no step: give it step\\(pedestrians, memory, intentions, surroundings, config, params\\)"),
        (lacking(), "it has no step"),
        (lacking(step=lambda self, pedestrians: pedestrians), "its step takes \\(pedestrians\\): let it take step"),
        (lacking(step=Ghosts.step, start=lambda self: None), "its start takes \\(\\): let it take start"),
        (lacking(step=Ghosts.step, talks=3), "its talks is 3: give True or False"),
        (OrcaPeople, "give an object, OrcaPeople\\(\\), not its class"),
    ],
)
def test_what_a_model_lacks_is_said_when_a_world_is_made(model, message):
    with pytest.raises(ValueError, match=f"world.people is .*{message}"):
        World(people=model)


@pytest.mark.parametrize(
    ("step", "message"),
    [
        (lambda self, *given: 3, r"raises TypeError \(cannot unpack .*let its step return \(pedestrians, memory\)"),
        (lambda self, people, *others: (people.replace(x=people.x[:0]), None), "returns other shapes or types"),
        (lambda self, people, *others: (people, people.x), "returns other shapes or types"),
    ],
)
def test_what_a_model_returns_wrongly_is_said_when_a_world_is_made(step, message):
    with pytest.raises(ValueError, match=f"world.people is a Lacking, .*{message}"):
        World(people=lacking(step=step))


def test_unknown_people():
    with pytest.raises(ValueError, match=r"is 'x': choose orca, recorded, social-force or file\.py:NAME"):
        World(WorldConfig(people="x"))
    with pytest.raises(ValueError, match="substeps is 0"):
        SocialForce(substeps=0)
