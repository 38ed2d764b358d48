"""Which phrase is said for a message and an utterance."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxnav.language.table import default_table
from jaxnav.language.vocabulary import ERROR, vocabulary
from jaxnav.world.types import MESSAGES

table = default_table()
UTTERANCES = np.arange(1, 65537, 7, dtype=np.uint32)
VECTORS = table.vectors()


def spoken(split, message, **options):
    """The phrases that the utterances become."""
    words = vocabulary(split, **options)
    index, _ = jax.jit(lambda v, u: v.phrase(jnp.full(u.shape, message), u))(words, UTTERANCES)
    order = sorted(range(len(table.phrases)), key=lambda i: _place(table.phrases[i]))
    return [table.phrases[order[i]] for i in np.asarray(index)]


def _place(phrase):
    return ("train", "validation", "test").index(phrase.split), phrase.message, phrase.kind == ERROR


@pytest.mark.parametrize("split", ["train", "validation", "test"])
def test_only_phrases_of_the_split_and_of_the_message_are_said(split):
    for message in range(len(MESSAGES)):
        said = spoken(split, message)
        assert {(phrase.split, phrase.message) for phrase in said} == {(split, message)}
        assert ERROR not in {phrase.kind for phrase in said}
        there = {p for p in table.phrases if (p.split, p.message) == (split, message) and p.kind != ERROR}
        assert set(said) == there, "every one of them is said some time"


@pytest.mark.parametrize("share", [0.25, 1.0])
def test_so_many_are_garbled(share):
    said = spoken("train", 2, error_share=share)
    assert np.mean([phrase.kind == ERROR for phrase in said]) == pytest.approx(share, abs=0.02)
    assert {phrase.message for phrase in said} == {2}


def test_vectors_are_those_of_the_phrases_and_silence_is_zero():
    words = vocabulary("test")
    look_up = jax.jit(lambda v, m, u: v.look_up(m, u))
    messages = np.array([1, 2, 3, 0, 0, 2])
    utterances = np.array([5, 6, 7, 8, 0, 0], np.uint32)
    vectors = np.asarray(look_up(words, messages, utterances))
    assert (vectors[4:] == 0).all()
    for vector, message in zip(vectors[:4], messages, strict=False):
        (i,) = np.flatnonzero((vector == VECTORS).all(axis=1))[:1]
        same = [table.phrases[j] for j in np.flatnonzero((vector == VECTORS).all(axis=1))]
        assert (message, "test") in {(phrase.message, phrase.split) for phrase in same}, table.phrases[i]


def test_noise_has_its_norm_and_leaves_the_side_and_silence_alone():
    quiet, loud = vocabulary("train"), vocabulary("train", noise=0.5)
    assert jax.tree.structure(quiet) == jax.tree.structure(loud)
    messages, utterances = np.full(UTTERANCES.shape, 2), UTTERANCES
    plain, noisy = (np.asarray(v.look_up(messages, utterances)) for v in (quiet, loud))
    norms = np.linalg.norm((noisy - plain)[:, :-1], axis=1)
    assert norms.mean() == pytest.approx(0.5, rel=0.02)
    np.testing.assert_array_equal(noisy[:, -1], plain[:, -1])
    assert (np.asarray(loud.look_up(np.array(0), np.uint32(0))) == 0).all()
    again = np.asarray(loud.look_up(messages, utterances))
    np.testing.assert_array_equal(noisy, again)  # a message that is held sounds the same at every step


def test_an_unknown_split_is_refused():
    with pytest.raises(ValueError, match="split is 'exam': choose from train, validation, test"):
        vocabulary("exam")
