"""What a Jetson has - Python 3.6, torch 1.10.2, numpy 1.19.5, onnxruntime 1.10.0 - with the same bundles.

The environment is made by python36.sh beside this file; without a Python 3.6, or what the script downloads, nothing of
this is checked, and the tests say so.
"""

import os
import pathlib
import re
import shutil
import subprocess

import numpy as np
import pytest

from jaxnav.export import formats
from jaxnav.export.verify import run_policy

NAMES = ("lidar", "approach", "grid", "frozen", "td3", "ppo")


def _python36():
    """A Python 3.6 that runs; None if there is none."""
    pyenv = pathlib.Path(os.environ.get("PYENV_ROOT") or pathlib.Path.home() / ".pyenv") / "versions"
    for candidate in (*sorted(pyenv.glob("3.6.*/bin/python")), shutil.which("python3.6")):
        if (
            candidate
            and subprocess.run([candidate, "-c", "import sys; assert sys.version_info[:2] == (3, 6)"]).returncode == 0
        ):
            return candidate
    return None


@pytest.fixture(scope="module")
def jetson(tmp_path_factory, full):
    """The Python of the environment."""
    if not full:
        pytest.skip("installs an old torch: pytest --full")
    python = _python36()
    if python is None:
        pytest.skip("NO PYTHON 3.6 HERE: that exported policies run on a Jetson's torch 1.10.2 IS NOT CHECKED")
    folder = tmp_path_factory.mktemp("jetson") / "venv"
    script = pathlib.Path(__file__).with_name("python36.sh")
    done = subprocess.run([script, str(python), str(folder)], capture_output=True, text=True)
    # An index that can't be reached, or a full disk, is nothing that this project could mend; all else is.
    for trouble in (
        "No matching distribution found",
        "Temporary failure in name resolution",
        "No space left on device",
    ):
        if done.returncode and trouble in done.stderr:
            pytest.skip(f"{trouble.upper()}: that exported policies run on a Jetson's torch 1.10.2 IS NOT CHECKED")
    assert done.returncode == 0, done.stderr[-2000:]
    return folder / "bin" / "python"


def run(python, folder, *arguments):
    done = subprocess.run([python, "-B", *arguments], cwd=folder, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.parametrize("name", NAMES)
def test_selftest(name, jetson, bundles):
    said = run_policy(bundles(name)[2], jetson, "--selftest")
    assert "python 3.6." in said and "torch 1.10.2" in said and "numpy 1.19.5" in said
    assert float(re.search(r"error (\S+), 0 requests", said)[1]) <= 1e-5


def test_the_readme_can_be_followed(jetson, bundles):
    folder = bundles("lidar")[2]
    example = re.search(r"<!-- try -->\n```python\n(.*?)```", (folder / "README.md").read_text(), re.DOTALL)[1]
    assert len(run(jetson, folder, "-W", "error", "-c", example).splitlines()) == 5


_ONNX = """
import numpy as np, onnxruntime
session = onnxruntime.InferenceSession("policy.onnx", providers=["CPUExecutionProvider"])
golden, worst, requests = np.load("golden.npz"), 0.0, 0
for i in range(128):
    feed = {entry.name: NAMES(golden, entry.name)[i:i+1].astype(np.float32) for entry in session.get_inputs()}
    v, w, request = session.run(["v", "w", "chosen_request"], feed)
    worst = max(worst, abs(v[0] - golden["out.v"][i]), abs(w[0] - golden["out.w"][i]))
    requests += request[0] != golden["out.request"][i]
print(onnxruntime.__version__, worst, requests)
"""


@pytest.mark.parametrize("name", ["approach", "grid"])
def test_onnx_and_torchscript(name, jetson, bundles, tmp_path):
    """onnxruntime 1.10 reads the file that today's torch wrote; TorchScript is written there and computes the same."""
    pytest.importorskip("onnxruntime")
    folder = tmp_path / "bundle"
    shutil.copytree(bundles(name)[2], folder)
    formats.add_onnx(folder)
    maps = "lambda golden, name: golden[name]"
    if name == "grid":
        maps = (
            "lambda golden, name, made=[]: (made or made.append(__import__('policy').Policy()) or made)[0]"
            ".tensors({k: golden[k] for k in made[0].inputs})[0].numpy() if name == 'maps' else golden[name]"
        )
    version, worst, requests = run(jetson, folder, "-c", f"NAMES = {maps}\n{_ONNX}").split()
    assert version == "1.10.0" and float(worst) <= 1e-4 and int(requests) == 0
    formats.add_torchscript(folder, jetson)
    program = """
import torch
from policy import HERE, Policy, golden_error, load_arrays
policy = Policy()
golden = load_arrays(HERE, policy.contract, "golden.npz")
loaded, inputs = torch.jit.load("policy.pt"), policy.tensors(golden)
rows = [loaded(*[tensor[i : i + 1] for tensor in inputs]) for i in range(128)]
print(*golden_error(policy, golden, [torch.cat(part).numpy() for part in zip(*rows)]))
"""
    error, requests = run(jetson, folder, "-c", program).split()
    assert float(error) <= 1e-5 and requests == "0"


def test_it_navigates(jetson, bundles):
    """The runtime itself, on the robot's numpy: everything that may go wrong, a thousand times, and no exception."""
    folder = bundles("lidar")[2]
    program = """
import numpy as np
from navigator import Mount, Navigator, Scan
navigator = Navigator(mount=Mount(x=0.1, yaw=3.0, upside_down=True))
navigator.reset((5.0, 0.0))
rng = np.random.RandomState(0)
odd = [None, float("nan"), "x", [[1.0]], [1, [2, 3]], np.ones((2, 4)), np.full(185, 0.1), 10**400, [], {}]
moved = 0
for i in range(1000):
    scan = Scan(np.where(rng.rand(360) < 0.1, np.nan, 3.0), -np.pi, np.pi / 180)
    given = [scan, [[2.0, 0.5, -0.5, 0.0]], (0.0, 0.0, 0.0), None]
    if rng.rand() < 0.3:
        given[rng.randint(4)] = odd[rng.randint(len(odd))]
    command = navigator.step(*given, now=0.1 * i)
    assert 0.0 <= command.v <= 0.6 and abs(command.w) <= 0.9
    moved += command.v > 0
print(moved)
"""
    assert 200 < int(run(jetson, folder, "-c", program)) < 950


def test_damage_is_named_there_too(jetson, bundles, tmp_path):
    folder = tmp_path / "bundle"
    shutil.copytree(bundles("td3")[2], folder)
    (folder / "weights.npz").write_bytes((folder / "weights.npz").read_bytes()[:500])
    done = subprocess.run([jetson, "-B", folder / "policy.py", "--selftest"], capture_output=True, text=True)
    assert done.returncode == 2 and "weights.npz is not the file" in done.stderr
    assert np.size(done.stderr.splitlines()) == 1
