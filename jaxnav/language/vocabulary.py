"""The vocabulary: (message, utterance) -> the vector of a phrase, as a pure function on the device."""

import chex
import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from ..world.types import MESSAGES
from .phrases import SPLITS
from .table import DIMENSIONS, Table, default_table

ERROR = "speech-recognition error"
_NOISES = 1024


@struct.dataclass
class Vocabulary:
    """The phrases of a table, of which those of one split are drawn.

    The N phrases are ordered by split, message and, within a message, recognition errors last.

    said:        `[M, DIMENSIONS]` vectors of the distinct sentences.
    row:         `[N]` row of each phrase in ``said``.
    side:        `[N]` side of each phrase.
    message:     `[N]` message of each phrase.
    reply:       `[N]` reply of each phrase.
    first:       `[4]` index of a message's first phrase in the split.
    clean:       `[4]` number of its phrases without a recognition error.
    errors:      `[4]` number of its phrases with one.
    error_share: share of draws with a recognition error.
    noise:       norm of the noise that is added to a vector.
    noises:      `[n, DIMENSIONS]` noise of norm 1 to draw from.
    """

    said: chex.Array
    row: chex.Array
    side: chex.Array
    message: chex.Array
    reply: chex.Array
    first: chex.Array
    clean: chex.Array
    errors: chex.Array
    error_share: chex.Array
    noise: chex.Array
    noises: chex.Array

    def look_up(self, message: jax.Array, utterance: jax.Array) -> jax.Array:
        """Vectors `[..., DIMENSIONS + 1]` of the phrases; zero where ``utterance`` is 0.

        Phrase, recognition error and noise are functions of the utterance: a message that is held keeps its vector.
        """
        return self.vectors(*self.phrase(message, utterance)) * (utterance != 0)[..., None]

    def phrase(self, message: jax.Array, utterance: jax.Array) -> tuple[jax.Array, jax.Array]:
        """(index of the phrase, a random uint32) for a message and an utterance."""
        word = _scramble(jnp.asarray(utterance, jnp.uint32))
        errors, clean = jnp.asarray(self.errors)[message], jnp.asarray(self.clean)[message]
        # The upper half of the bits decides on a recognition error, all bits on the phrase.
        garbled = (word >> 16).astype(jnp.float32) < self.error_share * 65536.0
        garbled = (garbled & (errors > 0)) | (clean == 0)
        count, start = jnp.where(garbled, errors, clean), jnp.where(garbled, clean, 0)
        word = _scramble(word)
        picked = (word % count.astype(jnp.uint32)).astype(jnp.int32)
        return jnp.asarray(self.first)[message] + start + picked, _scramble(word)

    def vectors(self, index: jax.Array, word: jax.Array) -> jax.Array:
        """Vectors of the phrases ``index``, with the noise that ``word`` picks."""
        said = jnp.asarray(self.said)[jnp.asarray(self.row)[index]]
        said += self.noise * jnp.asarray(self.noises)[(word % _NOISES).astype(jnp.int32)]
        side = jnp.asarray(self.side)[index].astype(jnp.float32)
        return jnp.concatenate([said, side[..., None]], axis=-1)


def vocabulary(
    split: str = "train", error_share: float = 0.0, noise: float = 0.0, table: Table | None = None
) -> Vocabulary:
    """The `Vocabulary` of a split. ValueError: there is no such split.

    Vocabularies of one table have one shape: a compiled program takes any of them.
    """
    if split not in SPLITS:
        raise ValueError(f"split is {split!r}: choose from {', '.join(SPLITS)}")
    table = default_table() if table is None else table

    def place(i: int) -> tuple[int, int, bool]:
        phrase = table.phrases[i]
        return SPLITS.index(phrase.split), phrase.message, phrase.kind == ERROR

    order = sorted(range(len(table.phrases)), key=place)
    places = np.array([place(i) for i in order])
    here = places[:, 0] == SPLITS.index(split)
    blocks = [here & (places[:, 1] == message) for message in range(len(MESSAGES))]
    noises = np.random.default_rng(0).normal(size=(_NOISES, DIMENSIONS)) / np.sqrt(DIMENSIONS)
    return Vocabulary(
        said=table.said.astype(np.float32), row=table.row[order], side=table.side[order],
        message=np.array([table.phrases[i].message for i in order], np.int8),
        reply=np.array([table.phrases[i].reply for i in order], np.int8),
        first=np.array([np.argmax(block) for block in blocks], np.int32),
        clean=np.array([np.sum(block & (places[:, 2] == 0)) for block in blocks], np.int32),
        errors=np.array([np.sum(block & (places[:, 2] == 1)) for block in blocks], np.int32),
        error_share=np.float32(error_share), noise=np.float32(noise), noises=noises.astype(np.float32),
    )  # fmt: skip


def _scramble(word: jax.Array) -> jax.Array:
    """A bijection of uint32 whose result looks random (the finaliser of MurmurHash3)."""
    word = (word ^ (word >> 16)) * jnp.uint32(0x85EBCA6B)
    word = (word ^ (word >> 13)) * jnp.uint32(0xC2B2AE35)
    return word ^ (word >> 16)
