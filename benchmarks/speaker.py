"""A language model costs the control loop nothing: worst step while a server answers well, late, wrongly or not.

A stub of an OpenAI-compatible server on this machine answers as each behaviour says; a loop begins to say 200
utterances and looks at every step whether they are ready. The same loop with templates is the yardstick. Steps do a
little work, as a policy would, so that threads which hold Python's lock are felt.
"""

import argparse
import itertools
import json
import logging
import pathlib
import statistics
import sys
import time

import numpy as np

from jaxnav.language.llm import LanguageModel, log
from jaxnav.language.speaker import Context, LanguageModelSpeaker, TemplateSpeaker, expresses
from jaxnav.world.types import LEFT, RIGHT, STOP

sys.path.insert(0, str(pathlib.Path(__file__).parent.parent / "tests" / "language"))
from stub_server import Stub, good_answer

BEHAVIOURS = {
    "well": "good", "late (5 s)": "slow", "wrongly (other side)": "other side", "with 500": "500",
    "not at all": "silent",
}  # fmt: skip
CONTEXTS = [Context(request, who) for request, who in itertools.product((RIGHT, LEFT, STOP), ("robot", "pedestrian"))]


def run(speaker, contexts, period):
    """(seconds of every step, [(context, sentence)]): each context has as many steps as it takes."""
    weights, x = np.random.default_rng(0).normal(size=(256, 256)), np.ones(256)
    seconds, said = [], []
    for context in contexts:
        pending, sentence = None, None
        while sentence is None:
            start = time.perf_counter()
            if pending is None:
                pending = speaker.begin(context)
            sentence = pending.take()
            for _ in range(10):  # what a policy would compute
                x = np.tanh(weights @ x / 16.0)
            seconds.append(time.perf_counter() - start)
            time.sleep(period)
        said.append((context, sentence))
    return seconds, said


def wrong(said):
    """How many of the sentences don't express their context."""
    count = 0
    for context, sentence in said:
        try:
            expresses(sentence, context)
        except ValueError:
            count += 1
    return count


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--utterances", type=int, default=200, help="of each behaviour")
    parser.add_argument("--limit", type=float, default=0.3, help="time limit of an answer, s")
    parser.add_argument("--json", action="store_true", help="one JSON object a line")
    arguments = parser.parse_args()
    log.setLevel(logging.CRITICAL)
    plain, _ = run(TemplateSpeaker(), CONTEXTS * (2 * arguments.utterances), 0.002)
    print(f"templates: worst step {1e3 * max(plain):.2f} ms, median {1e3 * statistics.median(plain):.2f} ms")
    for name, behaviour in BEHAVIOURS.items():
        stub = Stub(good_answer)
        stub.behaviour = behaviour
        # A cache would ask a well-meaning server only six times: each utterance has a speaker of its own.
        model = LanguageModel(stub.url, "stub", "key", limit=arguments.limit)
        seconds, said = [], []
        for i in range(arguments.utterances):
            more, sentences = run(LanguageModelSpeaker(model), [CONTEXTS[i % len(CONTEXTS)]], 0.002)
            seconds += more
            said += sentences
        stub.close()
        row = {
            "name": "speaker", "server": name, "utterances": len(said), "wrong": wrong(said),
            "worst_ms": 1e3 * max(seconds), "added_ms": 1e3 * (max(seconds) - max(plain)),
        }  # fmt: skip
        if arguments.json:
            print(json.dumps(row))
        else:
            print(
                f"server answers {name:20}: {row['utterances']} utterances, {row['wrong']} wrong, worst step "
                f"{row['worst_ms']:.2f} ms ({row['added_ms']:+.2f})"
            )


if __name__ == "__main__":
    main()
