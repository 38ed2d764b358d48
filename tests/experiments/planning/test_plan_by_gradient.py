"""The program from end to end: plans beat the straight line and are what the world makes of them; wrong input."""

import json

import cv2
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from experiments.planning import gradient_plans, plan_by_gradient
from jaxnav.agents.scripted import StraightLine
from jaxnav.training.rollout import play
from jaxnav.world import Action, Params, World, WorldConfig

EPISODES = 24


def test_gradient_ascent_finds_a_way_around_and_the_world_agrees(full):
    """At its full size alone: nearly all of it is compilation. Else that it can be traced, and its shapes."""
    world, params, scene = World(WorldConfig(scenes=("hallway",), wall_neighbors=1)), Params(), jnp.int32(0)
    steps, iterations = 45, 50
    keys = jax.random.split(jax.random.key(5), EPISODES)

    def planned(key):
        return gradient_plans.plan(world, params, scene, key, steps, 1, iterations, 0.02)

    if not full:
        twists, outcomes = jax.eval_shape(planned, keys[0])
        assert twists.shape == (steps, 2) and [leaf.shape for leaf in outcomes] == [(iterations + 1,)] * 5
        return

    @jax.jit
    @jax.vmap
    def replayed(key, twists):
        """The plan once more, a step at a time and with nothing else of the planner's."""
        key_reset, key_steps = jax.random.split(key)

        def step(state, now):
            return world.step(now[0], state, Action(twist=now[1], request=jnp.int32(0)), params)

        outcomes = jax.lax.scan(
            step, world.reset(key_reset, params, scene), (jax.random.split(key_steps, steps), twists)
        )
        return outcomes[1]

    twists, (returns, arrived, collided, hit, length) = jax.device_get(jax.jit(jax.vmap(planned))(keys))
    assert twists.shape == (EPISODES, steps, 2) and np.abs(twists).max() < 1.0
    assert np.all(np.diff(returns, axis=1) >= 0)
    straight = jax.jit(play, static_argnums=(0, 5))(
        world, params, StraightLine(), keys, jnp.zeros(EPISODES, int), steps
    )
    assert arrived[:, -1].sum() >= 0.9 * EPISODES > 0.7 * EPISODES > max(arrived[:, 0].sum(), straight.arrived.sum())
    assert returns[:, -1].mean() > returns[:, 0].mean() + 50.0

    outcomes = jax.device_get(replayed(keys, twists))
    for i in range(EPISODES):
        end = int(np.argmax(outcomes.terminated[i])) if outcomes.terminated[i].any() else steps - 1
        assert (arrived[i, -1], collided[i, -1], hit[i, -1], length[i, -1]) == (
            outcomes.arrived[i, end], outcomes.collided[i, end], outcomes.hit_pedestrian[i, end], end + 1,
        )  # fmt: skip
        assert returns[i, -1] == pytest.approx(outcomes.reward[i, : end + 1].sum(), rel=1e-5)


def fake_programs(world, options):
    """Programs of plans that get better from one iteration to the next, and of scripted robots that always arrive."""
    del world

    def planned(params, scene, keys):
        del params, scene
        arrived = jnp.arange(options.iterations + 1) + jnp.arange(keys.shape[0])[:, None] % 4 >= 3
        return 10.0 * arrived, arrived, ~arrived, ~arrived, jnp.full(arrived.shape, 30)

    def scripted(params, scene, keys):
        no = jnp.zeros(keys.shape, bool)
        return ~no, no, no, jnp.full(keys.shape, 40)

    return {plan_by_gradient.PLAN: planned, **dict.fromkeys(plan_by_gradient.SCRIPTED, scripted)}


def test_a_study_writes_its_files_and_goes_on_where_it_was(tmp_path, monkeypatch, capsys):
    calls = []
    monkeypatch.setattr(plan_by_gradient, "programs", lambda *given: calls.append(given) or fake_programs(*given))
    options = ["--episodes", "60", "--iterations", "2", "--out", str(tmp_path)]
    plan_by_gradient.main(["--scenes", "doorway", *options])
    plan_by_gradient.main(["--scenes", "doorway", "square", *options])
    assert len(calls) == 2  # a scene each
    text = (tmp_path / "plan_by_gradient.json").read_text()
    result = json.loads(text)
    assert str(tmp_path) not in text
    assert {"options", "versions", "git_commit", "device"} <= result.keys()
    assert list(result["rows"]) == ["square", "doorway"]
    rows = result["rows"]["doorway"]["robots"]
    assert [rows[robot]["success"] for robot in plan_by_gradient.ROBOTS] == [44 / 60, 14 / 60, 1.0, 1.0, 1.0, 1.0]
    assert rows["plan by gradient"]["success_ci95"][0] < 44 / 60 < rows["plan by gradient"]["success_ci95"][1]
    assert rows["plan by gradient"]["collision"] == 16 / 60 and rows["plan by gradient"]["timeout"] == 0.0
    assert result["rows"]["doorway"]["by_iteration"]["success"] == pytest.approx([14 / 60, 28 / 60, 44 / 60])
    assert "| doorway | 0.733 (0.610-0.829) |" in capsys.readouterr().out
    picture = cv2.imread(str(tmp_path / "plan_by_gradient.png"))
    assert picture is not None and picture.shape[0] > 300 and np.ptp(picture) == 255

    with pytest.raises(SystemExit):
        plan_by_gradient.main(["--scenes", "doorway", *options, "--seed", "1"])
    assert "another configuration (options.seed differ)" in capsys.readouterr().err and len(calls) == 2


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--scenes", "moon"], "--scenes names 'moon': choose from square, hallway"),
        (["--episodes", "0"], "--episodes is 0: give a whole number from 1 to 100000"),
        (["--steps", "101"], "--steps is 101: give a whole number from 1 to 100"),
        (["--rate", "0"], "--rate is 0.0: give a number above 0, at most 1"),
        (["--rate", "nan"], "--rate is nan: give a number above 0, at most 1"),
        (["--seed", "-1"], "--seed is -1: give a whole number from 0 to 4294967295"),
    ],
)
def test_wrong_input_ends_in_one_line_and_exit_request_2(capsys, arguments, message):
    with pytest.raises(SystemExit) as end:
        plan_by_gradient.main(arguments)
    assert end.value.code == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"error: {message}")
