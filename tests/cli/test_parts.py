"""Parts that are named wrongly, from the command line: one line with field, value and remedy, and exit code 2."""

import re

import pytest

from jaxnav import cli

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
        (["--scene", "mine.py:NUMBER"], ["'mine.py:NUMBER'", "is a int, not a Scene", "choose from YARD"]),
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
