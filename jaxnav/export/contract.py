"""The contract of a bundle: every input and output of a policy, and all that a robot needs to use it."""

import importlib.metadata
import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from ..agents.encoders import Encoder
from ..agents.learner import Learner
from ..agents.networks import Actor, LangPreNet
from ..agents.twin import TorchTwin
from ..errors import UserError
from ..language import dialogue_rules
from ..language.speaker import Context, sentences
from ..language.table import DIMENSIONS, default_table
from ..training.dataclass_json import to_json
from ..training.run import Run
from ..world import Params, sensing
from ..world.types import AGREES, MESSAGES, NONE, REFUSES, REPLIES, REQUESTS, STOP

SCHEMA = 1  # of contract.json; robot/bundle.py reads the same
TWIN = "twin"  # the module of a bundle that holds the twin of an encoder that is no part of this package

_PERIOD = "control.period"  # the unit of ages
_FAR = 1000.0  # m or rad: what is beyond it is a mistake
SQUASHES = ("tanh", "clip")  # how the mean of a twist comes into its range
RAW_PARTS = ("scan", "pedestrians", "dialogue")  # of an observation, of which all inputs are made
# Inputs by the fields of `ObservedDialogue`. "request" is the name of an output, and no input of ONNX may share it.
TALK = {
    "is_open": "is_open", "pedestrian_first": "pedestrian_first", "message_age": "message_age", "asked": "request",
    "request_age": "request_age", "reply": "reply",
}  # fmt: skip


def check_exportable(agent: Learner) -> None:
    """UserError: a policy of this learner can't be computed without JAX."""
    if not isinstance(getattr(agent, "actor_network", None), Actor) or getattr(agent, "squash", "") not in SQUASHES:
        raise UserError(
            f"a {type(agent).__name__} can't be exported: its learner needs an actor_network that is an Actor of "
            f"jaxnav.agents.networks, and a squash that is {' or '.join(SQUASHES)}"
        )
    if encoder_of(agent).twin is None:
        raise UserError(
            f"agent.encoder {encoder_of(agent).name!r} has no torch twin, so that its policies can't be exported: give "
            "its Encoder a TorchTwin"
        )


def twin_of(agent: Learner) -> TorchTwin:
    """The torch twin of an exportable learner's encoder."""
    twin = encoder_of(agent).twin
    assert twin is not None, "see check_exportable"
    return twin


def encoder_of(agent: Learner) -> Encoder:
    """The record of a learner's encoder."""
    return agent.config.encoding


def raw_inputs(run: Run) -> tuple[str, ...]:
    """Names of the inputs of `Policy.act` in robot/policy.py, in order."""
    words = ("words",) if run.agent.can_hear else ("message", "spoken")
    return ("scan", "pedestrians", "seen", *TALK, *words, "pose", "twist", "may_request", "voice")


def network_inputs(run: Run) -> tuple[str, ...]:
    """Names of the inputs of the network itself, in order: maps are made of scan and pedestrians."""
    reads = encoder_of(run.agent).reads
    left_out = {"scan", "pedestrians"} - set(reads)
    if "pedestrians" not in run.world.config.observation:
        left_out.add("seen")
    maps = ("maps",) if {"sensor_map", "pedestrian_map"} & set(reads) else ()
    return (*maps, *(name for name in raw_inputs(run) if name not in left_out))


