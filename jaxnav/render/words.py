"""Captions: the utterances of a recorded episode and its ending, in fixed sentences."""

import pathlib
from typing import NamedTuple

import numpy as np

from ..language.speaker import REQUEST_WORDS, Context, sentences
from ..training.rollout import Episode
from ..world.types import AGREES, LEFT, NONE, REFUSES, RIGHT, STOP

MESSAGE_SENTENCES = {
    STOP: "I walk straight on - please stop!",
    RIGHT: "I keep right - please keep right too!",
    LEFT: "I keep left - please keep left too!",
}
_SHORT_MESSAGES = {STOP: "stop", RIGHT: "keep right", LEFT: "keep left"}


class Utterance(NamedTuple):
    """A request or message in an episode.

    t:          index of the first state that knows of it.
    speaker:    "robot" or "pedestrian".
    pedestrian: index of the one who speaks or is spoken to.
    said:       index into `REQUESTS` of what the robot says, into `MESSAGES` of what a pedestrian says.
    """

    t: int
    speaker: str
    pedestrian: int
    said: int


def utterances(episode: Episode) -> list[Utterance]:
    """The requests and messages of an `Episode` in order of time."""
    said = []
    for speaker, field in (("robot", "request"), ("pedestrian", "message")):
        indices = np.asarray(getattr(episode.states.encounters, field), dtype=int)
        before = np.concatenate([np.zeros_like(indices[:1]), indices[:-1]])
        for t, pedestrian in np.argwhere((indices != before) & (indices != NONE)):
            said.append(Utterance(int(t), speaker, int(pedestrian), int(indices[t, pedestrian])))
    return sorted(said)


def in_short(utterance: Utterance, hearing: bool = True) -> str:
    """A label of two to four words from the robot's point of view: "asks: stop", "hears: keep right"."""
    if utterance.speaker == "robot":
        return f"asks: {REQUEST_WORDS[utterance.said].short}"
    return f"{'hears' if hearing else 'misses'}: {_SHORT_MESSAGES[utterance.said]}"


def captions(episode: Episode, t: int, hearing: bool = True) -> list[tuple[str, str]]:
    """The sentences at state ``t``: (speaker, sentence) each, the latest encounter first.

    speaker: "robot", "pedestrian", or "" for a remark about an encounter in which nothing has been said.
    """
    if episode.speech is not None:
        return episode.speech[t]
    encounters = episode.states.encounters
    count = len(episode.present)
    spoken, chats, remarks = [], [], []
    for i in episode.present:
        name = "Pedestrian" if count == 1 else f"Pedestrian {i + 1}"
        request, message, reply = (int(getattr(encounters, field)[t, i]) for field in ("request", "message", "reply"))
        if request != NONE:
            addressee = "" if count == 1 else f" to {name.lower()}"
            lines = [("robot", f'Robot{addressee}: "{sentences(Context(request))[0]}"')]
            if reply == AGREES:
                lines.append(("pedestrian", f'{name} agrees: "{sentences(Context(request, "pedestrian"))[0]}"'))
            elif reply == REFUSES:
                lines.append(("pedestrian", f"{name} refuses"))
            spoken.append((int(encounters.request_age[t, i]), lines))
        elif message != NONE:
            heard = "" if hearing else " (the robot is deaf)"
            lines = [("pedestrian", f'{name}: "{MESSAGE_SENTENCES[message]}"{heard}')]
            spoken.append((int(encounters.message_age[t, i]), lines))
        elif encounters.utterance[t, i]:
            chats.append(("pedestrian", f"{name} makes small talk"))
        elif encounters.is_open[t, i]:
            remarks.append(("", f"{'Robot and pedestrian' if count == 1 else f'Robot and {name.lower()}'} meet"))
    spoken.sort(key=lambda group: group[0])
    return [line for _, lines in spoken for line in lines] + chats + remarks


def ending(episode: Episode) -> str:
    """The ending of an episode: "arrived", "collision", "time out", or "" where the recording stopped before."""
    for event, word in (("arrived", "arrived"), ("collided", "collision"), ("truncated", "time out")):
        if getattr(episode.outcomes, event)[-1]:
            return word
    return ""


def scene_title(name: str) -> str:
    """A scene's title: "narrow-laser" -> "Narrow laser", "maps/my_house.yaml" -> "My house"."""
    return pathlib.PurePath(name).stem.replace("_", " ").replace("-", " ").capitalize()
