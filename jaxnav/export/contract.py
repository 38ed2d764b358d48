"""The contract of a bundle: every input and output of a policy, and all that a robot has to know to use it."""

import importlib.metadata
import math

import numpy as np

from ..agents.encoders import ENCODERS, PARTS, SECTORS
from ..agents.hsac import HSAC
from ..agents.networks import LangPreNet
from ..agents.ppo import PPO
from ..language import dialogue_rules
from ..language.speaker import Context, sentences
from ..language.table import DIMENSIONS, default_table
from ..training.dataclass_json import to_json
from ..world import sensing
from ..world.types import AGREES, LEFT, MESSAGES, NONE, REFUSES, REPLIES, REQUESTS, RIGHT, STOP

SCHEMA = 1  # of contract.json; robot/policy.py reads the same

_PERIOD = "control.period"  # the unit of ages
_FAR = 1000.0  # m or rad: what is beyond it is a mistake
RAW_PARTS = ("scan", "pedestrians", "dialogue")  # of an observation, from which all that a policy reads is made
TALK = ("is_open", "pedestrian_first", "message_age", "request", "request_age", "reply")  # observed of a dialogue


def requests_of(agent):
    """How many requests the policy chooses from; 1: it is silent."""
    return agent.config.requests if isinstance(agent, HSAC) else 1


def hears_phrases(agent):
    """Whether it understands sentences, not only messages by name."""
    return agent.vocabulary("test") is not None


def raw_inputs(run):
    """Names of what `Policy.act` in robot/policy.py reads, in order."""
    words = ("words",) if hears_phrases(run.agent) else ("message", "spoken")
    return ("scan", "pedestrians", "seen", *TALK, *words, "pose", "twist", "may_request", "voice")


def network_inputs(run):
    """Names of what the network itself reads, in order: grid encoders have maps instead of scan and pedestrians."""
    if "scan" in PARTS[run.agent.config.encoder]:
        return raw_inputs(run)
    left_out = {"scan", "pedestrians"}
    if "pedestrians" not in run.world.config.observation:
        left_out.add("seen")
    return ("maps", *(name for name in raw_inputs(run) if name not in left_out))


def contract_of(run, origin):
    """The contract as a dict for JSON, but for what tells of the other files: `files` and `checksum`.

    origin: where the policy comes from, JSON of any kind.
    """
    params, config, agent = run.params, run.world.config, run.agent
    nearest = min(config.nearest, config.pedestrians)
    angles = [round(math.degrees(angle), 6) for angle in np.linspace(-np.pi / 2, np.pi / 2, config.beams)]
    return {
        "schema": SCHEMA,
        "about": "What the policy in weights.npz reads and does. Lengths are metres, times seconds, angles radians "
        "counter-clockwise unless an entry says otherwise. Robot frame: x forward, y left.",
        "inputs": [_INPUTS[name](run, nearest) | {"name": name} for name in raw_inputs(run)],
        "outputs": _outputs(params, requests_of(agent), nearest),
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
        "requests": [{"request": request, "name": REQUESTS[request]} for request in range(requests_of(agent))],
        "hearing": config.hearing,
        "messages": list(MESSAGES),
        "replies": list(REPLIES),
        "sentences": _sentences(),
        "language": _language() if hears_phrases(agent) else None,
        "origin": origin,
    }  # fmt: skip


def origin_of(run, policy, stored, evaluation):
    """Where a policy comes from. policy: last or best; stored: the run's config.json; evaluation: its evaluation."""
    return {
        "run": run.folder.name, "policy": policy, "exported_by": f"jaxnav {importlib.metadata.version('jaxnav')}",
        "config": to_json(run.config) | {"out": run.folder.name},
        **{name: stored[name] for name in ("versions", "git_commit", "device") if name in stored},
        "evaluation": evaluation,
    }  # fmt: skip


def _entry(shape, dtype, unit, low, high, meaning, frame="none", order="none"):
    return {
        "shape": list(shape), "dtype": dtype, "unit": unit, "frame": frame, "order": order, "range": [low, high],
        "meaning": meaning,
    }  # fmt: skip


