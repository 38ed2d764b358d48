"""The rules of a conversation that nobody learns: when the robot asks again, slows down, or stands for somebody.

`jaxnav talk` and the runtime of an exported policy follow them; a bundle's contract holds `RULES` under "dialogue".
Written for Python 3.6: this file travels in the bundle of an exported policy.
"""

import math
from typing import Dict, List, Optional, Sequence, Tuple

RULES = {
    "unsure_margin": 0.4,  # between the two likeliest messages: below it the robot asks to repeat
    "reply_probability": 0.5,  # from which on an answer counts as one
    "careful_periods": 5,  # for which the robot goes slowly after it has asked to repeat
    "careful_speed": 0.25,  # then its greatest speed, as a share of its top speed
    "stand_periods": 20,  # for which it stands at most for somebody whom it promised to
    "stand_gap": 0.15,  # m between the bodies when that person walks by
    "walking_speed": 0.1,  # m/s below which a person stands
}


def is_unsure(margin: float, rules: Dict[str, float]) -> bool:
    """Whether the robot asks to repeat. margin: between the probabilities of the two likeliest messages."""
    return margin < rules["unsure_margin"]


def is_reply(probability: float, rules: Dict[str, float]) -> bool:
    """Whether a possible answer counts as one."""
    return probability > rules["reply_probability"]


def reaction(message: int, reply: int, unsure: bool, awaited: bool) -> str:
    """The robot's reaction to what it understood: "reply", "repeat", "obey", or "" where nothing is asked of it.

    message, reply: indices, 0 none; unsure: whether it is; awaited: whether somebody owes the robot an answer.
    """
    if reply and awaited:
        return "reply"  # an answer counts only while one is awaited
    if unsure:
        return "repeat"  # what may have been meant is not taken for said
    return "obey" if message else ""


def speaker(people: Sequence[Tuple[float, bool, bool]]) -> Optional[int]:
    """The one who is taken for the speaker of a sentence, which doesn't say whose it is; None where there is nobody.

    The nearest with whom a dialogue is open and nothing has been said yet, else the nearest in a dialogue, else the
    nearest. people: (distance, whether a dialogue is open, whether nothing has been said in it) each. Returns an index.
    """
    order = sorted(range(len(people)), key=lambda i: (not people[i][2], not people[i][1], people[i][0]))
    return order[0] if order else None


def walks_into(person: Sequence[float], robot: Sequence[float], clearance: float, rules: Dict[str, float]) -> bool:
    """Whether a person walks, and within ``clearance`` past the robot if both keep on: it walking, the robot standing.

    person: x, y, velocity x, velocity y; robot: x, y.
    """
    x, y, vx, vy = person
    speed = math.hypot(vx, vy)
    if speed < rules["walking_speed"]:
        return False
    dx, dy = robot[0] - x, robot[1] - y
    return dx * vx + dy * vy > 0 and abs(dx * vy - dy * vx) / speed < clearance


def stands(promises: List[Tuple[int, bool]], rules: Dict[str, float]) -> bool:
    """Whether the robot stands: it promised to, a short while ago, and nobody to whom it did walks into it then.

    It says that it stops when it is asked to, and when its own request is refused; the policy might rather go on.
    From the way of a person who walks straight on it steers aside first. promises: (periods since then, `walks_into`).
    """
    held = [into for age, into in promises if age < rules["stand_periods"]]
    return bool(held) and not any(held)