def contract_of(run: Run, origin: Any) -> dict[str, Any]:
    """The contract as a dict for JSON, without `files` and `checksum`, which `seal` adds.

    origin: where the policy comes from, JSON of any kind.
    """
    params, config, agent = run.params, run.world.config, run.agent
    nearest = min(config.nearest, config.pedestrians)
    angles = [round(math.degrees(angle), 6) for angle in np.linspace(-np.pi / 2, np.pi / 2, config.beams)]
    return {
        "schema": SCHEMA,
        "about": "Inputs and outputs of the policy in weights.npz. Lengths are metres, times seconds, angles radians "
        "counter-clockwise unless an entry says otherwise. Robot frame: x forward, y left.",
        "inputs": [_INPUTS[name](run, nearest) | {"name": name} for name in raw_inputs(run)],
        "outputs": _outputs(params, agent.requests, nearest),
        "network": _network(run),
        "laser": {
            "beams": config.beams, "angle_min": -math.pi / 2, "angle_max": math.pi / 2,
            "range_max": float(params.scan_range), "angles_deg": angles, "order": "from right to left",
        },
        "control": {
            "period": float(params.dt), "max_v": float(params.max_v), "max_w": float(params.max_w),
            "goal_tolerance": float(params.goal_tolerance),
        },
        "robot": {"radius": float(params.robot_radius)},
        "people": {"nearest": nearest, "radius": float(params.body_radius), "trained_with": config.pedestrians},
        "encounter": {
            "distance": float(params.encounter_distance), "clearance": float(params.encounter_clearance),
            "horizon": float(params.encounter_horizon),
        },
        # How far ahead the safety layer looks: one period and the way of braking; and which gap it keeps.
        "safety": {"deceleration": 1.5, "gap": 0.015, "gap_at_full_speed": 0.03, "timeout": 0.5},
        "dialogue": dict(dialogue_rules.RULES),
        "requests": [{"request": request, "name": REQUESTS[request]} for request in range(agent.requests)],
        "hearing": config.hearing,
        "messages": list(MESSAGES),
        "replies": list(REPLIES),
        "sentences": _sentences(),
        "language": _language() if agent.can_hear else None,
        "origin": origin,
    }  # fmt: skip


def origin_of(run: Run, policy: str, stored: dict[str, Any], evaluation: Any) -> dict[str, Any]:
    """The origin of a policy. policy: last or best; stored: the run's config.json; evaluation: its evaluation."""
    return {
        "run": run.folder.name, "policy": policy, "exported_by": f"jaxnav {importlib.metadata.version('jaxnav')}",
        "config": to_json(run.config) | {"out": run.folder.name},
        **{name: stored[name] for name in ("versions", "git_commit", "device") if name in stored},
        "evaluation": evaluation,
    }  # fmt: skip


def _entry(
    shape: Sequence[int], dtype: str, unit: str, low: float, high: float, meaning: str, frame: str = "none",
    order: str = "none",
) -> dict[str, Any]:  # fmt: skip
    return {
        "shape": list(shape), "dtype": dtype, "unit": unit, "frame": frame, "order": order, "range": [low, high],
        "meaning": meaning,
    }  # fmt: skip


def _each(dtype: str, low: float, high: float, meaning: str, unit: str = "1") -> Callable[[Run, int], dict[str, Any]]:
    """An input with one number for each observed person."""
    return lambda run, nearest: _entry([nearest], dtype, unit, low, high, meaning, order="people, nearest first")


_INPUTS = {
    "scan": lambda run, _: _entry(
        [run.world.config.beams], "float32", "m", 0.0, float(run.params.scan_range),
        "Ranges at the angles laser.angles_deg; the largest of the range where nothing is hit.",
        "robot: from its centre", "right (-90 degrees), ahead, left (90 degrees)",
    ),
    "pedestrians": lambda run, nearest: _entry(
        [nearest, 4], "float32", "m, m, m/s, m/s", -_FAR, _FAR,
        "x, y, velocity x, velocity y of the nearest people. Velocities are over ground: the robot's own is not "
        "subtracted. Rows of nobody, and of people out of sight, are 0.",
        "robot", "people, nearest first",
    ),
    "seen": _each("bool", 0, 1, "Whether there is such a person, and in sight."),
    "is_open": _each("bool", 0, 1, "Whether a dialogue with that person is open."),
    "pedestrian_first": _each("bool", 0, 1, "Whether that person spoke first in it."),
    "message_age": _each("int32", 0, 1_000_000, "Periods since the person spoke, 0 where it did not.", _PERIOD),
    "asked": _each("int32", 0, 3, "The request that the robot asked of that person, 0 none."),
    "request_age": _each("int32", 0, 1_000_000, "Periods since it asked, 0 where it did not.", _PERIOD),
    "reply": _each("int32", 0, 2, "The answer: an index into replies."),
    "words": lambda run, nearest: _entry(
        [nearest, DIMENSIONS + 1], "float32", "1", -10.0, 10.0,
        "The sentence of each person, as a vector of phrasebook.py; 0 for silence.", order="people, nearest first",
    ),
    "message": _each("int32", 0, 3, "The message of each person: an index into messages."),
    "spoken": _each("bool", 0, 1, "Whether that person says anything, small talk included."),
    "pose": lambda run, _: _entry(
        [3, 3], "float32", "m, m, rad", -_FAR, _FAR,
        "Goal x, goal y, and how far the robot has turned to the right since its start; 0 for times before the start.",
        "robot, as it was at that time", "two periods ago, one period ago, now",
    ),
    "twist": lambda run, _: _entry(
        [2], "float32", "m/s, rad/s", -10.0, 10.0, "The robot's own v and w of the last period.", "robot"
    ),
    "may_request": lambda run, _: _entry(
        [], "bool", "1", 0, 1, "Whether a dialogue is open in which the person did not speak first and the robot has "
        "not asked yet."
    ),
    "voice": lambda run, _: _entry(
        [], "bool", "1", 0, 1, "Whether a request may be spoken now: once in a period. Without it the request is none."
    ),
}  # fmt: skip


