"""The smallest run that the command line has trained, and how the tests call commands."""

import pathlib
import re
import subprocess
import sys

import pytest

from jaxnav import cli

# The smallest run worth interrupting: 12 chunks, each evaluated and saved.
SIZES = {
    "scene": "square", "world.beams": 16, "world.params.max-steps": 12, "agent.actor-widths": 16,
    "agent.critic-widths": 16, "agent.batch": 32, "agent.updates-per-step": 2, "train.episodes": 16,
    "train.replay-rows": 20, "train.steps-per-chunk": 5, "train.total-steps": 60, "train.evaluate-every": 1,
    "train.checkpoint-seconds": 0,
}  # fmt: skip


def sized(**changes):
    sizes = SIZES | {name.replace("__", "."): value for name, value in changes.items()}
    return [word for name, value in sizes.items() for word in (f"--{name}", str(value))]


@pytest.fixture(scope="session")
def jaxnav():
    """Runs the command in a process of its own."""

    def run(*arguments, **options):
        command = [sys.executable, "-m", "jaxnav.cli", *map(str, arguments)]
        return subprocess.run(command, capture_output=True, text=True, timeout=240, **options)

    return run


@pytest.fixture(scope="session")
def trained(jaxnav, tmp_path_factory):
    """(folder, what was printed) of a run that nothing disturbed."""
    folder = tmp_path_factory.mktemp("trained") / "run"
    done = jaxnav("train", *sized(), "--out", folder)
    assert done.returncode == 0, done.stderr
    return folder, done


def content(folder):
    """{path: bytes} of all files, None of folders."""
    paths = sorted(pathlib.Path(folder).rglob("*"))
    return {str(path.relative_to(folder)): path.read_bytes() if path.is_file() else None for path in paths}


def fails(capsys, *arguments):
    """The one line on stderr with which a command ends that can't be done; nothing on stdout, exit code 2."""
    with pytest.raises(SystemExit) as stop:
        cli.main(list(map(str, arguments)))
    out, err = capsys.readouterr()
    assert stop.value.code == 2
    assert out == ""
    assert re.fullmatch(r"error: [^\n]+\n", err), err
    return err
