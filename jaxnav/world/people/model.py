"""How people move: the Protocol that every model of pedestrians fulfils."""

import inspect
from collections.abc import Callable, Sequence
from typing import Any, Protocol

import jax
from flax import struct

from ..config import WorldConfig
from ..params import Params
from ..scenes import Scene
from ..types import Encounter, Pedestrian, PedestrianTraits, Robot, Walls
from .intention import Intention, intend, turn


@struct.dataclass
class Surroundings:
    """The surroundings of pedestrians.

    robot: where it is at the step's beginning, and how fast; walls: of the scene; t: int32, steps taken so far; seed:
    uint32 of the episode, for randomness: ``jax.random.fold_in(jax.random.key(seed), t)`` is a key of this step.
    """

    robot: Robot
    walls: Walls
    t: jax.Array
    seed: jax.Array


class PedestrianModel(Protocol):
    """How pedestrians move. Inherit from it, write ``step``, and the other parts have a default.

    All but `prepare` are pure functions of one episode, run under ``jit`` and ``vmap``. Whatever a model is made of
    stays constant; numbers that are to differ from one episode to the next are fields of `Params`.

    talks: whether its people take part in dialogue. Of those who don't encounters open all the same, as a robot sees
    no difference, but they never speak first and never answer.
    """

    talks: bool = True

    def prepare(self, config: WorldConfig, scenes: Sequence[Scene]) -> "PedestrianModel":
        """This model for worlds of that config, called once when a `World` is made. ValueError: it doesn't fit them."""
        del config, scenes
        return self

    def start(
        self, pedestrians: Pedestrian, surroundings: Surroundings, config: WorldConfig, params: Params
    ) -> tuple[Pedestrian, Any]:
        """(pedestrians `[P]` of a new episode, memory): those that the scene has placed, by default.

        memory: whatever the model has to remember, a pytree of arrays of fixed shapes; None where it is nothing.
        """
        del surroundings, config, params
        return pedestrians, None

    def step(
        self, pedestrians: Pedestrian, memory: Any, intentions: Intention, surroundings: Surroundings,
        config: WorldConfig, params: Params,
    ) -> tuple[Pedestrian, Any]:  # fmt: skip
        """(pedestrians `[P]` a ``params.dt`` later, memory): new x, y, vx, vy and, if people come and go, present.

        intentions: `Intention` `[P]`, the velocity that each wants. Who isn't ``present`` is to count for nobody; what
        its other fields say then doesn't matter. Whether a way point is passed (``turned``) is found out afterwards.
        """
        ...


_HOOKS = {
    "step": ("pedestrians", "memory", "intentions", "surroundings", "config", "params"),
    "start": ("pedestrians", "surroundings", "config", "params"),
    "prepare": ("config", "scenes"),
}


def check_model(model: Any) -> None:
    """Raise ValueError where ``model`` lacks a part of `PedestrianModel`, or one that takes other arguments."""
    # An address in memory tells nobody anything.
    value = f"world.people is {f'a {type(model).__name__}' if type(model).__repr__ is object.__repr__ else repr(model)}"
    if inspect.isclass(model):
        raise ValueError(f"{value}: give an object, {model.__name__}(), not its class")
    for name, arguments in _HOOKS.items():
        hook, wanted = getattr(model, name, None), f"{name}({', '.join(arguments)})"
        if not callable(hook) or (name == "step" and getattr(type(model), name, None) is PedestrianModel.step):
            raise ValueError(f"{value}: it has no {name}: give it {wanted}, or inherit from PedestrianModel")
        try:
            inspect.signature(hook).bind(*arguments)
        except TypeError:
            raise ValueError(f"{value}: its {name} takes {inspect.signature(hook)}: let it take {wanted}") from None
    if not isinstance(getattr(model, "talks", None), bool):
        raise ValueError(f"{value}: its talks is {getattr(model, 'talks', None)!r}: give True or False")


def advance(
    model: PedestrianModel, pedestrians: Pedestrian, memory: Any, encounters: Encounter, traits: PedestrianTraits,
    surroundings: Surroundings, config: WorldConfig, params: Params,
) -> tuple[Pedestrian, Any]:  # fmt: skip
    """(pedestrians `[P]`, memory) after a step: what they intend, carried out by ``model``."""
    intentions = intend(pedestrians, encounters, traits, params)
    pedestrians, memory = model.step(pedestrians, memory, intentions, surroundings, config, params)
    return turn(pedestrians), memory


def check_step(model: PedestrianModel, reset: Callable, walls: Callable, config: WorldConfig, params: Params) -> None:
    """ValueError: ``model`` raises, or its step returns something else than pedestrians and memory like those given.

    reset: (key, params) -> `State`; walls: index of a scene -> `Walls`. Nothing is computed, shapes are.
    """

    def step(key):
        state = reset(key, params)
        before, t = (state.pedestrians, state.people_memory), state.t
        surroundings = Surroundings(robot=state.robot, walls=walls(state.scene), t=t, seed=state.seed)
        after = advance(model, *before, state.encounters, state.traits, surroundings, config, params)
        return before, after

    value = f"world.people is a {type(model).__name__}"
    try:
        given, returned = jax.eval_shape(step, jax.random.key(0))
    except Exception as error:
        text = str(error).partition("\n")[0]
        raise ValueError(
            f"{value}, which raises {type(error).__name__} ({text}): let its step return (pedestrians, memory)"
        ) from error
    if given != returned:
        raise ValueError(
            f"{value}, whose step returns other shapes or types than it is given: let it return (pedestrians, memory) "
            "with fields of the same shapes and types"
        )
