"""Captions and labels say who said what, and when."""

import dataclasses

import numpy as np
import pytest

from jaxnav.language.speaker import REQUEST_WORDS
from jaxnav.render.words import captions, ending, in_short, scene_title, utterances
from jaxnav.world.types import MESSAGES, REQUESTS


def _with(episode, **fields):
    """The episode with the encounters' fields set to a value in every state."""
    encounters = episode.states.encounters
    set_to = {name: np.full_like(getattr(encounters, name), value) for name, value in fields.items()}
    return dataclasses.replace(episode, states=episode.states.replace(encounters=encounters.replace(**set_to)))


_SILENT = {"request": 0, "message": 0, "reply": 0, "utterance": 0, "is_open": False}


def test_utterances_are_the_changes_from_silence(find):
    for speaker, field in (("robot", "request"), ("pedestrian", "message")):
        episode = find(speaker=speaker)
        indices = getattr(episode.states.encounters, field)[:, 0]
        said = [utterance for utterance in utterances(episode) if utterance.speaker == speaker]
        assert len(said) == 1
        assert indices[said[0].t] == said[0].said != 0
        assert said[0].t == 0 or indices[said[0].t - 1] == 0


def test_what_is_said_before_the_first_step_counts(episodes):
    said = utterances(_with(episodes[0], **_SILENT | {"message": 2}))
    assert [(u.t, u.speaker, u.said) for u in said] == [(0, "pedestrian", 2)]


@pytest.mark.parametrize("index", [1, 2, 3])
def test_every_request_and_message_has_words_of_its_own(episodes, index):
    asked = _with(episodes[0], **_SILENT | {"request": index, "reply": 1})
    (who, request), (answerer, answer) = captions(asked, 2)
    assert (who, answerer) == ("robot", "pedestrian")
    assert request == f'Robot: "{REQUEST_WORDS[index].asks[0]}"'
    hand = REQUESTS[index].removeprefix("margin-")
    assert hand in request
    assert answer.startswith("Pedestrian agrees:")
    assert hand in answer

    ((who, message),) = captions(_with(episodes[0], **_SILENT | {"message": index}), 2)
    assert who == "pedestrian"
    assert MESSAGES[index].removeprefix("robot ") in message


def test_refusal_small_talk_meeting_and_silence(episodes):
    refused = captions(_with(episodes[0], **_SILENT | {"request": 1, "reply": 2}), 0)
    assert refused[1] == ("pedestrian", "Pedestrian refuses")
    assert captions(_with(episodes[0], **_SILENT | {"request": 1}), 0) == refused[:1]
    assert captions(_with(episodes[0], **_SILENT | {"utterance": 5}), 0) == [
        ("pedestrian", "Pedestrian makes small talk")
    ]
    assert captions(_with(episodes[0], **_SILENT | {"is_open": True}), 0) == [("", "Robot and pedestrian meet")]
    assert captions(_with(episodes[0], **_SILENT), 0) == []


def test_a_deaf_robot_is_said_to_be_deaf(episodes):
    episode = _with(episodes[0], **_SILENT | {"message": 1})
    assert captions(episode, 0, hearing=False)[0][1].endswith("(the robot is deaf)")
    assert [in_short(utterances(episode)[0], hearing) for hearing in (True, False)] == ["hears: stop", "misses: stop"]


def test_in_a_crowd_everybody_has_a_number_and_the_latest_comes_first(crowd):
    episode = _with(crowd[1][0], **_SILENT | {"message": 1})
    ages = np.broadcast_to(np.array([3, 1, 5, 2, 4]), episode.states.encounters.message_age.shape)
    encounters = episode.states.encounters.replace(message_age=ages)
    lines = captions(dataclasses.replace(episode, states=episode.states.replace(encounters=encounters)), 1)
    assert [sentence.split(":")[0] for _, sentence in lines] == [f"Pedestrian {i}" for i in (2, 4, 1, 5, 3)]


def test_endings_are_those_of_the_outcomes(episodes):
    seen = {ending(episode) for episode in episodes}
    assert seen == {"arrived", "collision", "time out"}
    for episode in episodes:
        assert (ending(episode) == "arrived") == bool(episode.outcomes.arrived[-1])
    cut = dataclasses.replace(episodes[0], outcomes=episodes[0].outcomes.replace(
        **{name: np.zeros_like(getattr(episodes[0].outcomes, name)) for name in ("arrived", "collided", "truncated")}
    ))  # fmt: skip
    assert ending(cut) == ""


@pytest.mark.parametrize(
    ("name", "title"),
    [("square", "Square"), ("narrow-laser", "Narrow laser"), ("maps/my_house.yaml", "My house")],
)
def test_a_scene_is_called_by_its_name_without_folders(name, title):
    assert scene_title(name) == title
