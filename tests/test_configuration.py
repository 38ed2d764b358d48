"""Every field of a run says what it allows, and docs/configuration.md says the same."""

import dataclasses
import importlib.util
import pathlib

import pytest

from jaxnav.agents import LEARNERS
from jaxnav.fields import rule_of
from jaxnav.training.config import RunConfig, TrainConfig, WorldSettings, run_class
from jaxnav.world import Params, WorldConfig

ROOT = pathlib.Path(__file__).parent.parent
LEARNERS_OWN = [part for learner in LEARNERS.values() for part in (learner.config, learner.hyper)]


@pytest.mark.parametrize(
    "config",
    [
        Params,
        WorldConfig,
        WorldSettings,
        TrainConfig,
        RunConfig,
        *map(run_class, LEARNERS),
        *LEARNERS_OWN,
    ],
    ids=lambda config: config.__name__,
)
def test_every_field_has_a_range_and_a_meaning_and_its_default_is_allowed(config):
    default = config()
    for field in dataclasses.fields(config):
        rule = rule_of(field)
        assert rule is not None, f"{config.__name__}.{field.name} is declared without jaxnav.fields"
        assert rule.allowed and rule.doc, field.name
        assert rule.doc in field.metadata["help"]  # which --help shows
        assert rule.holds(getattr(default, field.name)), field.name


def test_the_page_is_up_to_date():
    spec = importlib.util.spec_from_file_location("configuration", ROOT / ".ci" / "configuration.py")
    page = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(page)
    assert page.PATH.read_text() == page.text(), "run python .ci/configuration.py"
