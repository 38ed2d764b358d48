"""Dataclasses as JSON: nothing is lost, what is missing or unknown is named, and so is what differs."""

import json

import pytest

from jaxnav.agents.hsac import HSACConfig, HSACHyperparameters
from jaxnav.training.config import HSACRunConfig, TrainConfig, WorldSettings
from jaxnav.training.dataclass_json import differences, from_json, to_json
from jaxnav.world import Params


def test_every_field_survives_json():
    config = HSACRunConfig(
        seed=7, world=WorldSettings(scenes=("hallway",), beams=31, hearing=False, params=Params(compliance=0.25)),
        agent=HSACConfig(critic_widths=(3, 5)), hyper=HSACHyperparameters(tau=0.5), train=TrainConfig(episodes=3),
    )  # fmt: skip
    again = from_json(HSACRunConfig, json.loads(json.dumps(to_json(config))))
    assert again == config
    assert isinstance(again.agent.critic_widths, tuple) and hash(again.agent) == hash(config.agent)


@pytest.mark.parametrize("where", [(), ("world",), ("world", "params"), ("hyper",)])
def test_json_with_a_missing_or_unknown_field_is_refused_by_its_name(where):
    for change, name in ((lambda d: d.update(surprise=1), "surprise"), (lambda d: d.pop(next(iter(d))), None)):
        data = inner = to_json(HSACRunConfig())
        for key in where:
            inner = inner[key]
        name = name or next(iter(inner))
        change(inner)
        with pytest.raises(ValueError, match=rf"field {name} is (missing|unknown)"):
            from_json(HSACRunConfig, data)


def test_differences_are_dotted_names():
    old = to_json(HSACRunConfig())
    new = to_json(HSACRunConfig(seed=1, world=WorldSettings(beams=3, params=Params(dt=0.1)), agent=HSACConfig(batch=1)))
    assert differences(old, old) == []
    assert differences(old, new) == ["agent.batch", "seed", "world.beams", "world.params.dt"]
    assert differences({"a": {"b": 1}}, {}) == ["a"]
    assert differences({}, {"a": 1}) == ["a"]
