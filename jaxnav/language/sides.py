"""Left and right taken out of a sentence: what is said, and about which side.

"Go left" and "go right" differ in one word, and a sentence encoder puts them next to each other (cosine 0.88). So the
encoder never sees which side it is: a sentence whose first side is left is mirrored before it is embedded, and the side
travels beside the vector as a number. What is learnt about one side then holds for the other, exactly.

Written for Python 3.6: this file travels in the bundle of an exported policy.
"""

import re
import unicodedata
from typing import Tuple

LONGEST = 200  # characters of a sentence that are read

_SIDE = re.compile(r"\b(left|right)\b")
_OTHER = {"left": "right", "right": "left"}
# What speech recognition writes for a side ("I lefd my bag" is none); "write" and "rite" only where one is expected.
_LEFT = re.compile(r"\b(?:leff?t?|laft|lefts|(?<!i )lefd)\b")
_RIGHT = re.compile(r"\b(your|you're|yore|the|to|too|two|keep|not|on|go) (?:write|rite|rights)\b")


def clean(text: str) -> str:
    """``text`` as one line: control characters dropped, white space collapsed, `LONGEST` characters at most."""
    text = unicodedata.normalize("NFKC", text[: 8 * LONGEST])
    text = "".join(" " if unicodedata.category(c) in ("Zs", "Cc", "Zl", "Zp") else c for c in text)
    text = "".join(c for c in text if unicodedata.category(c)[0] != "C")
    return " ".join(text.replace("\u2019", "'").split())[:LONGEST]


def key_of(text: str) -> str:
    """The text by which phrases are compared: without case and white space."""
    return clean(text).casefold()


def has_words(text: str) -> bool:
    """Whether at least half of its letters and digits are Latin: an emoji, "..." or Cyrillic is silence."""
    letters = [c for c in text if c.isalnum()]
    return 2 * sum(c < "\x80" for c in letters) >= len(letters) > 0


def without_side(text: str) -> Tuple[str, int]:
    """(said, side): the sentence with right as its first side, and the side it had: 1 right, -1 left, 0 none."""
    said = _RIGHT.sub(r"\1 right", _LEFT.sub("left", clean(text).lower()))
    first = _SIDE.search(said)
    if first is None:
        return said, 0
    if first[0] == "right":
        return said, 1
    return _SIDE.sub(lambda match: _OTHER[match[0]], said), -1