def _outputs(params: Params, requests: int, nearest: int) -> list[dict[str, Any]]:
    def output(
        name: str, shape: Sequence[int], unit: str, low: float, high: float, meaning: str, frame: str = "none",
        order: str = "none",
    ) -> dict[str, Any]:  # fmt: skip
        dtype = "int64" if name == "request" else "float32"
        return {"name": name, **_entry(shape, dtype, unit, low, high, meaning, frame, order)}

    turn = float(params.max_w)
    return [
        output("v", [], "m/s", 0.0, float(params.max_v), "Speed forward.", "robot"),
        output("w", [], "rad/s", -turn, turn, "Turning rate, positive to the left.", "robot"),
        output("request", [], "1", 0, requests - 1, "Asked of the nearest person who may be asked: see requests."),
        output("log_p", [requests], "1", -2e9, 0.0, "Log-probabilities of the requests.", order="requests"),
        output("heard", [nearest, 3], "1", 0.0, 1.0, "Probabilities that a person asks the robot to stop, to go to the "
               "robot's right, to go to its left."),
        output("answer", [nearest, 3], "1", 0.0, 1.0, "Probabilities of what a person answers: see replies."),
    ]  # fmt: skip


def _network(run: Run) -> dict[str, Any]:
    """Sizes of `Actor` in robot/network.py."""
    agent: Any = run.agent
    config, encoder, twin = agent.config, encoder_of(agent), twin_of(agent)
    nearest = min(run.world.config.nearest, run.world.config.pedestrians)
    sizes = {
        "encoder": encoder.name, "encoder_module": TWIN if twin.source else "encoders",
        "encoder_class": twin.module, "encoder_widths": encoder.sizes(config.encoder_widths),
        "inputs": list(network_inputs(run)), "beams": run.world.config.beams, "nearest": nearest, "cells": sensing.GRID,
        "widths": list(config.actor_widths), "requests": agent.requests, "request_kinds": len(REQUESTS),
        "twists": agent.requests if agent.actor_network.per_request else 1, "squash": agent.squash,
        "max_v": float(run.params.max_v), "max_w": float(run.params.max_w),
    }  # fmt: skip
    if agent.can_hear:
        sizes |= {"dimensions": DIMENSIONS + 1, "listener_width": LangPreNet.width}
    return sizes


def _sentences() -> dict[str, Any]:
    """The robot's sentences. request, acknowledge: by request or message; reply: by reply; repeat: unsure."""
    requests, messages = (list(enumerate(names))[1:] for names in (REQUESTS, MESSAGES))
    return {
        "request": {name: sentences(Context(request)) for request, name in requests},
        "acknowledge": {name: sentences(Context(message, "pedestrian")) for message, name in messages},
        "reply": {REPLIES[reply]: sentences(Context(STOP, "robot", reply)) for reply in (AGREES, REFUSES)},
        "repeat": sentences(Context(NONE, "nobody")),
    }


def _language() -> dict[str, Any]:
    table = default_table()
    return {
        "dimensions": DIMENSIONS + 1, "sentence_encoder": table.encoder,
        "sentence_encoder_sha256": table.encoder_hash, "features": len(table.projection.centre),
        "phrases": len(table.phrases), "fingerprint": table.fingerprint,
    }  # fmt: skip
