"""Configurations: to JSON and back, what differs, and one line about every value that can't be."""

import dataclasses
import json

import pytest

from jaxnav.agents.hsac import HSACConfig
from jaxnav.errors import UserError
from jaxnav.training.config import PRESETS, HSACRunConfig, TrainConfig, WorldSettings, preset, resolve
from jaxnav.training.dataclass_json import from_json, to_json
from jaxnav.world import Params, World, WorldConfig, default_params

NAN = float("nan")


@pytest.mark.parametrize("name", PRESETS)
def test_presets_are_named_and_survive_json(name):
    config = resolve(preset(name))
    assert config.preset == name
    assert config.out == f"runs/{name}-0"
    assert from_json(HSACRunConfig, json.loads(json.dumps(to_json(config)))) == config


def test_scenes_of_a_suite_bring_their_people():
    some = WorldSettings(scenes=("narrow", "doorway"))
    assert resolve(HSACRunConfig(world=some)).world.params == default_params(("narrow",))
    slow = dataclasses.replace(some, params=Params(preferred_speed=0.9))
    assert resolve(HSACRunConfig(world=slow)).world.params.preferred_speed == 0.9
    again = resolve(preset("quick", scenes="hard"))
    assert resolve(again) == again and again.world.params == default_params(("narrow",))
    back = again.of_scenes("hallway,crosswalk")
    assert back.world.scenes == ("hallway", "crosswalk") and back.world.params == Params()
    with pytest.raises(UserError, match=r"^world\.scenes mixes square and narrow"):
        preset("quick", scenes="square,narrow")


def test_one_scene_becomes_the_only_scene_of_the_world():
    assert resolve(preset("quick", scenes="hallway")).world.scenes == ("hallway",)
    assert resolve(HSACRunConfig()).world.scenes == ("square", "hallway", "crosswalk")
    assert isinstance(resolve(HSACRunConfig()).world.world(), World)


@pytest.mark.parametrize(
    ("make", "field", "value"),
    [
        (lambda: TrainConfig(episodes=0), "train.episodes", "0"),
        (lambda: TrainConfig(replay_rows=-5), "train.replay_rows", "-5"),
        (lambda: TrainConfig(steps_per_chunk=2.5), "train.steps_per_chunk", "2.5"),
        (lambda: TrainConfig(total_steps=26), "train.total_steps", "26"),
        (lambda: TrainConfig(evaluate_every=0), "train.evaluate_every", "0"),
        (lambda: TrainConfig(checkpoint_seconds=-1.0), "train.checkpoint_seconds", "-1.0"),
        (lambda: TrainConfig(checkpoint_seconds=NAN), "train.checkpoint_seconds", "nan"),
        (lambda: HSACConfig(encoder="grid-net"), "agent.encoder", "'grid-net'"),
        (lambda: HSACConfig(batch=0), "agent.batch", "0"),
        (lambda: HSACConfig(updates_per_step=-1), "agent.updates_per_step", "-1"),
        (lambda: HSACConfig(actor_widths=()), "agent.actor_widths", r"\(\)"),
        (lambda: HSACConfig(critic_widths=(8, -8)), "agent.critic_widths", r"\(8, -8\)"),
        (lambda: HSACConfig(huber_delta=NAN), "agent.huber_delta", "nan"),
        (lambda: WorldConfig(pedestrians=-1), "world.pedestrians", "-1"),
        (lambda: WorldConfig(beams=1), "world.beams", "1"),
        (lambda: WorldConfig(beams=NAN), "world.beams", "nan"),
        (lambda: WorldConfig(observation=("scan", "smell")), "world.observation", "'smell'"),
        (lambda: World(WorldConfig(reward="money")), "world.reward", "'money'"),
        (lambda: WorldConfig(scenes=()), "world.scenes", r"\(\)"),
    ],
)
def test_a_bad_size_is_refused_with_field_value_and_remedy(make, field, value):
    with pytest.raises(ValueError, match=rf"^{field}.* {value}.*: (give|choose|name) |^{field} is {value}: name"):
        make()


def run_config(**fields):
    """A `HSACRunConfig`; names with a double underscore reach into the group before it."""
    config = HSACRunConfig()
    for name, value in fields.items():
        *groups, field = name.split("__")
        parts = [config]
        for group in groups:
            parts.append(getattr(parts[-1], group))
        for group, part in zip([*reversed(groups), None], reversed(parts), strict=True):
            value, field = dataclasses.replace(part, **{field: value}), group
        config = value
    return config


