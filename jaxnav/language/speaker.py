"""Lang_GenNet: the robot's intention in words, by templates or by a language model whose sentences are checked."""

import re
from typing import Any, NamedTuple

from ..world.types import AGREES, LEFT, NONE, REFUSES, RIGHT, STOP
from .llm import Answered, Asked, LanguageModel
from .sides import clean

_LONGEST = 120  # characters that are spoken


class Context(NamedTuple):
    """The meaning of a sentence of the robot.

    request:  index into `REQUESTS`.
    asked_by: robot: it asks for ``request``, or acknowledges the ``reply`` to it; pedestrian: it was asked for
              ``request`` and does it; nobody: it did not understand and asks to repeat.
    reply:    index into `REPLIES`.
    """

    request: int
    asked_by: str = "robot"
    reply: int = NONE


REPEAT = Context(NONE, "nobody")

_SIDES = {RIGHT: "right", LEFT: "left"}


class RequestWords(NamedTuple):
    """The words of one request.

    short: of captions, two or three words.
    ask:   to a person, after "Ask the person to".
    do:    by the robot, after "Say that you will".
    asks:  sentences by which the robot asks for it.
    does:  sentences of a robot, or in captions of a person, that was asked and does it.
    """

    short: str
    ask: str
    do: str
    asks: tuple[str, ...]
    does: tuple[str, ...]


def _side_words(side):
    return RequestWords(
        f"move {side}", f"move to your {side}", f"move to my {side}",
        (
            f"Please move to your {side}!", f"Could you keep to your {side}, please?",
            f"Excuse me, would you go to your {side}?", f"Would you please pass on your {side}?",
            f"Please keep {side}, then we can both pass.",
        ),
        (
            f"OK, I'll move to my {side}!", f"Sure, I'll keep to my {side}.",
            f"Thanks for telling me, I'll go to my {side}.", f"Of course, I'm going to my {side}.",
        ),
    )  # fmt: skip


# By index into `REQUESTS`; what a pedestrian may ask of the robot has the same indices in `MESSAGES`.
REQUEST_WORDS = {
    STOP: RequestWords(
        "stop", "stop and let you pass", "stop to let them pass",
        (
            "Please stop and let me pass!", "Could you wait a moment, please?",
            "Excuse me, could you stop for me, please?", "Would you please let me go first?",
            "One moment, please: could you stop for a second?",
        ),
        (
            "OK, I will stop to let you pass.", "Sure, I'll wait. After you!", "Of course, I'll stop for you.",
            "Certainly, I'm stopping. Go ahead!",
        ),
    ),
    RIGHT: _side_words("right"),
    LEFT: _side_words("left"),
}  # fmt: skip
_ANSWERS = {
    AGREES: ("Thank you!", "Thanks a lot!", "That's very kind, thank you.", "Thanks, have a nice day!"),
    REFUSES: (
        "No problem, I'll stop and wait.", "Alright, I'll wait for you.", "Sorry! Please go first, I'll wait.",
        "Of course, I'll stop. After you!",
    ),
}  # fmt: skip
_REPEATS = (
    "Sorry, I didn't understand. Could you say that again?", "Pardon? Could you repeat that, please?",
    "I'm not sure what you mean. Could you say it another way?",
)  # fmt: skip


class TemplateSpeaker:
    """Sentences of our own, in turns: offline, varied, polite, and never of the wrong side."""

    def __init__(self) -> None:
        self._turn = 0

    def begin(self, context: Context) -> Answered[str]:
        """`Answered` with a sentence."""
        return Answered(self.say(context))

    def say(self, context: Context) -> str:
        """A sentence that expresses ``context``. ValueError: there is nothing to say."""
        self._turn += 1
        choices = sentences(context)
        return choices[self._turn % len(choices)]


def sentences(context: Context) -> tuple[str, ...]:
    """All templates of a context. ValueError: it has no meaning."""
    words, found = REQUEST_WORDS.get(context.request), ()
    if context.asked_by == "nobody":
        found = _REPEATS
    elif context.asked_by == "robot" and context.reply != NONE:
        found = _ANSWERS[context.reply]
    elif words is not None:
        found = words.asks if context.asked_by == "robot" else words.does
    if not found:
        raise ValueError(f"context is {context}: there is nothing to say")
    return found


_DENIALS = re.compile(
    r"n't\b|\b(?:not|never|nor|neither|none|without|instead|cannot|dont|wont|cant|refuse|avoid|away|but|except|opposite"
    r"|nothing|unable|rather|than|no(?! (?:problem|worries|rush|hurry)))\b"
)
_STOPS = re.compile(r"\b(?:stop|stopping|wait|waiting|hold on|pause|stand still|after you|go first)\b")
# Whose the side is, right before it; "keep right" is everybody's.
_OWNED = re.compile(r"\b(?:(my|your)|(?:move|go|keep|step|pass|stay|walk|turn)) (?:left|right)\b")
_MOVES = re.compile(r"\b(?:move|go|keep|step|pass|stay|turn|walk|shift|going|moving|keeping|passing)\b")
_SELF = re.compile(r"\b(?:i|i'll|i'm|i am)\b")
_THANKS = re.compile(r"\b(?:thank|thanks|appreciate|kind|grateful)\b")
_ORDERS = re.compile(r"\b(?:must|should|have to|need to|you keep|you move|you go|you stop|you wait)\b")
# Who speaks of these does something else than it was told to.
_FORBIDDEN = re.compile(
    r"\b(?:fast|faster|speed|ignore|rules?|instructions?|hit|crash|run|over|kill|hurt|idiot|stupid|hell|damn|own)\b"
    r"|[{}<>\[\]]|https?:"
)


