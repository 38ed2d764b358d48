"""What a sweep may be: bad ones are refused with the field, its value and the remedy."""

import dataclasses
import json

import pytest

from jaxnav.errors import UserError
from jaxnav.sweep import Guard, Range, spec

from .conftest import SWEEP

BAD = [
    ({"space": {}}, "space is empty"),
    (
        {"space": {"hyper.actr_lr": Range(0, 1)}},
        r"hyper.actr_lr is no field of base \('actr_lr' is unknown\).*actor_lr",
    ),
    ({"space": {"learner.lr": Range(0, 1)}}, "learner.lr is no field of base"),
    ({"space": {"hyper.tau": Range(0.5, 0.1)}}, "empty range for hyper.tau, 0.5 to 0.1: give the lower end first"),
    ({"space": {"hyper.tau": Range(0.1, 0.1)}}, "empty range for hyper.tau"),
    ({"space": {"hyper.tau": Range(0.0, 0.1, log=True)}}, "logarithmic range for hyper.tau from 0.0: begin above 0"),
    ({"space": {"hyper.tau": Range(0.1, float("nan"))}}, "empty range for hyper.tau"),
    ({"space": {"hyper.tau": (0.1, 0.2)}}, r"space has \(0.1, 0.2\) for hyper.tau: give a Range"),
    ({"space": {"hyper.tau": Range(0.1, 1.5)}}, "the high ends of space: hyper.tau is 1.5: give a number from 0 to 1"),
    (
        {"space": {"agent.updates_per_step": Range(1, 8)}},
        "a static size, which can't differ inside one population.*sizes",
    ),
    ({"space": {"world.params.max_v": Range(0.1, 1)}}, "part of the task.*world.randomise"),
    ({"sizes": {"agent.updates_per_step": ()}}, r"sizes has \(\) for agent.updates_per_step: give a tuple"),
    ({"sizes": {"agent.updates_per_step": (1, 1)}}, "give a tuple of different values"),
    ({"sizes": {"agent.updates_per_step": (1, 2.5)}}, "sizes has 2.5 for agent.updates_per_step: give values like 2"),
    ({"sizes": {"agent.updates_per_step": (0, 1)}}, "sizes has 0.*at least 1"),
    ({"sizes": {"agent.encoder": ("lidar", "sonar")}}, "sizes has 'sonar'.*unknown"),
    ({"sizes": {"hyper.tau": (0.1, 0.2)}}, "sizes has hyper.tau: give fields of agent or train"),
    (
        {"sizes": {"train.episodes": (8, 16)}},
        "train.episodes, which has to be the same for all: change base.train.episodes",
    ),
    ({"trials": 0}, "trials is 0: give a whole number of at least 1"),
    ({"members": -1}, "members is -1"),
    ({"keep": 1.0}, "keep is 1.0: give a share above 0 and below 1"),
    ({"rungs": (10, 5)}, "rungs are 10 5: give ascending multiples of base.train.steps_per_chunk"),
    ({"rungs": (7,)}, "rungs are 7"),
    ({"rungs": (20,)}, r"rungs are 20.*below base.train.total_steps \(20\)"),
    ({"direction": "max"}, "direction is 'max': give maximize or minimize"),
    ({"objective": "success"}, "objective is 'success': give a function"),
    ({"space": {"hyper.tau": Range("a", 1.0)}}, r"Range\(low='a'.*give two numbers"),
    ({"members": 2.5}, "members is 2.5"),
    ({"sizes": {"train.checkpoint_seconds": (1.0, 2.0)}}, "train.checkpoint_seconds, which has to be the same for all"),
    ({"base": dataclasses.replace(SWEEP.base, seed=1_000_000)}, "base.seed is 1000000, with 20 trials: give a smaller"),
    ({"guard": Guard(every=0)}, "guard.every is 0"),
    ({"guard": Guard(every=5, total_steps=0)}, "guard.total_steps 0"),
    ({"guard": Guard(every=7)}, "guard.every is 7"),
    ({"guard": Guard(every=5, total_steps=12)}, "guard.total_steps 12"),
    ({"guard": Guard(every=5, total_steps=10, reaches=1.5)}, "guard.reaches is 1.5"),
    ({"guard": Guard(scene="moon", every=5, total_steps=10)}, "guard.scene.*moon"),
]


@pytest.mark.parametrize(("changes", "message"), BAD, ids=[message[:40] for _, message in BAD])
def test_a_bad_sweep_is_refused(tiny_sweep, changes, message):
    with pytest.raises(UserError, match=message):
        spec.check(tiny_sweep(**changes))


def test_the_sweeps_that_are_committed_are_good(request):
    for path in sorted((request.config.rootpath / "experiments" / "sweeps").glob("*.py")):
        spec.check(spec.load(path))


FILES = [
    ("space = 1", "AttributeError"),
    ("sweep = 1", "sweep is a int: make it a jaxnav.sweep.Sweep"),
    ("import jaxnav.nothing\nsweep = 1", "line 1: ModuleNotFoundError"),
    ("\n\nsweep = 1 / 0", "line 3: ZeroDivisionError"),
    ("sweep = (", "SyntaxError"),
    ("from jaxnav.training.config import preset\nsweep = preset('fast')", "preset 'fast' is unknown"),
]


@pytest.mark.parametrize(("text", "message"), FILES)
def test_a_file_that_declares_none_is_refused(tmp_path, text, message):
    path = tmp_path / "bad.py"
    path.write_text(text)
    with pytest.raises(UserError, match=rf"bad.py.*{message}"):
        spec.load(path)
    with pytest.raises(UserError, match="is no file"):
        spec.load(tmp_path / "none.py")


def test_identity_is_json_and_tells_sweeps_apart(tiny_sweep):
    same = tiny_sweep().identity()
    assert json.loads(json.dumps(same)) == json.loads(json.dumps(tiny_sweep(trials=99, confirm=1, seeds=9).identity()))
    others = [
        {"space": {"hyper.tau": Range(0.1, 0.2)}}, {"sizes": {}}, {"rungs": (5,)}, {"keep": 0.5}, {"seed": 1},
        {"episodes": 9}, {"guard": None}, {"direction": "minimize"}, {"objective": spec.worst_success},
        {"base": dataclasses.replace(tiny_sweep().base, seed=3)},
    ]  # fmt: skip
    for changes in others:
        assert tiny_sweep(**changes).identity() != same, changes


def test_values_are_put_where_they_belong(tiny_sweep):
    sweep = tiny_sweep(sizes={"agent.actor_widths": ((8,), (8, 8))})
    config = sweep.configuration({"agent.actor_widths": (8, 8), "world.params.reward_request": 3.0})
    assert config.agent.actor_widths == (8, 8) and config.world.params.reward_request == 3.0
    assert config.world.scenes == ("square",) and sweep.base.agent.actor_widths == (16,)
    assert sweep.combinations == [{"agent.actor_widths": (8,)}, {"agent.actor_widths": (8, 8)}]
    assert sweep.own == ("reward_request",)
