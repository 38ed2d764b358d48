"""jaxnav train from outside: its folder, and how it ends when it is interrupted, diverges or finds no room."""

import json
import re
import shutil
import signal
import subprocess
import sys

import jax
import numpy as np

from jaxnav.training.run import Run

from .conftest import content, fails, sized


def test_training_fills_its_folder_and_says_so(trained):
    folder, done = trained
    names = {
        "config.json", "metrics.jsonl", "checkpoints", "evaluation.json", "trajectories.png", "episode.gif",
        "learning_curve.png", "bundle",
    }  # fmt: skip
    assert {path.name for path in folder.iterdir()} == names
    assert str(folder) in done.stdout.splitlines()[-1]
    assert all(name in done.stdout for name in names - {"checkpoints"})
    # Not on a terminal: a line for each evaluation, with what remains to be done.
    progress = done.stderr.splitlines()[-12:]
    assert all(re.match(r" *\d+%  .*success square [\d.]+, \d+ s left$", line) for line in progress), done.stderr
    assert progress[-1].startswith("100%")
    result = json.loads((folder / "evaluation.json").read_text())
    assert (result["policy"], result["episodes"], result["seed"]) == ("last", 500, 0)


class Interruptible:
    """A training process whose lines on stderr are read as they come."""

    def __init__(self, *arguments):
        command = [sys.executable, "-m", "jaxnav.cli", "train", *map(str, arguments)]
        self.process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)

    def stop(self, number, chunks):
        """Send the signal once ``chunks`` lines of progress were printed; (exit code, what was printed after)."""
        seen = 0
        while seen < chunks:
            line = self.process.stderr.readline()
            assert line, "ended too early"
            seen += "%  " in line
        self.process.send_signal(number)
        rest = self.process.communicate()[1]
        return self.process.returncode, rest


def test_a_run_interrupted_in_every_way_ends_like_one_never_touched(jaxnav, trained, tmp_path):
    """kill -9, Ctrl-C and SIGTERM, each followed by --resume: the same parameters and the same lines, bit for bit."""
    folder = tmp_path / "run"
    arguments = [*sized(), "--out", folder]
    code, rest = Interruptible(*arguments).stop(signal.SIGKILL, chunks=3)
    assert code == -signal.SIGKILL
    for number, code in ((signal.SIGINT, 130), (signal.SIGTERM, 143)):
        saved = Run.open(folder)
        stopped, rest = Interruptible(*arguments, "--resume").stop(number, chunks=2)
        assert stopped == code
        assert "Traceback" not in rest
        assert f"--resume --out {folder}" in rest
        # What was saved is what the last line tells of: nothing is lost.
        lines = saved.files.metrics()
        assert int(saved.restore().loop.counter) * 16 == lines[-1]["env_steps"]
    assert not (folder / "evaluation.json").exists()
    done = jaxnav("train", *arguments, "--resume")
    assert done.returncode == 0, done.stderr

    whole, resumed = (Run.open(path) for path in (trained[0], folder))
    a, b = whole.files.metrics(), resumed.files.metrics()
    assert len(a) == 12
    for line in (*a, *b):
        assert line.pop("wall_seconds") > 0
    assert a == b
    for (path, x), y in zip(
        jax.tree_util.tree_leaves_with_path(whole.restore()), jax.tree.leaves(resumed.restore()), strict=True
    ):
        if jax.numpy.issubdtype(x.dtype, jax.dtypes.prng_key):
            x, y = jax.random.key_data(x), jax.random.key_data(y)
        np.testing.assert_array_equal(x, y, err_msg=jax.tree_util.keystr(path))


def test_a_loss_that_turns_non_finite_stops_the_run(jaxnav, tmp_path):
    folder = tmp_path / "a [bold]run[/b] of mine"
    done = jaxnav("train", *sized(), "--hyper.critic-lr", 1e38, "--out", folder)
    assert done.returncode == 2
    assert "Traceback" not in done.stderr
    error = done.stderr.splitlines()[-1]
    assert re.match(r"error: .*critic_loss.* turned non-finite by step 5 .*lower .*hyper.critic.lr", error), error
    assert f"training in {folder} (preset quick, seed 0); the first chunk compiles" in done.stderr.splitlines()
    assert not (folder / "evaluation.json").exists()


def test_a_folder_that_holds_a_run_is_not_touched(capsys, trained):
    folder, _ = trained
    before = content(folder)
    assert "already holds a run" in fails(capsys, "train", *sized(), "--out", folder)
    assert "another hyper.tau:" in fails(capsys, "train", *sized(hyper__tau=0.5), "--resume", "--out", folder)
    assert "scene 'moon' is unknown" in fails(capsys, "evaluate", folder, "--scene", "moon")
    assert content(folder) == before


def test_a_disk_that_fills_up_is_one_line_and_the_older_checkpoints_stay(trained, tmp_path):
    """No file may grow beyond 40 kB, which the checkpoints of this run do: writing fails like on a full disk."""
    folder = tmp_path / "run"
    code = (
        "import resource, signal, sys, jaxnav.cli as cli;"
        "signal.signal(signal.SIGXFSZ, signal.SIG_IGN);"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (40_000, 40_000));"
        "cli.main(sys.argv[1:])"
    )
    shutil.copytree(trained[0], folder)
    shutil.rmtree(folder / "checkpoints" / "step_60")
    command = [sys.executable, "-c", code, "train", *sized(), "--resume", "--out", str(folder)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=240)
    assert done.returncode == 2, done.stderr
    assert "Traceback" not in done.stderr
    error = done.stderr.splitlines()[-1]
    assert re.match(
        r"error: \S+/checkpoints could not take the checkpoint of step 60 \(.+\): .*go on with --resume", error
    )
    assert int(Run.open(folder).restore().loop.counter) == 55
