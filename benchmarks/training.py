"""How long until the robot succeeds: time to 0.95 in every scene, measured from outside a fresh process.

Starts `jaxnav train --preset quick` as a user would, watches metrics.jsonl grow, and stops the process once two
consecutive evaluations (500 episodes a scene, one every 400 updates) reach the threshold in every scene. Seconds count
from the start of the process to the first of the two, imports and compilation included.
"""

import argparse
import json
import os
import pathlib
import signal
import statistics
import subprocess
import sys
import tempfile
import time

THRESHOLD = 0.95


def measure(seed, cache, timeout):
    """One fresh training process: the JSON object of a result."""
    with tempfile.TemporaryDirectory() as folder:
        out = pathlib.Path(folder) / "run"
        environment = os.environ | {"JAX_COMPILATION_CACHE_DIR": str(cache)}
        command = [sys.executable, "-m", "jaxnav.cli", "train", "--seed", str(seed), "--out", str(out)]
        start = time.monotonic()
        process = subprocess.Popen(
            command, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
        )
        try:
            return {"name": "time_to_095", "seed": seed, **_watch(process, out / "metrics.jsonl", start, timeout)}
        finally:
            process.send_signal(signal.SIGKILL)
            process.wait()


def _watch(process, path, start, timeout):
    seen, first_chunk, passed = 0, None, None
    while True:
        running, now = process.poll() is None, time.monotonic() - start
        lines = path.read_text().splitlines() if path.exists() else []
        if lines and first_chunk is None:
            first_chunk = now
        for line in (json.loads(text) for text in lines[seen:] if text.endswith("}")):
            seen += 1
            if "evaluation" not in line:
                continue
            if min(line["evaluation"].values()) < THRESHOLD:
                passed = None
            elif passed is None:
                passed = {"seconds": round(now, 2), "updates": line["updates"], "env_steps": line["env_steps"]}
            else:
                return passed | {"first_chunk_s": round(first_chunk, 2)}
        if not running or now > timeout:
            if process.poll():
                sys.exit(f"training failed: {process.stderr.read().strip()}")
            return {"seconds": None, "updates": None, "env_steps": None, "first_chunk_s": first_chunk}
        time.sleep(0.1)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2], help="one fresh process each")
    parser.add_argument("--timeout", type=float, default=600, help="seconds after which a seed counts as censored")
    parser.add_argument("--warm", action="store_true", help="also measure each seed with a warm compilation cache")
    parser.add_argument("--json", action="store_true", help="one JSON object a line")
    arguments = parser.parse_args()
    results = []
    for seed in arguments.seeds:
        with tempfile.TemporaryDirectory() as cache:
            for kind in ["cold", "warm"] if arguments.warm else ["cold"]:
                result = measure(seed, cache, arguments.timeout) | {"cache": kind}
                results.append(result)
                if arguments.json:
                    print(json.dumps(result), flush=True)
                else:
                    print(
                        f"seed {seed}, {kind} cache: {result['seconds']} s to {THRESHOLD} in every scene "
                        f"({result['updates']} updates), first chunk after {result['first_chunk_s']} s",
                        flush=True,
                    )
    for kind in dict.fromkeys(result["cache"] for result in results):
        # A seed that never arrives counts as infinitely late.
        seconds = [result["seconds"] or float("inf") for result in results if result["cache"] == kind]
        median = statistics.median(seconds)
        if arguments.json:
            print(json.dumps({"name": "time_to_095_median", "seconds": median, "seeds": len(seconds), "cache": kind}))
        else:
            print(f"median of {len(seconds)} seeds, {kind} cache: {median} s")


if __name__ == "__main__":
    main()
