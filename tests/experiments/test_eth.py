"""The reader of the ETH format: what it understands, and what it says of files it doesn't."""

import numpy as np
import pytest

from experiments.calibration import eth
from jaxnav.errors import UserError


def row(frame, person, x, y):
    return f"{frame:.7e} {person:.7e} {x:.7e} 0 {y:.7e} 9 0 9"


def written(tmp_path, *rows):
    path = tmp_path / "obsmat.txt"
    path.write_text("\n".join(rows) + "\n")
    return path


def test_positions_stand_at_their_instant_and_everything_else_is_missing(tmp_path):
    path = written(tmp_path, row(786, 7, 3, 4), row(780, 7, 1, 2), row(786, 2, 5, 6), row(792, 2, 7, 8))
    recording = eth.read(path)
    assert recording.ids.tolist() == [7, 2]  # in the order of appearance
    nan = np.nan
    expected = [[[1, 2], [nan, nan]], [[3, 4], [5, 6]], [[nan, nan], [7, 8]]]
    np.testing.assert_array_equal(recording.position, expected)
    assert recording.destinations.shape == (0, 2)
    assert recording.groups.tolist() == [0, 1]


def test_a_break_of_the_annotation_is_never_bridged(tmp_path):
    """Whether frames are missing or come too early: the instants before and after are not neighbours."""
    frames = [0, 6, 12, 72, 78, 81, 87]
    recording = eth.read(written(tmp_path, *(row(f, 1, f, 0) for f in frames), row(0, 2, 0, 0)))
    x = recording.position[:, 0, 0]
    np.testing.assert_array_equal(x, [0, 6, 12, np.nan, 72, 78, np.nan, 81, 87])


def test_destinations_and_groups_are_read_from_files_of_their_own(tmp_path):
    path = written(tmp_path, *(row(0, person, 0, 0) for person in (1, 2, 3, 4)))
    (tmp_path / "destinations.txt").write_text(" -2.0e+01 5.5\n 3 4\n")
    (tmp_path / "groups.txt").write_text(" 4 2 \n\n 3 99\n")
    recording = eth.read(path, tmp_path / "destinations.txt", tmp_path / "groups.txt")
    np.testing.assert_array_equal(recording.destinations, [[-20, 5.5], [3, 4]])
    assert recording.groups[1] == recording.groups[3]
    assert len(set(recording.groups.tolist())) == 3


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "is empty: give rows of 8 or 4 columns"),
        ("1 2 3\n", "line 1 has 3 columns: give 8"),
        (f"{row(0, 1, 0, 0)}\n6 1 x 0 0 0 0 0\n", "line 2 is not all numbers: give 8"),
        (f"{row(0, 1, 0, 0)}\n6 1 nan 0 0 0 0 0\n", "line 2 holds a number that is not finite: remove"),
        ("0.5 1 0 0 0 0 0 0\n", "frame is 0.5 in row 1: give whole numbers"),
        ("0 -1 0 0 0 0 0 0\n", "id is -1 in row 1: give whole numbers"),
        (f"{row(6, 3, 0, 0)}\n{row(6, 3, 1, 1)}\n", "id 3 stands twice in frame 6: keep one"),
        (f"{row(0, 1, 0, 0)}\n{row(6, 1, 0, 0)}\n", "holds 1 person: give a recording of at least 2"),
    ],
)
def test_a_file_that_is_none_is_named_with_line_and_remedy(tmp_path, text, message):
    path = tmp_path / "obsmat.txt"
    path.write_text(text)
    with pytest.raises(UserError, match=f"obsmat.txt: {message}"):
        eth.read(path)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(UserError, match=r"nowhere\.txt: can't be read"):
        eth.read(tmp_path / "nowhere.txt")
