"""The atomic writer: the old file or the new one, never a part, and nothing beside it."""

import errno

import pytest

from jaxnav.errors import UserError
from jaxnav.files import write_atomically, write_json


def test_bytes_text_functions_and_json_are_written(tmp_path):
    write_atomically(tmp_path / "a.bin", b"\0\1")
    write_atomically(tmp_path / "b.txt", "ä")
    write_atomically(tmp_path / "c.png", lambda path: path.write_bytes(path.suffix.encode()))
    write_json(tmp_path / "d.json", {"a": [1]})
    assert (tmp_path / "a.bin").read_bytes() == b"\0\1"
    assert (tmp_path / "b.txt").read_text(encoding="utf-8") == "ä"
    assert (tmp_path / "c.png").read_bytes() == b".png"
    assert (tmp_path / "d.json").read_text() == '{\n "a": [\n  1\n ]\n}\n'
    assert len(list(tmp_path.iterdir())) == 4


@pytest.mark.parametrize(
    ("error", "expected", "match"),
    [
        (OSError(errno.ENOSPC, "No space left on device"), UserError, r"f\.txt can't be written \(No space.*free some"),
        (RuntimeError("broken"), RuntimeError, "broken"),
    ],
)
def test_what_fails_leaves_the_old_file_and_nothing_else(tmp_path, error, expected, match):
    path = tmp_path / "f.txt"
    path.write_text("old")

    def fail(temporary):
        temporary.write_text("half")
        raise error

    with pytest.raises(expected, match=match):
        write_atomically(path, fail)
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]