def _each(dtype, low, high, meaning, unit="1"):
    """Of something that there is one of for each observed person."""
    return lambda run, nearest: _entry([nearest], dtype, unit, low, high, meaning, order="people, nearest first")


_INPUTS = {
    "scan": lambda run, _: _entry(
        [run.world.config.beams], "float32", "m", 0.0, float(run.params.scan_range),
        "Ranges at the angles laser.angles_deg; the largest of the range where nothing is hit.",
        "robot: from its centre", "right (-90 degrees), ahead, left (90 degrees)",
    ),
    "pedestrians": lambda run, nearest: _entry(
        [nearest, 4], "float32", "m, m, m/s, m/s", -_FAR, _FAR,
        "Of the nearest people x, y, velocity x, velocity y. The velocity is that over ground: the robot's own is not "
        "subtracted. Rows of nobody, and of people out of sight, are 0.",
        "robot", "people, nearest first",
    ),
    "seen": _each("bool", 0, 1, "Whether there is such a person, and in sight."),
    "is_open": _each("bool", 0, 1, "Whether a dialogue with that person is open."),
    "pedestrian_first": _each("bool", 0, 1, "Whether that person spoke first in it."),
    "message_age": _each("int32", 0, 1_000_000, "Periods since the person spoke, 0 where it did not.", _PERIOD),
    "request": _each("int32", 0, 3, "The request that the robot asked of that person, 0 none."),
    "request_age": _each("int32", 0, 1_000_000, "Periods since it asked, 0 where it did not.", _PERIOD),
    "reply": _each("int32", 0, 2, "The answer: an index into replies."),
    "words": lambda run, nearest: _entry(
        [nearest, DIMENSIONS + 1], "float32", "1", -10.0, 10.0,
        "What each person says, as a vector of phrasebook.py; 0 where nothing is said.", order="people, nearest first",
    ),
    "message": _each("int32", 0, 3, "What each person says: an index into messages."),
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


def _outputs(params, requests, nearest):
    def output(name, shape, unit, low, high, meaning, frame="none", order="none"):
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


def _network(run):
    """Sizes of `Actor` in robot/policy.py."""
    agent, config = run.agent, run.agent.config
    requests = requests_of(agent)
    sizes = {
        "encoder": config.encoder, "inputs": list(network_inputs(run)), "widths": list(config.actor_widths),
        "requests": requests, "twists": requests if getattr(config, "heads", "shared") == "per-request" else 1,
        "mean_tanh": bool(getattr(config, "mean_tanh", False)), "squash": "clip" if isinstance(agent, PPO) else "tanh",
        "max_v": float(run.params.max_v), "max_w": float(run.params.max_w),
    }  # fmt: skip
    encoder = ENCODERS[config.encoder]()
    if "maps" in sizes["inputs"]:
        sizes |= {"cells": sensing.GRID, "channels": list(encoder.channels)}
        sizes |= {name: getattr(encoder, name) for name in ("width", "dialogue_width")}
    else:
        sizes |= {"beams": run.world.config.beams, "sectors": SECTORS}
        sizes |= {name: getattr(encoder, name) for name in ("scan_width", "pedestrian_width")}
    if hears_phrases(agent):
        sizes |= {"dimensions": DIMENSIONS + 1, "listener_width": LangPreNet.width}
    return sizes


def _sentences():
    """The robot's sentences. request, acknowledge: by request or message; reply: by reply; repeat: unsure."""
    sides = (STOP, RIGHT, LEFT)
    return {
        "request": {REQUESTS[request]: sentences(Context(request)) for request in sides},
        "acknowledge": {MESSAGES[request]: sentences(Context(request, "pedestrian")) for request in sides},
        "reply": {REPLIES[reply]: sentences(Context(STOP, "robot", reply)) for reply in (AGREES, REFUSES)},
        "repeat": sentences(Context(NONE, "nobody")),
    }


def _language():
    table = default_table()
    return {
        "dimensions": DIMENSIONS + 1, "sentence_encoder": table.encoder,
        "sentence_encoder_sha256": table.encoder_hash, "features": len(table.projection.centre),
        "phrases": len(table.phrases), "fingerprint": table.fingerprint,
    }  # fmt: skip
