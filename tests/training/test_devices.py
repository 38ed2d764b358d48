"""One run on several devices and in several processes: the numbers of one, and what is refused.

A process has its devices from its start on, so that these trainings have processes of their own.
"""

import json
import os
import pathlib
import shutil
import signal
import socket
import subprocess
import sys

import jax
import numpy as np
import pytest

from jaxnav import cli
from jaxnav.errors import UserError
from jaxnav.training.config import run_from_json
from jaxnav.training.dataclass_json import to_json
from jaxnav.training.devices import SHARDS, Layout, layout_on
from jaxnav.training.run import Run

CHUNKS = 10  # of 10 updates each


def job(config, devices, copy=None, stop=None, distributed=False):
    return {
        "config": to_json(config), "devices": devices, "copy": copy and str(copy), "stop": stop,
        "distributed": distributed,
    }  # fmt: skip


def start(jobs, devices, **variables):
    """A process with that many virtual devices that trains these jobs."""
    command = [sys.executable, str(pathlib.Path(__file__).parent / "train_on_devices.py"), json.dumps(jobs)]
    flags = f"--xla_force_host_platform_device_count={devices}"
    environment = os.environ | {"XLA_FLAGS": flags} | variables
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment)


def results(*processes):
    """What each printed."""
    told = []
    try:
        for process in processes:
            out, err = process.communicate(timeout=600)
            assert process.returncode == 0, err
            told.append(json.loads(out.splitlines()[-1]))
    finally:
        for process in processes:
            process.kill()
    return told


def lines(folder):
    """metrics.jsonl as numpy `[lines, numbers]`, without what the clock says and what this file makes up."""
    metrics = Run.open(folder).files.metrics()
    names = metrics[0].keys() - {"wall_seconds", "success", "evaluation"}
    return np.array([[line[name] for name in sorted(names)] for line in metrics])


@pytest.fixture(scope="module")
def trained(tiny, tmp_path_factory):
    """(folder of ``one`` on one device and ``eight`` on eight, ``killed`` where the latter was in the middle, results).

    All have eight shards.
    """
    folder = tmp_path_factory.mktemp("devices")
    steps = CHUNKS * tiny().train.steps_per_chunk
    configs = [tiny(folder / name, total_steps=steps, evaluate_every=CHUNKS) for name in ("eight", "one")]
    jobs = [job(configs[0], 8, copy=folder / "killed"), job(configs[1], 1)]
    return folder, *results(start(jobs, 8))


def test_eight_devices_compute_what_one_does(trained):
    """Up to the order of sums: 100 updates, within 1e-4."""
    folder, _ = trained
    one, eight = lines(folder / "one"), lines(folder / "eight")
    assert len(one) == CHUNKS and np.isfinite(one).all()
    np.testing.assert_allclose(eight, one, rtol=1e-4)


def test_devices_add_up_and_tell_each_other_nothing_else(trained):
    """Gradients, metrics and counts are sums. Neither replay nor states leave their device, not as a sum either of what
    one has and zeros of all others: both have unsigned numbers and flags."""
    _, (eight, one) = trained
    assert eight["collectives"] == ["all-reduce f32", "all-reduce s32"]
    assert one["collectives"] == []


def test_shards_have_episodes_of_their_own(trained):
    """The eight don't repeat each other, and what a run is does not depend on who reads its folder."""
    run = Run.open(trained[0] / "eight")
    assert run.layout.shards == SHARDS
    states = run.restore().loop.states
    assert len(set(states.seed.tolist())) == run.config.train.episodes


