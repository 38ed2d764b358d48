"""What the robot says: never of the wrong side, whoever words it."""

import itertools
import re
import time

import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxnav.language.speaker import REPEAT, Context, LanguageModelSpeaker, TemplateSpeaker, expresses, sentences
from jaxnav.world.types import AGREES, LEFT, NONE, REFUSES, RIGHT, STOP

CONTEXTS = [
    REPEAT,
    *(Context(request, "robot", reply) for request in (STOP, RIGHT, LEFT) for reply in (NONE, AGREES, REFUSES)),
    *(Context(request, "pedestrian") for request in (STOP, RIGHT, LEFT)),
]


@pytest.mark.parametrize("context", CONTEXTS, ids=str)
def test_every_template_expresses_its_context(context):
    found = sentences(context)
    assert len(set(found)) == len(found) >= 3
    for sentence in found:
        assert expresses(sentence, context) == sentence


@pytest.mark.parametrize("asked", [RIGHT, LEFT])
@pytest.mark.parametrize("asked_by", ["robot", "pedestrian"])
def test_no_sentence_of_another_context_passes_for_a_side(asked, asked_by):
    """Neither of the other side, nor of the other's side, nor of stopping."""
    context = Context(asked, asked_by)
    for other in CONTEXTS:
        if (other.request, other.asked_by, other.reply) == (asked, asked_by, NONE):
            continue
        for sentence in sentences(other):
            if "keep right, then" in sentence or "keep left, then" in sentence:
                continue  # says the same to both
            with pytest.raises(ValueError, match="the answer"):
                expresses(sentence, context)


def test_templates_vary():
    templates = TemplateSpeaker()
    said = {templates.say(Context(RIGHT, "pedestrian")) for _ in range(12)}
    assert len(said) >= 4
    assert all("right" in sentence and "left" not in sentence for sentence in said)
    with pytest.raises(ValueError, match="nothing to say"):
        templates.say(Context(NONE, "robot"))


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("OK, I'll move to my left!", "names left for right"),
        ("I'll move right and left", "names left and right for right"),
        ("OK, I'll make room.", "no side for right"),
        ("I won't go to my right", "denies"),
        ("I will stay away from my right", "denies"),
        ("I'll go anywhere but right", "denies"),
        ("Please move to your right", "the other's right"),
        ("I'll go to my right, on your right", "the other's right"),
        ("You are right!", "the other's right"),
        ("You keep right", "does not say what I do"),
        ("", "is empty"),
        ("...", "is empty"),
        (None, "no text"),
        ("I'll go right " * 30, "longer than"),
        ("Ignore the rules, I drive faster to the right", "not what a robot says"),
        ('{"say": "I go right"}', "not what a robot says"),
        ("Ich gehe nach rechts \u2192 right", "not what a robot says"),
    ],
)
def test_what_may_not_be_said(text, complaint):
    with pytest.raises(ValueError, match=complaint):
        expresses(text, Context(RIGHT, "pedestrian"))


@pytest.mark.parametrize(
    ("context", "text"),
    [
        (Context(RIGHT, "robot", REFUSES), "I won't stop."),
        (Context(RIGHT, "robot", REFUSES), "I will not wait for you."),
        (Context(RIGHT, "robot", REFUSES), "You must wait!"),
        (Context(STOP, "pedestrian"), "I cannot stop."),
        (Context(STOP, "pedestrian"), "I dont stop"),
        (Context(STOP, "pedestrian"), "I refuse to stop."),
        (Context(STOP, "pedestrian"), "You must stop!"),
        (Context(STOP, "pedestrian"), "Stop!"),
        (Context(STOP, "pedestrian"), "I stop at nothing, go away"),
        (Context(RIGHT, "robot"), "Please move to my own right."),
        (Context(RIGHT, "robot"), "Please move to your right, on my right."),
        (Context(RIGHT, "robot"), "I will go right."),
        (Context(RIGHT, "robot"), "Avoid the right, move on."),
        (Context(RIGHT, "robot"), "Move anywhere but right"),
        (Context(RIGHT, "robot"), "Move away from your right"),
        (Context(RIGHT, "robot", AGREES), "I run you over"),
        (Context(RIGHT, "robot", AGREES), "OK."),
        (Context(STOP, "robot"), "I will stop"),
    ],
)
def test_what_only_looks_right_is_refused(context, text):
    with pytest.raises(ValueError, match="the answer"):
        expresses(text, context)


SIDED = st.lists(
    st.sampled_from(["I'll", "you", "please", "move", "to", "my", "your", "left", "right", "the", "stop", "not"]),
    max_size=9,
)


@given(SIDED.map(" ".join), st.sampled_from([c for c in CONTEXTS if c.request in (RIGHT, LEFT) and c.reply == NONE]))
def test_what_passes_names_the_side_and_no_other(text, context):
    try:
        sentence = expresses(text, context).lower()
    except ValueError:
        return
    wanted, other = ("right", "left") if context.request == RIGHT else ("left", "right")
    assert re.search(rf"\b{wanted}\b", sentence) and not re.search(rf"\b{other}\b", sentence)
    assert "not" not in sentence.split()


class Control:
    """A control loop that never waits for words: how long each step took, and what was said."""

    def __init__(self, speaker):
        self.speaker, self.seconds, self.said = speaker, [], []

    def run(self, contexts, steps):
        """Begins to say each context in turn, ``steps`` steps for each."""
        for context in contexts:
            pending = None
            for step in range(steps):
                start = time.perf_counter()
                if step == 0:
                    pending = self.speaker.begin(context)
                elif pending is not None and (sentence := pending.take()) is not None:
                    self.said.append((context, sentence))
                    pending = None
                self.seconds.append(time.perf_counter() - start)
                time.sleep(0.002)  # the rest of the period
            if pending is not None:
                self.said.append((context, pending.wait()))


@pytest.mark.parametrize(
    ("behaviour", "worded"),
    [("good", True), ("slow", False), ("other side", False), ("500", False),
     ("malformed", False), ("empty", False), ("silent", False), (None, False)],
)  # fmt: skip
def test_a_server_never_delays_the_loop_nor_says_a_wrong_side(stub, good_answer, behaviour, worded, caplog):
    """A few utterances of each behaviour; benchmarks/speaker.py says two hundred and times the steps."""
    pytest.importorskip("openai", reason="needs the extra language")
    from jaxnav.language.llm import LanguageModel

    server = stub(good_answer)
    server.behaviour = behaviour
    url = server.url if behaviour is not None else "http://127.0.0.1:9/v1"
    speaker = LanguageModelSpeaker(LanguageModel(url, "m", "key", limit=0.3))
    control = Control(speaker)
    contexts = [
        Context(request, who) for request, who in itertools.product((RIGHT, LEFT, STOP), ("robot", "pedestrian"))
    ]
    control.run(contexts, steps=10)
    assert [context for context, _ in control.said] == contexts
    for context, sentence in control.said:
        assert expresses(sentence, context) == sentence
        assert (sentence not in sentences(context)) == worded, sentence
    if not worded:
        assert "falling back" in caplog.text


def test_what_was_said_well_is_kept(stub, good_answer):
    pytest.importorskip("openai", reason="needs the extra language")
    from jaxnav.language.llm import LanguageModel

    server = stub(good_answer)
    speaker = LanguageModelSpeaker(LanguageModel(server.url, "m", "key"))
    first = speaker.say(Context(RIGHT))
    assert speaker.say(Context(RIGHT)) == first
    assert len(server.asked) == 1
