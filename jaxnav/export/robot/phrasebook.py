"""Sentences -> the vectors that the policy understands: those it knows by heart, and any other by a sentence encoder.

The encoder is not part of the bundle and doesn't belong into the control loop's process: it takes milliseconds to
seconds. contract.json says under "language" which it is. Written for Python 3.6.
"""

import csv
import io
import re

import numpy as np
from bundle import HERE, BundleError, load_arrays, load_contract, read_file
from sides import has_words, key_of, without_side


class Phrasebook:
    """The phrases of a bundle. BundleError: it is damaged, or its policy hears messages by name and no words."""

    def __init__(self, bundle=HERE):
        contract = load_contract(bundle)
        if contract["language"] is None:
            raise BundleError(
                "this policy hears messages by name, no words: give Navigator.step one of its messages by name"
            )
        self.dimensions = contract["language"]["dimensions"]
        self._table = load_arrays(bundle, contract, "embeddings.npz")
        text = read_file(bundle, contract, "phrases.csv").decode("utf-8")
        self.phrases = [row["text"] for row in csv.DictReader(io.StringIO(text, newline=""))]
        self._rows = {}
        for key in (key_of, _spoken):  # as it is written, and as speech recognition writes it
            for row, text in enumerate(self.phrases):
                self._rows.setdefault(key(text), row)

    def look_up(self, text):
        """The vector [D] of a sentence that is known by heart, with or without its punctuation, or that says nothing;
        None: it is not known."""
        if not has_words(text):
            return np.zeros(self.dimensions, np.float32)
        row = self._rows.get(key_of(text), self._rows.get(_spoken(text)))
        if row is None:
            return None
        said = self._table["said"][self._table["row"][row]].astype(np.float32)
        return np.append(said, np.float32(self._table["side"][row]))

    def to_embed(self, text):
        """(sentence, side): what the sentence encoder is to be given for ``text``, and the side that it names."""
        return without_side(text)

    def vector(self, features, side):
        """The vector [D] of what `to_embed` gave: features: what the encoder made of the sentence; side: as given."""
        features = np.asarray(features, np.float32)
        if features.shape != self._table["centre"].shape:
            expected = list(self._table["centre"].shape)
            raise ValueError(
                "features have shape %s: give %s numbers of the contract's encoder" % (list(features.shape), expected)
            )
        said = (features - self._table["centre"]) @ self._table["components"].astype(np.float32)
        said = (said / max(float(np.linalg.norm(said)), 1e-6)).astype(np.float16)
        return np.append(said.astype(np.float32), np.float32(side))


def _spoken(text):
    """The words of a sentence, without capitals and punctuation."""
    return " ".join(re.sub(r"[^\w']+", " ", key_of(text)).split())