def expresses(text: Any, context: Context) -> str:
    """The sentence in ``text``, if it may be spoken. ValueError: it may not, for it names a wrong side, denies...

    Strict on purpose: refusing a good sentence costs nothing, since there is a template.
    """
    if not isinstance(text, str):
        raise ValueError(f"the answer is no text but {type(text).__name__}")
    sentence = clean(text).strip("\"'\u201c\u201d ")
    words = sentence.lower()
    if not words or not any(c.isalpha() for c in words):
        raise ValueError("the answer is empty")
    if len(sentence) > _LONGEST or len(text) > 2 * _LONGEST:
        raise ValueError(f"the answer is longer than {_LONGEST} characters")
    if not sentence.isascii() or _FORBIDDEN.search(words):
        raise ValueError(f"the answer is not what a robot says: {sentence!r}")
    if context.asked_by == "nobody":
        _check_sides(sentence, words, None, "")
        if "?" not in sentence:
            raise ValueError(f"the answer asks nothing: {sentence!r}")
        return sentence
    if _DENIALS.search(words):
        raise ValueError(f"the answer denies: {sentence!r}")
    if context.reply == AGREES:
        _check_sides(sentence, words, None, "")
        if not _THANKS.search(words):
            raise ValueError(f"the answer gives no thanks: {sentence!r}")
        return sentence
    asks = context.asked_by == "robot" and context.reply == NONE
    wanted = None if context.reply == REFUSES else _SIDES.get(context.request)
    _check_sides(sentence, words, wanted, "your" if asks else "my")
    if wanted and not _MOVES.search(words):
        raise ValueError(f"the answer names a side and no move: {sentence!r}")
    if not wanted and not _STOPS.search(words):
        raise ValueError(f"the answer says nothing of stopping: {sentence!r}")
    if asks and _SELF.search(words):
        raise ValueError(f"the answer asks nothing of the other: {sentence!r}")
    if not asks and (_ORDERS.search(words) or not _SELF.search(words)):
        raise ValueError(f"the answer does not say what I do: {sentence!r}")
    return sentence


def _check_sides(sentence: str, words: str, wanted: str | None, owner: str) -> None:
    """ValueError unless ``wanted``, a side or None, is all that is named, and it is the owner's: "my" or "your"."""
    named = re.findall(r"\b(?:left|right)\b", words)
    if set(named) != ({wanted} if wanted else set()):
        found = " and ".join(sorted(set(named))) or "no side"
        raise ValueError(f"the answer names {found} for {wanted or 'none'}: {sentence!r}")
    owned = [match[1] for match in _OWNED.finditer(words)]
    if len(owned) != len(named) or any(who not in (None, owner) for who in owned):
        raise ValueError(f"the answer may speak of the other's {wanted}: {sentence!r}")


_SYSTEM = (
    "You are the voice of a small delivery robot that meets a person in a corridor. Reply with one short, polite "
    "English sentence to speak, at most 15 words, without quotes. Say exactly what you are told, with that side."
)
_MEANINGS = {
    ("robot", NONE): "Ask the person to {ask}.",
    ("robot", AGREES): "The person agreed to {ask}. Thank them, without naming a side.",
    ("robot", REFUSES): "The person refused to {ask}. Say that you will stop and wait for them.",
    ("pedestrian", NONE): "The person asked you to {do}. Say that you will {do}.",
    ("nobody", NONE): "You did not understand the person. Ask them to repeat.",
}


class LanguageModelSpeaker:
    """A language model words the sentence; where its answer is wrong or late, a template is said instead."""

    def __init__(self, model: LanguageModel, templates: TemplateSpeaker | None = None) -> None:
        self._model, self._templates = model, templates or TemplateSpeaker()
        self._said: dict[Context, str] = {}

    def begin(self, context: Context) -> Asked[str] | Answered[str]:
        """`Asked` about a sentence; a context that was worded before gets the same sentence again."""
        if context in self._said:
            return Answered(self._said[context])
        words = REQUEST_WORDS.get(context.request)
        ask, do = (words.ask, words.do) if words else ("", "")
        if context.asked_by == "robot":  # to "their" right, in words that the person may be told
            ask = ask.replace("let you", "let the robot")
        question = _MEANINGS[context.asked_by, context.reply].format(ask=ask, do=do)
        return self._model.ask(
            _SYSTEM, question, lambda text: expresses(text, context), lambda: self._templates.say(context), "speaker",
            lambda sentence: self._said.setdefault(context, sentence),
        )  # fmt: skip

    def say(self, context: Context) -> str:
        """The sentence, after at most the model's time limit."""
        return self.begin(context).wait()
