"""Every program of experiments/: its help, and that what documents call it is what starts it."""

import importlib
import importlib.util
import pathlib
import re

import pytest

ROOT = pathlib.Path(__file__).parents[2]
PROGRAMS = [
    *(f"tables.{name}" for name in ("table1", "table2", "table3", "tuning")),
    *(f"language.{name}" for name in ("understanding", "held_out_patterns")),
    *(f"planning.{name}" for name in ("plan_by_gradient", "value_of_dialogue")),
    "exporting.exported", "crossflow", "people", "robustness", "tricks", "calibrate_pedestrians",
]  # fmt: skip


@pytest.mark.parametrize("program", PROGRAMS)
def test_help_names_the_command_and_its_options(program, capsys):
    module = importlib.import_module(f"experiments.{program}")
    assert f"python -m experiments.{program} --help" in module.__doc__
    with pytest.raises(SystemExit) as stop:
        module.main(["--help"])
    printed = capsys.readouterr().out
    assert not stop.value.code and f"python -m experiments.{program}" in re.sub(r"\s+", " ", printed)


def test_documents_name_programs_that_exist():
    files = [ROOT / "README.md", *ROOT.glob("docs/*.md"), *ROOT.glob("experiments/*.md")]
    named = {name for file in files for name in re.findall(r"python -m experiments\.([\w.]+)", file.read_text())}
    assert named and named <= set(PROGRAMS)
    written = {path.relative_to(ROOT / "experiments").with_suffix("") for path in ROOT.glob("experiments/**/*.py")
               if re.search(r'^if __name__ == "__main__"', path.read_text(), re.MULTILINE)}  # fmt: skip
    assert {".".join(path.parts) for path in written} == set(PROGRAMS)
    for file in files:
        for path in re.findall(r"`((?:experiments|benchmarks)/[\w/]+\.py)`", file.read_text()):
            assert (ROOT / path).exists(), f"{file.name} names {path}"
