"""jaxnav sweep and train --from-sweep as users meet them: a kill, a report, a winner, and what one can get wrong."""

import dataclasses
import json
import os
import pathlib
import signal
import subprocess
import sys
import time

import pytest

from jaxnav import cli
from jaxnav.errors import UserError
from jaxnav.sweep import search
from jaxnav.sweep.folder import winner
from jaxnav.sweep.store import Store

from ..sweep.conftest import SWEEP, MadeUp

FILE = """
import dataclasses
from tests.sweep.conftest import SWEEP
sweep = dataclasses.replace(SWEEP, sizes={}, guard=None, confirm=0)
"""


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "small.py"
    path.write_text(FILE)
    return path


@pytest.fixture
def made_up_engine(monkeypatch):
    monkeypatch.setattr("jaxnav.sweep.engines.Local", MadeUp)


def call(capsys, *arguments):
    """(exit status, standard output, standard error) of a command."""
    code = 0
    try:
        cli.main([str(argument) for argument in arguments])
    except SystemExit as stop:
        code = stop.code
    return code, *capsys.readouterr()


def numbers(folder, name="small"):
    return [(t.number, t.state, t.values, t.seed, t.objective) for t in Store(folder, name).trials("search")]


def test_a_sweep_killed_in_the_middle_goes_on_and_loses_nothing(tmp_path, file):
    """kill -9 of the real thing: then the store holds what a sweep left alone finds, and the summary all of it."""
    folder, root = tmp_path / "sweep", pathlib.Path(__file__).parents[2]
    command = [sys.executable, "-m", "jaxnav.cli", "sweep", str(file), "--out", str(folder), "--trials", "9"]
    environment = os.environ | {"PYTHONPATH": str(root)}
    process = subprocess.Popen(command, env=environment, stderr=subprocess.DEVNULL)
    while process.poll() is None:  # until some rounds are in the store
        store = folder / "store.log"
        if store.exists() and store.read_text().count('"round 0000') >= 4:
            process.send_signal(signal.SIGKILL)
            break
        time.sleep(0.05)
    assert process.wait() == -signal.SIGKILL
    assert any(state == "running" for _, state, *_ in numbers(folder))
    done = subprocess.run([*command, "--resume"], env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    whole = subprocess.run([*command[:-3], tmp_path / "whole", *command[-2:]], env=environment, capture_output=True)
    assert whole.returncode == 0
    found = numbers(folder)
    assert found == numbers(tmp_path / "whole") and [number for number, *_ in found] == list(range(9))
    counts = json.loads((folder / "summary.json").read_text())["counts"]["search"]
    assert counts["asked"] == counts["begun"] == 9 and counts["running"] == 0
    assert "# " in done.stdout and (folder / "summary.png").stat().st_size > 10_000


def test_what_it_prints_is_rebuilt_by_report(tmp_path, file, capsys, made_up_engine):
    code, first, progress = call(capsys, "sweep", file, "--out", tmp_path / "sweep", "--trials", 12, "--seed", 3)
    assert code == 0 and "12 of 12 trials ended" in progress
    for name in ("summary.md", "summary.json", "summary.png"):
        (tmp_path / "sweep" / name).unlink()
    code, second, _ = call(capsys, "sweep", "--report", tmp_path / "sweep")
    assert code == 0 and second == first == (tmp_path / "sweep" / "summary.md").read_text()


def test_a_winner_becomes_a_run(tmp_path, file, capsys, made_up_engine):
    folder = tmp_path / "sweep"
    assert call(capsys, "sweep", file, "--out", folder, "--trials", 12)[0] == 0
    best = json.loads((folder / "summary.json").read_text())["winner"]["values"]
    config = winner(folder)
    assert config.hyper.actor_lr == best["hyper.actor_lr"]
    assert config.world.params.reward_request == best["world.params.reward_request"]
    assert config.agent == SWEEP.base.agent and config.world.scenes == ("square",)
    assert dataclasses.replace(config.train, checkpoint_seconds=0.0) == SWEEP.base.train
    code, _, error = call(capsys, "train", "--from-sweep", folder, "--hyper.tau", "2", "--out", tmp_path / "run")
    assert code == 2 and error.startswith("error: hyper.tau is 2.0")
    code, _, error = call(capsys, "train", "--from-sweep", folder, "--preset", "lidar")
    assert code == 2 and error == f"error: --preset is lidar beside --from-sweep {folder}: give one of the two\n"


def test_an_unfinished_sweep_has_no_winner(tmp_path, file, capsys, monkeypatch):
    class Stopped(MadeUp):
        def advance(self, jobs, done=lambda: None):
            raise KeyboardInterrupt

    monkeypatch.setattr("jaxnav.sweep.engines.Local", Stopped)
    code, _, error = call(capsys, "sweep", file, "--out", tmp_path / "sweep")
    assert code == 130 and f"jaxnav sweep {file} --out {tmp_path / 'sweep'} --resume goes on" in error
    with pytest.raises(UserError, match="it isn't done: go on with jaxnav sweep FILE --resume"):
        winner(tmp_path / "sweep")
    assert call(capsys, "sweep", "--report", tmp_path / "sweep")[0] == 0
    with pytest.raises(UserError, match="has no winner yet"):
        winner(tmp_path / "sweep")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["sweep"], "give the Python file that declares a sweep"),
        (["sweep", "none.py"], "none.py is no file"),
        (["sweep", "FILE", "--trials", "0"], "trials is 0: give a whole number of at least 1"),
        (["sweep", "FILE", "--members", "many"], "members"),
        (["sweep", "FILE", "--base.hyper.tau", "2"], "hyper.tau is 2.0"),
        (["sweep", "FILE", "--engine", "slurm"], "engine"),
        (["sweep", "FILE", "--address", "auto"], "--address is auto with --engine local: give --engine ray"),
        (["sweep", "FILE", "--engine", "ray", "--address", "127.0.0.1:9"], "no Ray cluster answers there"),
        (["sweep", "FILE", "--resume"], "holds no sweep: --resume starts nothing"),
        (["sweep", "FILE", "--storage", "trials"], "--storage is 'trials': give the URL of a database"),
        (["sweep", "FILE", "--storage", "mysql://nobody@127.0.0.1:9/x"], "can't be used"),
        (["sweep", "--report", "nowhere"], "nowhere holds no sweep: give the folder of one"),
        (["sweep", "FILE", "--report", "nowhere"], "--report is nowhere beside other options"),
        (["sweep", "--trials", "4", "FILE"], "give the Python file that declares a sweep, before all options"),
        (["train", "--from-sweep", "nowhere"], "nowhere holds no sweep"),
    ],
)
def test_what_one_can_get_wrong(tmp_path, file, capsys, monkeypatch, arguments, message):
    monkeypatch.chdir(tmp_path)
    code, out, error = call(capsys, *[file if argument == "FILE" else argument for argument in arguments])
    assert code == 2 and out == ""
    assert error.startswith("error: ") and error.count("\n") == 1 and message in error
    assert list(tmp_path.iterdir()) == [file]


