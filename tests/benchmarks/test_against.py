"""The comparison with another checkout: pairs, ratios, what is refused. Nothing is measured."""

import importlib.util
import json
import pathlib
import sys

import pytest

ROOT = pathlib.Path(__file__).parents[2]


@pytest.fixture
def against(monkeypatch):
    """A function (*arguments) -> rows that it prints. This checkout takes 1, 2, 3 ... s, the other always 2 s."""
    spec = importlib.util.spec_from_file_location("against", ROOT / "benchmarks" / "against.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    module.started = []

    def run(checkout, python, command):
        ours = checkout == ROOT and python == sys.executable
        module.started.append("ours" if ours else "theirs")
        seconds = module.started.count("ours") if ours else 2
        if "train" not in command:
            row = {"name": "step", "episodes": 256, "rate_per_s": 1e6 / seconds}
            return "".join(json.dumps(row | {"noise": noise}) + "\n" for noise in (False, True))
        folder = pathlib.Path(command[command.index("--out") + 1])
        folder.mkdir()
        walls = [50.0, 60.0, *(60.0 + seconds * (i + 1) for i in range(3))]  # the first two compile
        lines = [{"wall_seconds": wall} for wall in walls] + [{"wall_seconds": 100.0, "evaluation": {}}]
        (folder / "metrics.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))
        return ""

    def call(*arguments):
        monkeypatch.setattr(sys, "argv", ["against.py", *arguments, "--json"])
        module.main()

    monkeypatch.setattr(module, "run", run)
    return module, call


def test_processes_alternate_and_ratios_are_of_pairs(against, capsys):
    module, call = against
    call(str(ROOT), "--python", "theirs", "--only", "step", "--pairs", "3")
    assert module.started == ["ours", "theirs", "theirs", "ours", "ours", "theirs"]
    rows = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [row["name"] for row in rows] == ["step, 256 episodes", "step, 256 episodes, noise"]
    assert [(row["ratio"], row["least"], row["most"]) for row in rows] == [(1.0, 0.5, 1.5)] * 2


def test_a_chunk_is_the_median_after_those_that_compile(against, capsys):
    _, call = against
    call(str(ROOT), "--python", "theirs", "--only", "chunk", "--pairs", "1")
    (row,) = map(json.loads, capsys.readouterr().out.splitlines())
    assert (row["name"], row["ratio"], row["pairs"]) == ("chunk", 0.5, 1)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [(["/nowhere"], "other is /nowhere: give the folder"), ([str(ROOT), "--pairs", "0"], "--pairs is 0: give")],
)
def test_what_is_no_comparison_is_refused(against, capsys, arguments, said):
    with pytest.raises(SystemExit, match="2"):
        against[1](*arguments)
    assert said in capsys.readouterr().err
