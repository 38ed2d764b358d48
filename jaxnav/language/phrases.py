"""The phrases that people say: phrases.csv, checked.

A phrase belongs to a sentence pattern, and a whole pattern to one split: no test phrase shares its pattern with
training.
"""

import csv
import hashlib
import pathlib
from typing import NamedTuple

from ..errors import UserError
from ..world.types import LEFT, MESSAGES, REPLIES, RIGHT
from .sides import LONGEST, clean, key_of, without_side

PHRASES = pathlib.Path(__file__).parent / "phrases.csv"
KINDS = (
    "request", "implicit cue", "warning", "negation", "small talk", "reply", "speech-recognition error",
)  # fmt: skip
SPLITS = ("train", "validation", "test")
_COLUMNS = ("text", "message", "kind", "reply", "pattern", "split")


class Phrase(NamedTuple):
    """A phrase.

    text:    the sentence.
    message: index into `MESSAGES`.
    kind:    one of `KINDS`.
    reply:   index into `REPLIES`.
    pattern: the sentence with its slots, [side] and {one|other}.
    split:   one of `SPLITS`.
    """

    text: str
    message: int
    kind: str
    reply: int
    pattern: str
    split: str


def read_phrases(path: str | pathlib.Path = PHRASES) -> list[Phrase]:
    """The `Phrase` s of a file. UserError names file, line, value and remedy.

    Errors are an unknown message, kind, reply or split, a phrase that is empty, too long or repeated, a pattern in two
    splits, and a split in which a message has no phrase.
    """
    try:
        with open(path, newline="", encoding="utf-8") as file:
            table = csv.DictReader(file)
            missing = [name for name in _COLUMNS if name not in (table.fieldnames or ())]
            if missing:
                raise UserError(f"{path} has no column {', '.join(missing)}: give {', '.join(_COLUMNS)}")
            rows = [(table.line_num, row) for row in table]
    except OSError as error:
        raise UserError(f"{path} can't be read ({error.strerror}): give a file of phrases") from error
    except (UnicodeDecodeError, csv.Error) as error:
        raise UserError(f"{path} can't be read ({error}): save it as CSV in UTF-8") from error
    phrases, seen, splits = [], {}, {}
    for line, row in rows:
        phrase = _phrase(f"{path}:{line}", row)
        key = key_of(phrase.text)
        if key in seen:
            where, split = seen[key]
            across = "" if split == phrase.split else f", in split {split}"
            raise UserError(f"{path}:{line}: {phrase.text!r} is there already, on line {where}{across}: drop one")
        seen[key] = line, phrase.split
        where, split = splits.setdefault(phrase.pattern, (line, phrase.split))
        if split != phrase.split:
            raise UserError(
                f"{path}:{line}: pattern {phrase.pattern!r} is in split {phrase.split}, and in {split} on line "
                f"{where}: give all its phrases one split"
            )
        phrases.append(phrase)
    for split in SPLITS:
        for index, message in enumerate(MESSAGES):
            if not any(phrase.split == split and phrase.message == index for phrase in phrases):
                raise UserError(f"{path} has no phrase for {message!r} in split {split}: add one")
    return phrases


def _phrase(where: str, row: dict[str, str]) -> Phrase:
    def index(column: str, choices: tuple[str, ...]) -> int:
        value = (row[column] or "").strip()
        if value not in choices:
            raise UserError(f"{where}: {column} is {value!r}: choose from {', '.join(choices)}")
        return choices.index(value)

    text, pattern = row["text"] or "", (row["pattern"] or "").strip()
    if not clean(text):
        raise UserError(f"{where}: text is empty: write a phrase, or delete the line")
    if len(text) > LONGEST:
        raise UserError(f"{where}: text has {len(text)} characters: give at most {LONGEST}")
    if not pattern:
        raise UserError(f"{where}: pattern is empty: give the sentence with its slots, or the text itself")
    message = index("message", MESSAGES)
    if message in (RIGHT, LEFT) and without_side(text)[1] == 0:
        raise UserError(f"{where}: message is {MESSAGES[message]!r}, but {text!r} names no side: name left or right")
    return Phrase(
        text=text,
        message=message,
        kind=KINDS[index("kind", KINDS)],
        reply=index("reply", REPLIES),
        pattern=pattern,
        split=SPLITS[index("split", SPLITS)],
    )


def hash_of(phrases: list[Phrase]) -> str:
    """SHA-256 of the phrases: a table of embeddings depends on it."""
    content = "\n".join("\t".join(map(str, phrase)) for phrase in phrases)
    return hashlib.sha256(content.encode()).hexdigest()
