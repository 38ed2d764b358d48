"""The public face: a robot trained, evaluated, played and compared with nothing but ``import jaxnav``."""

import contextlib
import dataclasses
import io
import json
import pathlib
import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxnav
from jaxnav import api
from jaxnav.errors import UserError
from jaxnav.training import evaluation
from jaxnav.world.types import REQUESTS

README = (pathlib.Path(__file__).parent.parent / "README.md").read_text()
EPISODES = 16
PRESET = jaxnav.preset


def small(name="quick"):
    """A `RunConfig` of seconds."""
    config = PRESET(name)
    return dataclasses.replace(
        config,
        world=dataclasses.replace(config.world, scenes=("hallway",), beams=16, params=jaxnav.Params(max_steps=30.0)),
        agent=dataclasses.replace(config.agent, actor_widths=(16,), critic_widths=(16,), batch=32, updates_per_step=1),
        train=dataclasses.replace(config.train, episodes=16, replay_rows=20, steps_per_chunk=5, total_steps=10),
    )


@pytest.fixture(scope="module", autouse=True)
def _light():
    """Few episodes at a time."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(evaluation, "BLOCK", EPISODES)
        patch.setattr(api, "EPISODES", EPISODES)
        yield


@pytest.fixture(scope="module")
def first(tmp_path_factory):
    """(folder of a run, what was printed): the first Python of the README, with a smaller preset."""
    code, printed = re.search(r"```python\n(.*?)```", README, re.DOTALL)[1], io.StringIO()
    with pytest.MonkeyPatch.context() as patch, contextlib.redirect_stdout(printed):
        patch.chdir(tmp_path_factory.mktemp("readme"))
        patch.setattr(jaxnav, "preset", small, raising=False)
        exec(code.replace("episodes=500", f"episodes={EPISODES}"), {})
        return pathlib.Path("runs/first").absolute(), printed.getvalue().split()


@pytest.fixture(scope="module")
def policy(first):
    return jaxnav.load(first[0])


def test_five_lines_train_evaluate_and_play(first):
    folder, printed = first
    assert 0.0 <= float(printed[0]) <= 1.0 and int(printed[1]) >= 1 and printed[2] == "steps"
    names = {"bundle", "evaluation.json", "trajectories.png", "episode.gif", "learning_curve.png", "metrics.jsonl"}
    assert names <= {path.name for path in folder.iterdir()}
    result = jaxnav.evaluate(folder, episodes=EPISODES)
    written = json.loads((folder / "evaluation.json").read_text())
    assert result["scenes"] == written["scenes"]


def test_a_finished_run_is_resumed_with_nothing_to_do(first):
    config = dataclasses.replace(small(), out=str(first[0]))
    before = (first[0] / "metrics.jsonl").read_bytes()
    jaxnav.train(config, resume=True, report=lambda line: pytest.fail("trained on"), finish=False)
    assert (first[0] / "metrics.jsonl").read_bytes() == before


def test_a_policy_goes_through_jit_and_vmap_and_is_compiled_once_for_two_loads(first, policy):
    world, traces = policy.world, []
    keys = jax.random.split(jax.random.key(0), 4)
    observe = jax.jit(jax.vmap(lambda key: world.observe(world.reset(key, policy.params), policy.params)))
    observations = observe(keys)

    @jax.jit
    def act(policy, observation):
        traces.append(None)
        return policy.reset().act(observation)

    many = jax.jit(jax.vmap(policy.act))(observations)
    assert many.twist.shape == (4, 2)
    again = jaxnav.load(first[0])
    other = again.replace(config=dataclasses.replace(again.config, seed=7))
    for one in (policy, again, other):
        action = act(one, jax.tree.map(lambda leaf: leaf[0], observations))
        np.testing.assert_allclose(action.twist, many.twist[0], atol=1e-5)
    assert len(traces) == 1
    assert act(policy.muted(), jax.tree.map(lambda leaf: leaf[1], observations)).request == 0
    both = jax.tree.map(lambda leaf: jnp.stack([leaf, leaf]), policy.parameters)
    axes = policy.replace(parameters=0, voice=None, vocabulary=None)
    one = jax.tree.map(lambda leaf: leaf[0], observations)
    twice = jax.vmap(lambda policy: policy.act(one), in_axes=(axes,))(policy.replace(parameters=both))
    np.testing.assert_array_equal(twice.twist[0], twice.twist[1])


def test_players_are_compared_on_the_same_episodes(first, policy):
    result = jaxnav.compare(first[0], policy.muted(), jaxnav.StraightLine(), episodes=EPISODES)
    assert result["players"] == ["first", "first 2", "straight line"]
    found = result["scenes"]["hallway"]
    evaluated = jaxnav.evaluate(policy, episodes=EPISODES)["scenes"]["hallway"]
    success = [metrics["success"] for metrics in found["players"].values()]
    assert success == [evaluated[name] for name in ("success", "muted_success", "straight_line_success")]
    assert tuple(found["players"]["first"]["requests"]) == REQUESTS
    assert [(pair["one"], pair["other"]) for pair in found["differences"]] == [
        ("first", "first 2"), ("first", "straight line"), ("first 2", "straight line"),
    ]  # fmt: skip
    for pair, (a, b) in zip(found["differences"], [(0, 1), (0, 2), (1, 2)], strict=True):
        assert pair["difference"] == pytest.approx(success[a] - success[b])
        assert pair["ci95"][0] <= pair["difference"] <= pair["ci95"][1]
    same = jaxnav.compare(policy, policy, episodes=EPISODES)["scenes"]["hallway"]["differences"][0]
    assert (same["difference"], same["ci95"]) == (0.0, [0.0, 0.0])


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda policy: jaxnav.compare(policy), ["players are 1", "at least two"]),
        (lambda policy: jaxnav.compare(policy, jaxnav.StraightLine), ["player is", "StraightLine()"]),
        (lambda policy: jaxnav.evaluate(policy, episodes=0), ["episodes is 0", "from 1"]),
        (lambda policy: jaxnav.evaluate(policy, phrases="all"), ["phrases is 'all'", "validation"]),
        (lambda policy: jaxnav.evaluate(policy, world=jaxnav.World()), ["world.beams is 180", "16"]),
        (lambda policy: jaxnav.record(policy, scene="square"), ["scene is 'square'", "hallway"]),
        (lambda policy: jaxnav.load("nowhere"), ["nowhere holds no run"]),
        (lambda policy: jaxnav.load("nowhere", policy="first"), ["policy is 'first'", "last or best"]),
    ],
)
def test_what_is_wrong_is_told_in_one_line(policy, call, words):
    with pytest.raises(UserError) as caught:
        call(policy)
    message = str(caught.value)
    assert "\n" not in message and all(word in message for word in words), message