def test_a_folder_is_not_taken_from_what_is_in_it(tmp_path, file, capsys, made_up_engine):
    folder = tmp_path / "sweep"
    assert call(capsys, "sweep", file, "--out", folder, "--trials", 4)[0] == 0
    before = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    wrong = [
        (["--out", folder], "already holds a sweep: go on with --resume"),
        (["--out", folder, "--resume", "--seed", 9], "holds another sweep (identity.seed differ)"),
        (["--out", folder, "--resume", "--storage", f"sqlite:///{tmp_path}/x.db"], "another sweep (storage differ)"),
        (["--out", tmp_path], "is not an empty folder"),
        (["--out", file], "is not an empty folder"),
    ]
    for arguments, message in wrong:
        code, _, error = call(capsys, "sweep", file, *arguments)
        assert code == 2 and message in error
    assert before == {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    assert not (tmp_path / "x.db").exists()


def test_a_database_keeps_sweeps_apart(tmp_path, file, capsys, made_up_engine):
    url, found = f"sqlite:///{tmp_path}/trials.db", []
    for folder, trials in ((tmp_path / "a", 4), (tmp_path / "b", 5)):  # two people's, say
        assert call(capsys, "sweep", file, "--out", folder, "--trials", trials, "--storage", url)[0] == 0
        kept = json.loads((folder / "sweep.json").read_text())
        found.append(len(Store(folder, kept["studies"], url).trials("search")))
        assert not (folder / "store.log").exists()
    assert found == [4, 5]
    assert call(capsys, "sweep", file, "--out", folder, "--trials", 6, "--storage", url, "--resume")[0] == 0
    assert len(Store(folder, kept["studies"], url).trials("search")) == 6


def test_a_store_of_another_sweep_is_refused(tmp_path, file, capsys, made_up_engine):
    for name, seed in (("a", 0), ("b", 9)):
        assert call(capsys, "sweep", file, "--out", tmp_path / name, "--trials", 4, "--seed", seed)[0] == 0
    (tmp_path / "a" / "store.log").rename(tmp_path / "b" / "store.log")
    code, _, error = call(capsys, "sweep", file, "--out", tmp_path / "b", "--trials", 5, "--seed", 9, "--resume")
    assert code == 2 and "store.log is of another sweep (seed differ): give the same values to go on" in error


def test_a_file_that_was_renamed_is_another_sweep(tmp_path, file, capsys, made_up_engine):
    folder = tmp_path / "sweep"
    assert call(capsys, "sweep", file, "--out", folder, "--trials", 4)[0] == 0
    code, _, error = call(capsys, "sweep", file.rename(tmp_path / "other.py"), "--out", folder, "--resume")
    assert code == 2 and "holds another sweep (name differ)" in error


def test_a_sweep_is_run_by_one_process_at_a_time(tmp_path, file, capsys, monkeypatch):
    folder, errors = tmp_path / "sweep", []

    class Second(MadeUp):
        def advance(self, jobs, done=lambda: None):
            if not errors:
                errors.append("")
                code, _, errors[0] = call(capsys, "sweep", file, "--out", folder, "--resume")
                assert code == 2
            return super().advance(jobs, done)

    monkeypatch.setattr("jaxnav.sweep.engines.Local", Second)
    assert call(capsys, "sweep", file, "--out", folder)[0] == 0
    assert "is the sweep of a process that still runs: stop it first" in errors[0]


def test_a_winner_of_before_is_none_of_now(tmp_path, file, capsys, monkeypatch, made_up_engine):
    folder = tmp_path / "sweep"
    assert call(capsys, "sweep", file, "--out", folder, "--trials", 12)[0] == 0

    def stopped(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(MadeUp, "advance", stopped)
    code, _, error = call(capsys, "sweep", file, "--out", folder, "--trials", 20, "--resume")
    assert code == 130 and f"jaxnav sweep {file} --out {folder} --trials 20 --resume goes on" in error
    with pytest.raises(UserError, match="has no winner yet"):
        winner(folder)


def test_a_full_disk_is_said_and_mended(tmp_path, file, capsys, monkeypatch, made_up_engine):
    from optuna.storages.journal import JournalFileBackend

    inner, left = JournalFileBackend.append_logs, [40]

    def full(self, logs):
        left[0] -= 1
        if left[0] < 0:
            with open(self._file_path, "ab") as store:
                store.write(b'{"op_code": 5, "work')  # what still fitted
            raise OSError(28, "No space left on device")
        return inner(self, logs)

    folder = tmp_path / "sweep"
    with monkeypatch.context() as patch:
        patch.setattr(JournalFileBackend, "append_logs", full)
        code, _, error = call(capsys, "sweep", file, "--out", folder)
    last = error.splitlines()[-1]
    assert code == 2 and "store.log can't be written (No space left on device): free some space, then go on" in last
    assert call(capsys, "sweep", file, "--out", folder, "--resume")[0] == 0
    (tmp_path / "whole").mkdir()
    sweep = dataclasses.replace(SWEEP, sizes={}, guard=None, confirm=0)
    search.run(sweep, tmp_path / "whole", Store(tmp_path / "whole", "small"), MadeUp())
    assert numbers(folder) == numbers(tmp_path / "whole")
