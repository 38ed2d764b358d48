"""What can be wrong on a command line ends in one line with field, value and remedy, and exit code 2; and help."""

import os
import pathlib
import re
import subprocess
import sys

import pytest

from jaxnav import cli
from jaxnav.cli.train import _check_algorithm
from jaxnav.errors import UserError
from jaxnav.training.config import HSACHyperparameters, HSACRunConfig, TrainConfig
from jaxnav.world import Params, WorldConfig

from .conftest import fails


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["trian"], ["'trian'", "train, sweep, evaluate, compare, render"]),
        (["--seed", 1], ["'--seed'", "train, sweep, evaluate, compare, render"]),
        (["train", "--preset", "fast"], ["preset", "'fast'", "quick, robust, lidar, grid"]),
        (["train", "--preset=fast"], ["preset", "'fast'", "quick, robust, lidar, grid"]),
        (["train", "--scene", "moon"], ["scene", "'moon'", "square, hallway, crosswalk"]),
        (["train", "--world.scenes", "moon"], ["scene", "'moon'", "square, hallway, crosswalk"]),
        (["train", "--algo", "dqn"], ["algo", "'dqn'", "hsac, td3, ppo, a2c"]),
        (["train", "--algo", "td3", "--agent.requests", 2], ["--agent.requests: td3 has no", "give --algo hsac"]),
        (["train", "--agent.horizon=5"], ["--agent.horizon: hsac has no", "give --algo ppo or a2c"]),
        (["train", "--algo=ppo", "--hyper.target_noise", 1], ["--hyper.target_noise: ppo has no", "give --algo td3"]),
        (["train", "--agent.wings", 1], ["Unrecognized", "--agent.wings", "--help"]),
        (["train", "--algo", "ppo", "--agent.horizon", 30], ["agent.horizon", "30", "train.steps_per_chunk", "25"]),
        (["train", "--algo", "ppo", "--agent.minibatches", 7], ["agent.minibatches", "7", "divisor", "1600"]),
        (["train", "--algo", "ppo", "--hyper.gae-lambda", 2], ["hyper.gae_lambda", "2", "0 to 1"]),
        (["train", "--agent.requests", 3], ["agent.requests", "3", "1, 2, 4"]),
        (["train", "--agent.heads", "two"], ["agent.heads", "'two'", "shared, per-request"]),
        (["train", "--agent.encoder", "grid"], ["world.observation", "pedestrian_map, sensor_map", "grid encoder"]),
        (["train", "--world.randomise", "sped", 0, 1], ["world.randomise", "'sped'", "fields of world.params"]),
        (["train", "--world.randomise", "compliance", 1, 0], ["world.randomise", "compliance", "lower end first"]),
        (["train", "--agent.encoder", "cnn"], ["agent.encoder", "'cnn'", "lidar"]),
        (["train", "--wings", 2], ["--wings", "--help"]),
        (["train", "square"], ["square", "--help"]),
        (["train", "--seed", "x"], ["--seed", "'x'"]),
        (["train", "--seed", -1], ["seed", "-1", "from 0 to"]),
        (["train", "--seed"], ["--seed"]),
        (["train", "--world.pedestrians", 17], ["world.pedestrians", "17", "hallway", "16"]),
        (["train", "--world.beams", -3], ["world.beams", "-3", "at least 2"]),
        (["train", "--world.params.body-radius", "nan"], ["world.params.body_radius", "nan", "give a number"]),
        (["train", "--world.params.robot-radius", -0.1], ["world.params.robot_radius", "-0.1", "above 0"]),
        (["train", "--world.params.compliance", 1.5], ["world.params.compliance", "1.5", "0 to 1"]),
        (["train", "--world.observation", "scan"], ["world.observation", "dialogue", "pedestrians"]),
        (["train", "--world.reward", "gold"], ["world.reward", "'gold'", "authors-code", "paper-text"]),
        (["train", "--hyper.discount", 2], ["hyper.discount", "2", "0 to 1"]),
        (["train", "--train.total-steps", 7], ["train.total_steps", "7", "multiple of train.steps_per_chunk"]),
        (["train", "--train.checkpoint-seconds", "nan"], ["train.checkpoint_seconds", "nan"]),
        (["evaluate"], ["run's folder"]),
        (["evaluate", "no/where"], ["no/where", "holds no run"]),
        (["evaluate", "x", "--episodes", 0], ["--episodes", "0", "from 1"]),
        (["evaluate", "x", "--seed", -1], ["--seed", "-1", "from 0"]),
        (["evaluate", "x", "--policy", "worst"], ["--policy", "'worst'", "one of last, best"]),
        (["evaluate", __file__], ["holds no run"]),
        (["render", "no/where"], ["no/where", "holds no run"]),
        (["render", "x", "--seed", 2**32], ["--seed", str(2**32), "from 0"]),
    ],
    ids=lambda value: " ".join(map(str, value))[:60],
)  # fmt: skip
def test_what_cannot_be_done_is_one_line_and_exit_code_2(capsys, tmp_path, monkeypatch, arguments, said):
    monkeypatch.chdir(tmp_path)
    error = fails(capsys, *arguments)
    assert all(word in error for word in said), error
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("encoding", ["utf-8", "ascii"])
def test_a_process_ends_with_that_line_too(tmp_path, encoding):
    """In every terminal: what the parser of options draws in boxes or, where there are none, in ASCII."""
    for arguments, said in (
        (["--scene", "moon"], "scene 'moon' is unknown: choose"),
        (["--train.episodes", "0"], "train.episodes is 0: give a whole number of at least 1"),
    ):
        command = [sys.executable, "-m", "jaxnav.cli", "train", *arguments]
        environment = os.environ | {"PYTHONIOENCODING": encoding}
        done = subprocess.run(command, capture_output=True, text=True, env=environment, cwd=tmp_path)
        assert (done.returncode, done.stdout) == (2, "")
        assert re.fullmatch(rf"error: {said}[^\n]+\n", done.stderr), done.stderr
    assert list(tmp_path.iterdir()) == []


