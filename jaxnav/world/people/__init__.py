"""People: what they intend, and how they move. `PedestrianModel` is what to write for people who move otherwise."""

from ..config import WorldConfig
from .intention import Intention, intend
from .model import PedestrianModel, Surroundings, advance, check_model, check_step
from .orca_people import OrcaPeople
from .recorded import Recorded
from .recording import RECORDING, Rows, Visit, read_recording, recording_scene, visits
from .social_force import SocialForce

PEDESTRIAN_MODELS: dict[str, PedestrianModel] = {
    "orca": OrcaPeople(),
    "social-force": SocialForce(),
    "recorded": Recorded(),
}

BUILT_IN_PEOPLE = frozenset(PEDESTRIAN_MODELS)

__all__ = [
    "BUILT_IN_PEOPLE",
    "PEDESTRIAN_MODELS",
    "RECORDING",
    "Intention",
    "OrcaPeople",
    "PedestrianModel",
    "Recorded",
    "Rows",
    "SocialForce",
    "Surroundings",
    "Visit",
    "advance",
    "check_model",
    "check_step",
    "choose_people",
    "intend",
    "read_recording",
    "recording_scene",
    "register_people",
    "visits",
]


def register_people(name: str, model: PedestrianModel) -> None:
    """Let ``world.people`` name a model. ValueError: the name is taken, or ``model`` lacks a part of the Protocol."""
    if name in PEDESTRIAN_MODELS:
        raise ValueError(f"people {name!r} are registered already: give another name")
    check_model(model)
    PEDESTRIAN_MODELS[name] = model


def choose_people(config: WorldConfig) -> PedestrianModel:
    """The model that ``config.people`` names; ValueError: there is none."""
    if config.people not in PEDESTRIAN_MODELS:
        known = ", ".join(sorted(PEDESTRIAN_MODELS))
        raise ValueError(f"world.people is {config.people!r}: choose {known} or file.py:NAME")
    return PEDESTRIAN_MODELS[config.people]
