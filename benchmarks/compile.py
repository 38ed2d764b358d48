"""The time until the first chunk of training is done: imports, tracing, lowering, compilation, and running.

Starts `jaxnav train` in a fresh process with an empty compilation cache, as a user would, notes what jax says of every
program it traces, lowers and compiles, watches metrics.jsonl grow, and stops the process after a few chunks. Prints a
JSON object a process. With --against both checkouts take turns, so that the machine's other work slows both down.
"""

import argparse
import collections
import glob
import gzip
import itertools
import json
import os
import pathlib
import signal
import statistics
import subprocess
import sys
import tempfile
import time

_HELP = """A result has, in seconds since the start of the process unless said otherwise:

  first_chunk_s, first_chunk_cpu_s     until the first line of metrics.jsonl, and processor time until then, all threads
  tracing_s, lowering_s, compiling_s   how long each of these went on, in any thread (their sum may exceed the total)
  programs                             [tracing, lowering, compiling] of each program that took half a second or more
  chunk_s, chunk_cpu_s                 median of the chunks after the first
  passes                               with --passes: seconds of each of XLA's passes over the train chunk

examples:
  python benchmarks/compile.py                                 preset quick, once
  python benchmarks/compile.py --passes                        and what XLA does with the train chunk
  python benchmarks/compile.py --against ../base --pairs 3     beside another checkout, taking turns
"""
_EVENTS = {
    "/jax/core/compile/jaxpr_trace_duration": "tracing",
    "/jax/core/compile/jaxpr_to_mlir_module_duration": "lowering",
    "/jax/core/compile/backend_compile_duration": "compiling",
}


def work(events_path, passes_path, arguments):
    """In the fresh process: train, and write a line a program that jax traced, lowered or compiled."""
    import jax

    def note(event, seconds, fun_name="", **_):
        if event not in _EVENTS:
            return
        now = time.monotonic()
        with open(events_path, "a") as events:
            events.write(json.dumps([_EVENTS[event], str(fun_name), now - seconds, now]) + "\n")
        if passes_path and _EVENTS[event] == "compiling" and "train_chunk" in str(fun_name):
            jax.profiler.stop_trace()

    jax.monitoring.register_event_duration_secs_listener(note)
    if passes_path:
        options = jax.profiler.ProfileOptions()
        options.python_tracer_level, options.host_tracer_level = 0, 3
        jax.profiler.start_trace(passes_path, profiler_options=options)
    from jaxnav.cli import main

    main(arguments)


def measure(checkout, preset, chunks, passes, timeout):
    """One fresh process on the code in the folder ``checkout``: the JSON object of a result."""
    with tempfile.TemporaryDirectory() as folder:
        folder = pathlib.Path(folder)
        environment = os.environ | {"JAX_COMPILATION_CACHE_DIR": str(folder / "cache"), "PYTHONPATH": str(checkout)}
        events, passes_folder = folder / "events", str(folder / "passes") if passes else ""
        command = [sys.executable, __file__, "--work", str(events), passes_folder]
        # It is stopped before it evaluates.
        command += ["train", "--preset", preset, "--out", str(folder / "run"), "--train.evaluate-every", "100000"]
        start = time.monotonic()
        process = subprocess.Popen(
            command, env=environment, cwd=checkout, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
        )
        try:
            done = _watch(process, folder / "run" / "metrics.jsonl", start, chunks, timeout)
        finally:
            process.send_signal(signal.SIGKILL)
            process.wait()
        spans = [json.loads(line) for line in events.read_text().splitlines()]
        spans = [span for span in spans if span[3] - start <= done[0][0]]
        result = {"name": "first_chunk", "preset": preset, "checkout": str(checkout)}
        result |= {"first_chunk_s": round(done[0][0], 2), "first_chunk_cpu_s": round(done[0][1], 2)}
        for kind in _EVENTS.values():
            result[f"{kind}_s"] = round(_union([span[2:] for span in spans if span[0] == kind]), 2)
        result["programs"] = _programs(spans)
        for name, values in zip(("chunk_s", "chunk_cpu_s"), zip(*done, strict=True), strict=True):
            lengths = [later - earlier for earlier, later in itertools.pairwise(values)]
            result[name] = round(statistics.median(lengths), 3) if lengths else None
        if passes:
            result["passes"] = _passes(passes_folder)
        return result


