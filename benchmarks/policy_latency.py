"""How long an exported policy takes to decide: one input at a time, one thread, as on a robot.

`act` is the policy of the bundle, checks and for grid encoders the rasteriser included; `step` the whole Navigator on a
scan of 360 beams. Policies have random weights, which cost the same, or are those of the bundles named. The process is
one of its own, with torch and numpy alone, so that its memory is that of a robot's.
"""

import argparse
import json
import os
import pathlib
import shutil
import subprocess
import sys
import tempfile

from rich.console import Console
from rich.table import Table

sys.path.insert(0, str(pathlib.Path(__file__).parent.parent))
from experiments.exporting.single_states import untrained
from jaxnav.agents import ENCODERS
from jaxnav.export.bundle import write_bundle
from jaxnav.export.contract import origin_of

MOST = {"lidar": 0.5, "lidar-approach": 0.5, "grid": 10.0, "grid-frozen": 10.0}  # ms of `act` that are meant to be kept

# Python 3.6 too: it runs on whatever Python is named.
_MEASURE = """
import json, re, sys, time
import numpy as np, torch
torch.set_num_threads(1)
from navigator import Navigator, Scan
from policy import HERE, load_arrays
navigator = Navigator()
policy, encoder = navigator.policy, navigator.contract["network"]["encoder"]
golden = load_arrays(HERE, navigator.contract, "golden.npz")
inputs = [{name: golden[name][i] for name in policy.inputs} for i in range(len(golden["out.v"]))]
navigator.reset((50.0, 0.0))
scan = Scan(np.full(360, 3.0), -np.pi, np.pi / 180)
def milliseconds(function, seconds=SECONDS):
    spent, end = [], time.perf_counter() + seconds
    while time.perf_counter() < end or len(spent) < 50:
        start = time.perf_counter()
        function(len(spent))
        spent.append(1e3 * (time.perf_counter() - start))
    return [float(q) for q in np.percentile(spent[len(spent) // 10:], [50, 99])]
act = milliseconds(lambda i: policy.act(inputs[i % len(inputs)]))
def drive(i):
    navigator.step(scan._replace(), [[2.0, 1.0, -0.5, 0.0]], (1e-4 * i, 0.0, 0.0), now=0.1 * i)
    assert navigator.reason == "", navigator.reason
step = milliseconds(drive)
print(json.dumps({
    "name": "policy", "encoder": encoder, "ms": act[0], "ms_p99": act[1], "step_ms": step[0], "step_ms_p99": step[1],
    "peak_mb": int(re.search("VmHWM: *(\\d+)", open("/proc/self/status").read().replace("\\t", " "))[1]) / 1e3,
    "where": "python %s, torch %s, numpy %s" % (sys.version.split()[0], torch.__version__, np.__version__),
}))
"""


def measure(bundle, python, seconds):
    """The result of one bundle under one Python, as a dict."""
    code = _MEASURE.replace("SECONDS", str(seconds))
    done = subprocess.run([python, "-B", "-c", code], cwd=bundle, capture_output=True, text=True)
    if done.returncode:
        sys.exit(f"error: {python} in {bundle}: {done.stderr.strip().splitlines()[-1]}")
    size = sum(path.stat().st_size for path in pathlib.Path(bundle).iterdir() if path.is_file())
    return json.loads(done.stdout) | {"bundle_mb": size / 1e6}


def make(encoder, folder):
    """The bundle of an untrained policy that hears sentences."""
    run, actor = untrained(f"{encoder}, shared, phrases")
    write_bundle(run, actor, folder, origin_of(run, "last", {}, None))
    return folder


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("bundles", nargs="*", help="folders of bundles; without any, one of each encoder is made")
    parser.add_argument("--python", action="append", help="a Python with torch and numpy, as the robot's; repeat it")
    parser.add_argument("--seconds", type=float, default=3.0, help="of each measurement")
    parser.add_argument("--json", action="store_true", help="one JSON object a line")
    arguments = parser.parse_args()
    pythons = []
    for python in arguments.python or [sys.executable]:
        found = shutil.which(python)
        if found is None:
            sys.exit(f"error: --python {python} is no program: give a Python that has torch and numpy")
        pythons.append(os.path.abspath(found))  # and no link followed: a virtual environment is one
    if not 0 < arguments.seconds < 1e6:
        sys.exit(f"error: --seconds is {arguments.seconds}: give a number above 0")
    for bundle in arguments.bundles:
        if not (pathlib.Path(bundle) / "contract.json").exists():
            sys.exit(f"error: {bundle} holds no bundle: give folders that jaxnav export has written")
    table = Table(title="one decision, one thread; median and 99th percentile")
    for column in ("encoder", "act (ms)", "meant: at most", "Navigator.step (ms)", "peak memory", "bundle", "where"):
        table.add_column(column)
    kept = True
    with tempfile.TemporaryDirectory() as scratch:
        folders = arguments.bundles or [make(encoder, pathlib.Path(scratch) / encoder) for encoder in ENCODERS]
        for folder in folders:
            for python in pythons:
                found = measure(folder, python, arguments.seconds)
                most = MOST[found["encoder"]]
                kept &= found["ms"] <= most
                if arguments.json:
                    print(json.dumps(found), flush=True)
                table.add_row(
                    found["encoder"], f"{found['ms']:.2f}, {found['ms_p99']:.2f}", f"{most:g}",
                    f"{found['step_ms']:.2f}, {found['step_ms_p99']:.2f}", f"{found['peak_mb']:.0f} MB",
                    f"{found['bundle_mb']:.1f} MB", found["where"],
                )  # fmt: skip
    if not arguments.json:
        Console().print(table)
    sys.exit(0 if kept else 1)


if __name__ == "__main__":
    main()
