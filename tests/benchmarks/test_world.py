"""The command line of benchmarks/world.py: what is refused before anything is measured."""

import importlib.util
import pathlib
import sys

import pytest

FILE = pathlib.Path(__file__).parents[2] / "benchmarks" / "world.py"


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ("--only step --plot x.png", "--plot is x.png: only crowd is drawn; give --only crowd"),
        ("--seconds nan", "--seconds is nan: give a finite number above 0"),
        ("--seconds 0", "--seconds is 0.0"),
        ("--seconds -1", "--seconds is -1.0"),
        ("--seconds inf", "--seconds is inf"),
        ("--episodes 0", "--episodes is 0: give a whole number of at least 1"),
        ("--only crowd --episodes 64", "--episodes is 64: leave it out, crowd has numbers of its own"),
        ("--only map --episodes 64", "--episodes is 64: leave it out, map has"),
    ],
)
def test_options_that_say_nothing_are_refused(arguments, said, monkeypatch, capsys):
    spec = importlib.util.spec_from_file_location("benchmark_of_the_world", FILE)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    monkeypatch.setattr(module, "benchmarks", lambda arguments: pytest.fail("it measures"))
    monkeypatch.setattr(sys, "argv", ["world.py", *arguments.split()])
    with pytest.raises(SystemExit, match="2"):
        module.main()
    assert said in capsys.readouterr().err
