"""The phrases that come with jaxnav, and files of phrases that are wrong."""

import collections
import csv
import re

import pytest

from jaxnav.errors import UserError
from jaxnav.language.phrases import KINDS, PHRASES, SPLITS, read_phrases
from jaxnav.language.sides import key_of
from jaxnav.world.types import LEFT, MESSAGES, RIGHT, STOP

phrases = read_phrases()
HEADER = PHRASES.read_text().splitlines()[0]


def test_there_are_enough_of_every_kind_in_every_split():
    assert len({key_of(phrase.text) for phrase in phrases}) == len(phrases) >= 1000
    assert len({phrase.pattern for phrase in phrases}) >= 120
    found = collections.Counter((phrase.split, phrase.kind) for phrase in phrases)
    assert set(found) == {(split, kind) for split in SPLITS for kind in KINDS}


def test_no_pattern_is_in_two_splits_nor_a_sentence_but_for_its_side():
    """Also not in disguise: without sides, case and punctuation no sentence of one split is in another."""

    def bare(text):
        return " ".join(re.findall(r"\w+", re.sub(r"\b(left|right)\b", "side", text.lower())))

    for key in (lambda phrase: phrase.pattern, lambda phrase: (bare(phrase.text), phrase.message in (RIGHT, LEFT))):
        splits = collections.defaultdict(set)
        for phrase in phrases:
            splits[key(phrase)].add(phrase.split)
        assert [name for name, found in splits.items() if len(found) > 1] == []


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("Could you let me pass first?", STOP),
        ("I'm in a hurry", STOP),
        ("I am already late for my work", STOP),
        ("Please move to your right", RIGHT),
        ("Watch out on your right!", LEFT),
        ("I'm moving towards your right side", LEFT),
        ("Not left, the other way", RIGHT),
        ("You're right", MESSAGES.index("silence")),
    ],
)
def test_the_phrases_of_the_paper_are_in_the_test_split(text, message):
    (phrase,) = [phrase for phrase in phrases if key_of(phrase.text) == key_of(text)]
    assert (phrase.message, phrase.split) == (message, "test")


def test_a_warning_and_a_request_that_name_a_side_mean_different_ones():
    for phrase in phrases:
        named = set(re.findall(r"\b(left|right)\b", phrase.text.lower()))
        if phrase.kind in ("request", "warning") and phrase.message in (RIGHT, LEFT) and len(named) == 1:
            side = MESSAGES[phrase.message].removeprefix("robot ")
            assert (side in named) == (phrase.kind == "request"), phrase.text


GOOD = [
    f"{split} {side},{message},request,none,{split} {side},{split}"
    for split in SPLITS
    for side, message in zip(("silence", "stop", "right", "left"), MESSAGES, strict=True)
]


def more(*lines):
    return [*GOOD, *lines]


@pytest.mark.parametrize(
    ("lines", "complaint"),
    [
        (more("Hi,robot dance,request,none,Hi,train"), r":14: message is 'robot dance': choose from"),
        (more("Hi,silence,song,none,Hi,train"), r":14: kind is 'song': choose from"),
        (more("Hi,silence,reply,maybe,Hi,train"), r":14: reply is 'maybe': choose from"),
        (more("Hi,silence,reply,none,Hi,exam"), r":14: split is 'exam': choose from"),
        (more(" ,silence,reply,none,Hi,train"), r":14: text is empty"),
        (more("Hi,silence,reply,none,,train"), r":14: pattern is empty"),
        (more(f"{'ha' * 150},silence,reply,none,Hi,train"), r":14: text has 300 characters: give at most"),
        (more("Go on,robot left,request,none,Hi,train"), r"'Go on' names no side: name left or right"),
        (more("TRAIN  silence,silence,reply,none,x,test"), r"is there already, on line \d+, in split train"),
        (more("Hi,silence,reply,none,train silence,test"), r":14: pattern 'train silence' is in split test"),
        ([line for line in GOOD if ",validation" not in line], r"no phrase for 'silence' in split validation"),
        ([], r"no phrase for 'silence' in split train: add one"),
    ],
)
def test_a_wrong_file_is_refused_in_one_line(tmp_path, lines, complaint):
    path = tmp_path / "phrases.csv"
    path.write_text("\n".join([HEADER, *lines]) + "\n")
    with pytest.raises(UserError, match=complaint) as error:
        read_phrases(path)
    assert "\n" not in str(error.value) and str(path) in str(error.value)


def test_a_right_file_is_read(tmp_path):
    path = tmp_path / "phrases.csv"
    path.write_text("\n".join([HEADER, *GOOD]) + "\n")
    assert len(read_phrases(path)) == 12


def test_a_file_that_is_none_is_refused(tmp_path):
    with pytest.raises(UserError, match="can't be read"):
        read_phrases(tmp_path / "missing.csv")
    (tmp_path / "other.csv").write_text("a,b\n1,2\n")
    with pytest.raises(UserError, match="has no column text, message, kind, reply, pattern, split"):
        read_phrases(tmp_path / "other.csv")
    (tmp_path / "binary.csv").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(UserError, match="save it as CSV in UTF-8"):
        read_phrases(tmp_path / "binary.csv")


def test_the_csv_is_plain():
    with open(PHRASES, newline="", encoding="utf-8") as file:
        assert all(len(row) == 6 for row in csv.reader(file))