def options_of(cls):
    return {name.replace("_", "-") for name in cls.__dataclass_fields__}


@pytest.mark.parametrize(
    ("command", "options"),
    [
        (
            "train",
            {"preset", "algo", "scene", "seed", "out", "resume"}
            | {f"world.{name}" for name in options_of(WorldConfig)}
            | {f"world.params.{name}" for name in options_of(Params)}
            | {f"agent.{name}" for name in options_of(HSACRunConfig().agent)}
            | {f"hyper.{name}" for name in options_of(HSACHyperparameters)}
            | {f"train.{name}" for name in options_of(TrainConfig)},
        ),
        ("evaluate", {"episodes", "seed", "scene", "policy", "json"}),
        ("render", {"seed", "policy"}),
    ],
)
def test_help_tells_of_every_option(capsys, command, options):
    with pytest.raises(SystemExit) as stop:
        cli.main([command, "--help"])
    assert stop.value.code == 0
    shown = set(re.findall(r"--([a-z][\w.-]*)", capsys.readouterr().out))
    assert options <= shown


@pytest.mark.parametrize("arguments", [["--help"], ["-h"]])
def test_help_tells_of_every_command(capsys, arguments):
    with pytest.raises(SystemExit) as stop:
        cli.main(arguments)
    assert stop.value.code == 0
    out = capsys.readouterr().out
    assert all(f"\n  {command} " in out for command in ("train", "evaluate", "render"))


def test_the_last_preset_counts_like_the_last_of_every_option(capsys):
    assert "scene 'moon'" in fails(capsys, "train", "--preset", "fast", "--preset", "quick", "--scene", "moon")
    assert "preset 'fast'" in fails(capsys, "train", "--preset", "quick", "--preset=fast", "--scene", "moon")


def test_there_has_to_be_a_run_to_resume(capsys, tmp_path):
    error = fails(capsys, "train", "--resume", "--out", tmp_path / "run")
    assert "holds no run to resume" in error
    assert list(tmp_path.iterdir()) == []


FILE = """
import dataclasses
from jaxnav.world import SCENES

YARD = dataclasses.replace(SCENES["square"], name="yard")
AGAIN = dataclasses.replace(SCENES["hallway"], name="yard")
SQUARE = dataclasses.replace(SCENES["hallway"], name="square")
NUMBER = 3


def no_terms():
    return {}
"""
BAD = """
raise ValueError("no\\nroof")
"""


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--scene", "no.py:YARD"], ["world.scenes is 'no.py:YARD'", "give an existing file"]),
        (["--scene", "bad.py:YARD"], ["world.scenes is 'bad.py:YARD'", "line 2", "ValueError (no roof)", "mend"]),
        (["--scene", "mine.py:NUMBER"], ["'mine.py:NUMBER'", "of type int, not a Scene", "choose from YARD"]),
        (["--scene", "mine.py:SHED"], ["'mine.py:SHED'", "no SHED in it", "choose from YARD"]),
        (["--scene", "mine.py"], ["'mine.py'", "no NAME", "choose from YARD"]),
        (["--scene", "mine.py:YARD,mine.py:AGAIN"], ["world.scenes", "'yard'", "each once"]),
        (["--scene", "mine.py:SQUARE"], ["'square'", "a name of its own"]),
        (["--scene", "moon"], ["scene 'moon' is unknown", "file.py:NAME"]),
        (["--world.people", "ghosts"], ["world.people", "'ghosts'", "orca"]),
        (["--world.people", "mine.py:NUMBER"], ["world.people is 3", "has no step", "PedestrianModel"]),
        (["--world.reward", "gold"], ["world.reward", "'gold'", "authors-code"]),
        (["--world.reward", "mine.py:no_terms"], ["world.reward is no_terms", "(StepEvents, Params) -> dict"]),
        (["--agent.encoder", "cnn"], ["agent.encoder", "'cnn'", "lidar"]),
        (["--agent.encoder", "mine.py:NUMBER"], ["agent.encoder", "mine.py:NUMBER", "not an Encoder"]),
        (["--algo", "dqn"], ["algo", "'dqn'", "hsac"]),
        (["--algo", "mine.py:NUMBER"], ["algo is 'mine.py:NUMBER'", "register_learner"]),
    ],
    ids=lambda value: " ".join(value)[:50],
)  # fmt: skip
def test_a_part_that_is_none_is_one_line(capsys, tmp_path, monkeypatch, arguments, said):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.py").write_text(FILE)
    (tmp_path / "bad.py").write_text(BAD)
    with pytest.raises(SystemExit) as stop:
        cli.main(["train", *arguments])
    out, error = capsys.readouterr()
    assert (stop.value.code, out) == (2, "")
    assert re.fullmatch(r"error: [^\n]+\n", error), error
    assert all(word in error for word in said), error
    assert sorted(path.name for path in tmp_path.iterdir() if path.suffix == ".py") == ["bad.py", "mine.py"]
    assert not (tmp_path / "runs").exists()


def test_a_learner_of_ones_own_takes_options_that_others_have_too():
    recipe = pathlib.Path(__file__).parents[2] / "docs" / "recipes" / "learner.py"
    _check_algorithm(["--agent.batch", "64", "--hyper.epsilon", "0.2"], f"{recipe}:DQN")
    with pytest.raises(UserError, match=r"--agent.heads: .*:DQN has no such option; .* --algo hsac"):
        _check_algorithm(["--agent.heads", "shared"], f"{recipe}:DQN")
