"""The folder: what is in it, that it is whole or not there, and that every change of it shows."""

import json
import math
import os
import re
import shutil
import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import pytest

from jaxnav.errors import UserError
from jaxnav.export import bundle, formats
from jaxnav.export.contract import origin_of
from jaxnav.export.modules import modules
from jaxnav.export.seal import checksum, hash_of
from jaxnav.export.verify import verify


@pytest.fixture
def copy(bundles, tmp_path):
    """A bundle that may be damaged."""
    folder = tmp_path / "copy"
    shutil.copytree(bundles("lidar")[2], folder)
    return folder


def files(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def run(folder, *arguments, cwd=None):
    command = [sys.executable, "-B", *arguments]
    return subprocess.run(command, cwd=cwd or folder, capture_output=True, text=True, timeout=120)


# As where there is neither this package nor what it needs.
HIDDEN = ("jax", "jaxlib", "flax", "jaxnav", "scipy")
ALONE = f"import runpy, sys; sys.modules.update(dict.fromkeys({HIDDEN})); sys.argv = ['', '--selftest']; "


def test_it_proves_itself_alone(copy):
    """In a process that can't see this package, nor anything but the folder itself."""
    done = run(copy, "-c", ALONE + "runpy.run_path('policy.py', run_name='__main__')")
    assert done.returncode == 0, done.stderr
    error = float(re.search(r"selftest passed, 128 recorded inputs: largest error (\S+), 0 requests", done.stdout)[1])
    assert 0 < error <= 1e-5


def test_its_readme_can_be_followed(copy):
    readme = (copy / "README.md").read_text()
    example = re.search(r"<!-- try -->\n```python\n(.*?)```", readme, re.DOTALL)[1]
    done = run(copy, "-c", ALONE + example)
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert len(lines) == 5 and all(re.match(r"0\.\d\d m/s [+-]0\.\d\d rad/s request [0-3] ", line) for line in lines)
    # What it says of words.
    example = readme.split("## 4. Words")[1].split("```python\n")[1].split("```")[0]
    example += """
print(vector.shape, book.look_up("it is not known"), book.look_up("im in a HURRY"))
print((book.look_up("STOP robot") == book.look_up("Stop, robot!")).all())
"""
    done = run(copy, "-c", ALONE + example)
    assert done.stdout == "(185,) None None\nTrue\n", done.stderr
    # What it says of a node, on messages as rospy's.
    names = {}
    exec(re.search(r"<!-- node -->\n```python\n(.*?)```", readme, re.DOTALL)[1], names)
    stamp = SimpleNamespace(to_sec=lambda: 9.5)
    turned = SimpleNamespace(x=0.0, y=0.0, z=math.sin(0.4), w=math.cos(0.4))
    where = SimpleNamespace(pose=SimpleNamespace(position=SimpleNamespace(x=1.0, y=2.0), orientation=turned))
    odometry, scan = (SimpleNamespace(header=SimpleNamespace(stamp=stamp), pose=where) for _ in range(2))
    given = []
    driver = SimpleNamespace(step=lambda *arguments: given.append(arguments) or (0.5, 0.1, 2, "Hello!"))
    latest = {"scan": scan, "odom": odometry, "people": [], "message": "a vector"}
    assert names["drive"](driver, latest, 10.0) == (0.0, 0.0, "")
    assert names["drive"](driver, latest | {"people_stamp": 9.0}, 10.0) == (0.5, 0.1, "Hello!")
    assert given == [(scan, [], pytest.approx((1.0, 2.0, 0.8)), "a vector", 9.0, 10.0)]
    # A robot at (3, 4) of the map, heading north, has driven 2 m ahead and turned to the left a little.
    found = names["in_map"]((3.0, 4.0, math.pi / 2), (1.0, 1.0, 0.0), (3.0, 1.0, 0.2))
    assert found == pytest.approx((3.0, 6.0, math.pi / 2 + 0.2))
    for name in re.findall(r"`(\w+\.py)`", readme):
        assert (copy / name).exists()


def test_it_is_small_and_holds_no_pickle(copy):
    assert sum(path.stat().st_size for path in copy.iterdir()) <= 4e6
    for path in copy.glob("*.npz"):
        with np.load(path, allow_pickle=False) as arrays:
            assert all(arrays[name].dtype != object for name in arrays.files)


def test_the_same_policy_is_the_same_bundle(bundles, copy, tmp_path):
    made, actor, _ = bundles("lidar")
    bundle.write_bundle(made, actor, tmp_path / "again", origin_of(made, "last", {}, None))
    assert files(tmp_path / "again") == files(copy)


def edit(folder, change):
    """Change the contract, and give it the checksum that it then has."""
    contract = json.loads((folder / "contract.json").read_text())
    change(contract)
    contract["checksum"] = checksum(contract)
    (folder / "contract.json").write_text(json.dumps(contract))


def replace(name, data):
    return lambda folder: (folder / name).write_bytes(data((folder / name).read_bytes()))


def wrong_weights(folder):
    """A weight that is not the trained one, in a file that is otherwise right: only golden.npz can tell."""
    with np.load(folder / "weights.npz") as arrays:
        weights = {name: arrays[name] for name in arrays.files}
    weights["mean_head.bias"] = weights["mean_head.bias"] + np.float32(1e-3)
    np.savez(folder / "weights.npz", **weights)
    edit(folder, lambda c: c["files"].update({"weights.npz": hash_of(folder / "weights.npz")}))


def nan_recorded(folder):
    with np.load(folder / "golden.npz") as arrays:
        golden = {name: arrays[name] for name in arrays.files}
    golden["out.w"] = np.full_like(golden["out.w"], np.nan)
    np.savez(folder / "golden.npz", **golden)
    edit(folder, lambda c: c["files"].update({"golden.npz": hash_of(folder / "golden.npz")}))


def pickled(folder):
    """A file of weights whose loading would run a program."""
    np.savez(folder / "weights.npz", a=np.array([os.system], object), allow_pickle=True)
    edit(folder, lambda c: c["files"].update({"weights.npz": hash_of(folder / "weights.npz")}))


DAMAGES = {
    "truncated weights": (replace("weights.npz", lambda b: b[:1000]), "weights.npz"),
    "a flipped bit": (replace("weights.npz", lambda b: b[:5000] + bytes([b[5000] ^ 1]) + b[5001:]), "weights.npz"),
    "no weights": (lambda folder: (folder / "weights.npz").unlink(), "weights.npz"),
    "edited contract": (replace("contract.json", lambda b: b.replace(b'"max_v": 0.6', b'"max_v": 1.6')), "was edited"),
    "half a contract": (replace("contract.json", lambda b: b[: len(b) // 2]), "contract.json"),
    "a list for a contract": (replace("contract.json", lambda b: b"[]"), "contract.json"),
    "no contract": (lambda folder: (folder / "contract.json").unlink(), "contract.json"),
    "another schema": (lambda folder: edit(folder, lambda c: c.update(schema=2)), "schema 2"),
    "other weights": (wrong_weights, "selftest FAILED"),
    "pickled weights": (pickled, "weights.npz can't be loaded"),
    "truncated golden": (replace("golden.npz", lambda b: b[:500]), "golden.npz"),
    "not a number recorded": (nan_recorded, "selftest FAILED"),
    "a phrase less": (replace("phrases.csv", lambda b: b[:20000]), "phrases.csv"),
    "another safety layer": (replace("safety.py", lambda b: b + b"\n"), "safety.py"),
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_damage_is_named_on_the_robot_and_here(damage, copy, full):
    """Each as a robot's own process prints it with `--full`, else one of them, and the others in this process."""
    spoil, said = DAMAGES[damage]
    spoil(copy)
    before = files(copy)
    if full or damage == "other weights":
        done = run(copy, "policy.py", "--selftest")
        assert done.returncode == 2 and done.stdout == ""
        assert said in done.stderr and len(done.stderr.splitlines()) == 1, done.stderr
        with pytest.raises(UserError, match=re.escape(said)):
            verify(copy)
    else:
        with modules(copy, "policy", "bundle") as (policy, loader):
            with pytest.raises(loader.BundleError, match=re.escape(said)) as error:
                policy.selftest(str(copy))
            assert len(str(error.value).splitlines()) == 1
        if damage not in ("pickled weights", "not a number recorded"):  # verify replays these in a process of its own
            with pytest.raises(UserError, match=re.escape(said)):
                verify(copy)
    assert files(copy) == before


def test_a_damaged_phrasebook_says_so(copy):
    (copy / "phrases.csv").write_bytes((copy / "phrases.csv").read_bytes()[:20000])
    done = run(copy, "-c", "from phrasebook import Phrasebook; Phrasebook()")
    assert done.returncode == 1 and "BundleError" in done.stderr and "phrases.csv is not the file" in done.stderr


def test_verify_misses_entries(copy):
    edit(copy, lambda c: (c.pop("safety"), c["inputs"][0].pop("unit"), c["files"].pop("people.py")))
    with pytest.raises(UserError, match=r"lacks safety, inputs\.scan\.unit, files\.people\.py"):
        verify(copy)


def test_nothing_is_overwritten(bundles, tmp_path):
    made, actor, _ = bundles("lidar")
    origin = origin_of(made, "last", {}, None)
    (tmp_path / "notes").mkdir()
    (tmp_path / "notes" / "mine.txt").write_text("mine")
    (tmp_path / "file").write_text("mine")
    with pytest.raises(UserError, match="notes is not empty: give another --out"):
        bundle.write_bundle(made, actor, tmp_path / "notes", origin, replace=True)
    with pytest.raises(UserError, match="file is a file: give a folder"):
        bundle.write_bundle(made, actor, tmp_path / "file", origin)
    assert (tmp_path / "notes" / "mine.txt").read_text() == (tmp_path / "file").read_text() == "mine"


def test_a_failure_leaves_what_was_there(bundles, tmp_path):
    made, actor, _ = bundles("lidar")
    origin = origin_of(made, "last", {}, None)
    folder = tmp_path / "bundle"
    bundle.write_bundle(made, actor, folder, origin)
    before = files(folder)
    with pytest.raises(UserError, match="already holds a bundle"):
        bundle.write_bundle(made, actor, folder, origin)

    def fail(folder):
        raise UserError("it can't be made")

    with pytest.raises(UserError, match=r"it can.t be made"):
        bundle.write_bundle(made, actor, folder, origin | {"policy": "best"}, replace=True, add=[fail])
    assert files(folder) == before and list(tmp_path.iterdir()) == [folder]
    bundle.write_bundle(made, actor, folder, origin | {"policy": "best"}, replace=True)
    assert json.loads((folder / "contract.json").read_text())["origin"]["policy"] == "best"
    assert list(tmp_path.iterdir()) == [folder]


@pytest.mark.parametrize("name", ["lidar", "approach", "grid", "td3"])
def test_onnx_agrees_with_what_was_recorded(name, bundles, tmp_path, full):
    if name in ("approach", "td3") and not full:
        pytest.skip("two networks more as ONNX: pytest --full")
    onnx, runtime = pytest.importorskip("onnx"), pytest.importorskip("onnxruntime")
    folder = tmp_path / "bundle"
    shutil.copytree(bundles(name)[2], folder)
    assert formats.add_onnx(folder) <= 1e-5
    model = onnx.load(folder / "policy.onnx")
    assert [entry.version for entry in model.opset_import if entry.domain == ""] == [13]
    onnx.checker.check_model(model)
    contract = json.loads((folder / "contract.json").read_text())
    names = [entry.name for entry in model.graph.input]
    assert names == [name for name in contract["network"]["inputs"] if name in names]
    # A recorded input, by hand: as somebody does who has only the contract.
    if name == "lidar":
        session = runtime.InferenceSession(str(folder / "policy.onnx"), providers=["CPUExecutionProvider"])
        with np.load(folder / "golden.npz") as golden:
            feed = {name: golden[name][3:4].astype(np.float32) for name in names}
            v, w, request = session.run(["v", "w", "chosen_request"], feed)
            np.testing.assert_allclose([v[0], w[0]], [golden["out.v"][3], golden["out.w"][3]], atol=1e-5)
            assert request[0] == golden["out.request"][3]


def test_an_onnx_file_that_computes_something_else_is_not_written(copy):
    pytest.importorskip("onnxruntime")
    wrong_weights(copy)
    with pytest.raises(UserError, match=r"differs by .* from golden\.npz"):
        formats.add_onnx(copy)
    assert not (copy / "policy.onnx").exists()


def test_torchscript_is_left_to_an_old_torch(copy):
    with pytest.raises(UserError, match=r"torch \S+ writes TorchScript that the robot's can't read"):
        formats.add_torchscript(copy, sys.executable)
    with pytest.raises(UserError, match="nowhere/python can't be run"):
        formats.add_torchscript(copy, "nowhere/python")
    (copy / "torch.py").write_text("raise ModuleNotFoundError('No module named torch')")
    said = rf"^--torchscript {re.escape(sys.executable)}: ModuleNotFoundError: No module named torch \(it has to be a"
    with pytest.raises(UserError, match=said):
        formats.add_torchscript(copy, sys.executable)
    assert not (copy / "policy.pt").exists()
