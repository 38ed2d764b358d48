"""The speed of this checkout beside another one: the world's programs and a chunk of training, in pairs of processes.

A pair is one fresh process of each checkout, one right after the other, and which of them is first alternates: a
machine that slows down slows both. Each checkout runs its own benchmarks/world.py, and trains the preset quick through
its own command line; metrics.jsonl says what a chunk takes. Nothing else of the other checkout is used, so its names
may differ. A ratio is the time of this checkout by that of the other: below 1 this one is faster.
"""

import argparse
import json
import os
import pathlib
import statistics
import subprocess
import sys
import tempfile

HERE = pathlib.Path(__file__).resolve().parent.parent
TRAIN = "from jaxnav.cli import main; main()"
WORLD = ("raycast", "step", "full_step", "grid_observation", "crowd", "map")
CHUNK = "chunk"
FIRST = 2  # chunks that are not counted: they compile
CACHE = tempfile.TemporaryDirectory()  # of what was compiled: only a program's first process waits for that

_HELP = """examples:
  git worktree add ../before HEAD~1
  python benchmarks/against.py ../before                       the world's steps and a chunk, five pairs
  python benchmarks/against.py ../before --only chunk --pairs 9
  python benchmarks/against.py ../before --python ../before/.venv/bin/python
"""


def world_times(checkout: pathlib.Path, python: str, name: str, seconds: float) -> dict[str, float]:
    """Seconds of a million steps of every size of a benchmark of the world, by its label."""
    command = ["benchmarks/world.py", "--json", "--only", name, "--seconds", str(seconds)]
    found = {}
    for row in map(json.loads, run(checkout, python, command).splitlines()):
        sizes = [f"{row[field]} {field}" for field in ("episodes", "pedestrians") if field in row]
        found[", ".join([row["name"], *sizes, *(["noise"] if row.get("noise") else [])])] = 1e6 / row["rate_per_s"]
    return found


def chunk_times(checkout: pathlib.Path, python: str, chunks: int) -> dict[str, float]:
    """Median seconds of a chunk of training with preset quick, of those after the first `FIRST`, by its label."""
    with tempfile.TemporaryDirectory() as folder:
        sizes = ["--train.total-steps", str(25 * (FIRST + chunks + 1)), "--train.evaluate-every", str(10**6)]
        command = ["-c", TRAIN, "train", "--preset", "quick", "--out", f"{folder}/run", *sizes]
        run(checkout, python, command)
        lines = [json.loads(line) for line in pathlib.Path(folder, "run", "metrics.jsonl").read_text().splitlines()]
    walls = [line["wall_seconds"] for line in lines if "evaluation" not in line]
    return {CHUNK: statistics.median(b - a for a, b in zip(walls[FIRST - 1 :], walls[FIRST:], strict=False))}


def run(checkout: pathlib.Path, python: str, command: list[str]) -> str:
    """The output of a Python process in that checkout. Exits if it fails."""
    environment = os.environ | {"PYTHONPATH": str(checkout), "JAX_COMPILATION_CACHE_DIR": CACHE.name}
    done = subprocess.run([python, *command], cwd=checkout, env=environment, capture_output=True, text=True)
    if done.returncode:
        sys.exit(f"{checkout}: {' '.join(command)} failed: {done.stderr.strip()[-2000:]}")
    return done.stdout


def ratios(pairs: list[tuple[dict, dict]]) -> dict[str, list[float]]:
    """By label the ratio of every pair (times of this checkout, times of the other)."""
    labels = [label for label in pairs[0][0] if label in pairs[0][1]]
    return {label: [ours[label] / theirs[label] for ours, theirs in pairs] for label in labels}


def main() -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(
        description=__doc__, epilog=_HELP, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("other", type=pathlib.Path, help="folder of the other checkout")
    parser.add_argument(
        "--python", default=sys.executable, help="interpreter of the other checkout (default: this one)"
    )
    parser.add_argument(
        "--only", nargs="+", choices=[*WORLD, CHUNK], default=["step", "full_step", CHUNK], metavar="NAME",
        help=f"what to measure, of {', '.join([*WORLD, CHUNK])} (default: step full_step chunk)",
    )  # fmt: skip
    parser.add_argument("--pairs", type=int, default=5, metavar="N", help="pairs of processes of each (default: 5)")
    parser.add_argument("--seconds", type=float, default=1.0, metavar="S", help="each size of the world's (default: 1)")
    parser.add_argument("--chunks", type=int, default=10, metavar="N", help="chunks that are timed (default: 10)")
    parser.add_argument("--json", action="store_true", help="one JSON object a line instead of a table")
    arguments = parser.parse_args()
    other = arguments.other.resolve()
    if not (other / "benchmarks" / "world.py").is_file():
        parser.error(f"other is {arguments.other}: give the folder of a checkout, with benchmarks/world.py in it")
    for name in ("pairs", "chunks"):
        if getattr(arguments, name) < 1:
            parser.error(f"--{name} is {getattr(arguments, name)}: give a whole number of at least 1")
    sides = ((HERE, sys.executable), (other, arguments.python))
    for name in arguments.only:
        pairs = []
        for i in range(arguments.pairs):
            found: list[dict] = [{}, {}]
            for side in (0, 1) if i % 2 == 0 else (1, 0):
                if name == CHUNK:
                    found[side] = chunk_times(*sides[side], arguments.chunks)
                else:
                    found[side] = world_times(*sides[side], name, arguments.seconds)
            pairs.append((found[0], found[1]))
        for label, values in ratios(pairs).items():
            row = {
                "name": label, "ratio": round(statistics.median(values), 3), "least": round(min(values), 3),
                "most": round(max(values), 3), "pairs": len(values),
            }  # fmt: skip
            text = f"{label:40} {row['ratio']:.3f} ({row['least']:.3f} to {row['most']:.3f}, {len(values)} pairs)"
            print(json.dumps(row) if arguments.json else text, flush=True)


if __name__ == "__main__":
    main()