@pytest.fixture(scope="module")
def joined(trained):
    """(folder, results) of two processes of two devices each that went on from ``killed``; the second was sent SIGTERM
    in the fourth of the five chunks that were left."""
    folder = trained[0] / "killed"
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    config = run_from_json(to_json(Run.open(folder).config) | {"resume": True})
    processes = [
        start(
            [job(config, 4, stop=stop, distributed=True)],
            2,
            JAX_COORDINATOR_ADDRESS=f"127.0.0.1:{port}",
            JAX_NUM_PROCESSES="2",
            JAX_PROCESS_ID=str(number),
        )
        for number, stop in ((0, None), (1, 4))
    ]
    return folder, [told for (told,) in results(*processes)]


def test_two_processes_go_on_with_what_eight_devices_began(trained, joined):
    one, two = lines(trained[0] / "one"), lines(joined[0])
    assert len(two) == CHUNKS - 1
    np.testing.assert_allclose(two, one[:-1], rtol=1e-4)


def test_a_signal_to_one_process_stops_all_after_the_same_chunk(joined):
    folder, told = joined
    assert [process["signal"] for process in told] == [signal.SIGTERM] * 2
    assert int(Run.open(folder).restore().loop.counter) == (CHUNKS - 1) * 5


def content(folder):
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.mark.parametrize(
    ("stored", "asked", "said"),
    [
        (1, 8, "holds a run of 1 shards, not of 8: leave --devices out to resume it"),
        (8, 1, "holds a run of 8 shards, not of 1: give --devices, 1 or more, to resume it"),
    ],
)
def test_resuming_with_another_number_of_shards_is_refused(finished, tmp_path, stored, asked, said):
    folder = tmp_path / "run"
    shutil.copytree(finished[0].folder, folder)
    told = json.loads((folder / "config.json").read_text())
    (folder / "config.json").write_text(json.dumps(told | {"shards": stored}))
    config = run_from_json(to_json(finished[0].config) | {"out": str(folder), "resume": True})
    before = content(folder)
    with pytest.raises(UserError, match=said):
        Run(config, Layout(asked)).prepare_folder()
    assert content(folder) == before


def test_a_run_from_before_there_were_shards_has_one(finished, tmp_path):
    told = json.loads((finished[0].folder / "config.json").read_text())
    assert told.pop("shards") == 1
    (tmp_path / "config.json").write_text(json.dumps(told))
    assert Run.open(tmp_path).layout == Layout()


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--devices", "3"], "--devices is 3: give 1, 2, 4 or 8, which part the 8 shards"),
        (["--devices", "-1"], "--devices is -1: give 1, 2, 4 or 8"),
        (["--devices", "16"], "--devices is 16: give 1, 2, 4 or 8"),
        (["--devices", "8"], "--devices is 8: there are {} cpu devices: give at most {}, or set XLA_FLAGS=--xla_force"),
        (["--devices", "1", "--train.episodes", "12"], "train.episodes is 12: give a multiple of 8"),
        (["--devices", "1", "--agent.batch", "100"], "agent.batch is 100: give a multiple of 8"),
        (["--distributed"], "--distributed needs --devices"),
        (["--distributed", "--devices", "1"], "--distributed finds no other processes"),
    ],
)
def test_what_cannot_be_done_is_one_line_and_nothing_is_written(capsys, tmp_path, monkeypatch, arguments, said):
    monkeypatch.chdir(tmp_path)
    if "--distributed" in arguments and "--devices" in arguments:  # only a process without devices can join others
        done = subprocess.run(
            [sys.executable, "-m", "jaxnav.cli", "train", *arguments], capture_output=True, text=True, cwd=tmp_path
        )
        code, out, err = done.returncode, done.stdout, done.stderr
    else:
        with pytest.raises(SystemExit) as stop:
            cli.main(["train", *arguments])
        code, (out, err) = stop.value.code, capsys.readouterr()
    assert (code, out) == (2, "")
    assert err.startswith("error: " + said.format(*[jax.device_count()] * 2)) and err.count("\n") == 1, err
    assert list(tmp_path.iterdir()) == []


def test_no_devices_are_the_program_of_before():
    assert layout_on(0) == Layout(shards=1, mesh=None)
