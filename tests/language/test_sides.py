"""Left and right taken out of sentences."""

import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxnav.language.sides import LONGEST, clean, has_words, without_side

WORDS = st.sampled_from(["left", "right", "go", "not", "your", "the", "write", "Left!", "bright", "leftover", "RIGHT"])


def mirror(text):
    return re.sub(
        r"\b(left|right)\b", lambda m: {"left": "right", "right": "left"}[m[0].lower()], text, flags=re.IGNORECASE
    )


@given(st.lists(WORDS, max_size=8).map(" ".join))
def test_mirrored_sentences_say_the_same_of_the_other_side(text):
    text = text.replace("write", "road")  # which only ever stands for right
    said, side = without_side(text)
    assert without_side(mirror(text)) == (said, -side)
    assert (side == 0) == (re.search(r"\b(left|right)\b", text.lower()) is None)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("Go LEFT, not right!", ("go right, not left!", -1)),
        ("Please stop", ("please stop", 0)),
        ("my leftovers are bright", ("my leftovers are bright", 0)),
        ("Move to your write", ("move to your right", 1)),
        ("move to your lef", ("move to your right", -1)),
        ("I write letters", ("i write letters", 0)),
        ("I lefd my bag", ("i lefd my bag", 0)),
    ],
)
def test_the_first_side_decides(text, expected):
    assert without_side(text) == expected


@given(st.text(max_size=600))
def test_clean_is_one_short_printable_line(text):
    cleaned = clean(text)
    assert len(cleaned) <= LONGEST
    assert cleaned == cleaned.strip() and "\n" not in cleaned and "\x00" not in cleaned
    assert clean(cleaned) == cleaned


@pytest.mark.parametrize(
    ("text", "expected"),
    [("go", True), ("42", True), ("", False), ("...", False), ("\N{THUMBS UP SIGN}", False), ("привет", False)],
)
def test_has_words(text, expected):
    assert has_words(text) is expected