@pytest.mark.parametrize(
    ("name", "value", "field"),
    [
        ("algo", "dreamer", "algo"),
        ("seed", -1, "seed"),
        ("seed", 2**32, "seed"),
        ("world__scenes", ("square", "moon"), "scene"),
        ("world__scenes", ("square", "narrow"), "world.scenes"),
        ("world__observation", ("scan", "dialogue"), "world.observation"),
        ("world__pedestrians", 17, "world.pedestrians"),
        ("world__params__body_radius", -0.1, "world.params.body_radius"),
        ("world__params__robot_radius", 0.0, "world.params.robot_radius"),
        ("world__params__robot_radius", NAN, "world.params.robot_radius"),
        ("world__params__dt", -0.4, "world.params.dt"),
        ("world__params__max_steps", float("inf"), "world.params.max_steps"),
        ("world__params__compliance", 1.5, "world.params.compliance"),
        ("world__params__p_pedestrian_first", -0.1, "world.params.p_pedestrian_first"),
        ("world__params__reward_arrival", NAN, "world.params.reward_arrival"),
        ("hyper__actor_lr", -1e-3, "hyper.actor_lr"),
        ("hyper__critic_lr", NAN, "hyper.critic_lr"),
        ("hyper__discount", 1.01, "hyper.discount"),
        ("hyper__tau", -0.1, "hyper.tau"),
        ("hyper__final_lr", 2.0, "hyper.final_lr"),
        ("hyper__target_entropy_request", 1.5, "hyper.target_entropy_request"),
        ("hyper__initial_temperature", 0.0, "hyper.initial_temperature"),
        ("hyper__reward_scale", float("inf"), "hyper.reward_scale"),
        ("hyper__reward_scale", 0.0, "hyper.reward_scale"),
        ("hyper__word_noise", -0.1, "hyper.word_noise"),
        ("hyper__message_weight", -1.0, "hyper.message_weight"),
    ],
)
def test_a_bad_value_is_refused_with_field_and_remedy_in_one_line(name, value, field):
    with pytest.raises(
        UserError, match=rf"^{field} .*: (give|choose|the lidar encoder needs|scene hallway holds)"
    ) as caught:
        resolve(run_config(**{name: value}))
    assert "\n" not in str(caught.value)
    shown = value[-1] if isinstance(value, tuple) and field != "world.observation" else value
    assert field == "world.observation" or str(shown) in str(caught.value)


def test_values_at_the_edge_of_their_range_pass():
    edge = run_config(
        seed=2**32 - 1, hyper__discount=1.0, hyper__tau=1.0, hyper__actor_lr=0.0, world__params__compliance=1.0,
        world__params__body_radius=0.0, world__pedestrians=16, train__checkpoint_seconds=0.0,
    )  # fmt: skip
    assert resolve(edge).world.pedestrians == 16


@pytest.mark.parametrize("algo", ["td3", "ppo", "a2c"])
def test_presets_are_those_of_every_algorithm_as_far_as_it_has_their_fields(algo):
    usual, quick, grid = HSACRunConfig(), preset("quick", algo), preset("grid", algo)
    assert (quick.agent, quick.hyper) == (type(quick)().agent, type(quick)().hyper)
    assert (grid.agent.encoder, grid.agent.actor_widths, grid.agent.critic_widths) == ("grid", (128,), (128,))
    assert (grid.hyper.actor_lr, grid.hyper.critic_lr) == (3e-4, 3e-4) != (usual.hyper.actor_lr, usual.hyper.critic_lr)
    assert getattr(grid.agent, "batch", 256) == 256
    assert grid.hyper.replace(actor_lr=0.0, critic_lr=0.0) == quick.hyper.replace(actor_lr=0.0, critic_lr=0.0)


@pytest.mark.parametrize(
    ("algo", "name", "value", "remedy"),
    [
        ("td3", "target_noise_clip", -0.5, "of at least 0"),  # would turn the noise into a constant
        ("td3", "target_noise", -0.1, "of at least 0"),
        ("td3", "exploration_noise", -0.1, "of at least 0"),
        ("ppo", "entropy_weight", -0.1, "of at least 0"),
        ("ppo", "clip", 0.0, "above 0"),
        ("ppo", "gae_lambda", 1.5, "from 0 to 1"),
        ("ppo", "max_gradient_norm", 0.0, "above 0"),
        ("a2c", "initial_std", 0.0, "of at most 1 and above 0"),
    ],
)
def test_a_bad_value_of_the_other_algorithms_is_refused(algo, name, value, remedy):
    config = preset("quick", algo)
    with pytest.raises(UserError, match=rf"^hyper.{name} is {value}: give a number {remedy}$"):
        resolve(dataclasses.replace(config, hyper=config.hyper.replace(**{name: value})))