def _watch(process, path, start, chunks, timeout):
    """(seconds, processor seconds) since the start at which each of the first chunks was done."""
    done = []
    while len(done) < chunks:
        if process.poll() is not None:
            sys.exit(f"training ended early: {process.stderr.read().strip()}")
        if time.monotonic() - start > timeout:
            sys.exit(f"no {chunks} chunks within {timeout} s")
        lines = path.read_bytes().count(b"\n") if path.exists() else 0
        done += [(time.monotonic() - start, _cpu_seconds(process.pid))] * (lines - len(done))
        time.sleep(0.02)
    return done


def _cpu_seconds(pid):
    fields = pathlib.Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _union(spans):
    """Length of the union of (begin, end): a function traced within another counts once."""
    total, until = 0.0, float("-inf")
    for begin, end in sorted(spans):
        total += max(0.0, end - max(begin, until))
        until = max(until, end)
    return total


def _programs(spans):
    kinds = list(_EVENTS.values())
    programs = collections.defaultdict(lambda: [0.0] * len(kinds))
    for kind, name, begin, end in spans:
        programs[name.removeprefix("jit(").removesuffix(")")][kinds.index(kind)] += end - begin
    return {name: [round(s, 2) for s in parts] for name, parts in programs.items() if parts[2] and sum(parts) >= 0.5}


def _passes(folder):
    """Seconds, of all threads, in XLA's largest passes; those within others are in these, too."""
    [path] = glob.glob(f"{folder}/**/*.trace.json.gz", recursive=True)
    totals, counts = collections.Counter(), collections.Counter()
    with gzip.open(path) as file:
        for event in json.load(file)["traceEvents"]:
            if event.get("ph") == "X":
                totals[event["name"]] += event["dur"] / 1e6
                counts[event["name"]] += 1
    return {name: [round(seconds, 2), counts[name]] for name, seconds in totals.most_common(25)}


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, epilog=_HELP, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--preset", default="quick", help="of training (default: quick)")
    parser.add_argument("--against", type=pathlib.Path, metavar="FOLDER", help="another checkout, to take turns with")
    parser.add_argument("--pairs", type=int, default=1, help="processes on each checkout (default: 1)")
    parser.add_argument("--chunks", type=int, default=4, help="chunks a process runs (default: 4)")
    parser.add_argument("--passes", action="store_true", help="also time XLA's passes over the train chunk: slower")
    parser.add_argument("--timeout", type=float, default=600, help="seconds a process may take (default: 600)")
    arguments = parser.parse_args()
    here = pathlib.Path(__file__).resolve().parent.parent
    checkouts = [here] + ([arguments.against.resolve()] if arguments.against else [])
    results = []
    for pair in range(arguments.pairs):
        # Each goes first in turn.
        for checkout in checkouts if pair % 2 == 0 else checkouts[::-1]:
            result = measure(checkout, arguments.preset, arguments.chunks, arguments.passes, arguments.timeout)
            results.append(result)
            print(json.dumps(result), flush=True)
    if arguments.against:
        ratios = {}
        for field in ("first_chunk_s", "first_chunk_cpu_s", "chunk_s", "chunk_cpu_s"):
            of = [[r[field] for r in results if r["checkout"] == str(checkout)] for checkout in checkouts]
            if all(None not in values for values in of):
                ratios[field] = round(statistics.median(of[0]) / statistics.median(of[1]), 3)
        print(json.dumps({"name": "first_chunk_ratio", "pairs": arguments.pairs, **ratios}))


if __name__ == "__main__":
    if sys.argv[1:2] == ["--work"]:
        work(*sys.argv[2:4], sys.argv[4:])
    else:
        main()
