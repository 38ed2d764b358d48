"""The program from end to end: known parameters are found again, people predicted, wrong input refused in a line."""

import json
import os
import pathlib

import cv2
import numpy as np
import pytest

from experiments import calibrate_pedestrians
from experiments.calibration import comparison, eth, measures, recovery, windows
from experiments.calibration.model import Behaviour

DATA = os.environ.get("JAXNAV_DATA")


def written(folder, name):
    """The result in a folder, its figure looked at."""
    picture = cv2.imread(str(folder / f"{name}.png"))
    assert picture is not None and picture.shape[0] > 300 and np.ptp(picture) == 255
    text = (folder / f"{name}.json").read_text()
    assert str(folder) not in text
    result = json.loads(text)
    assert {"options", "versions", "git_commit", "device", "wall_seconds"} <= result.keys()
    return result


def test_simulated_walkers_parameters_are_found_again(tmp_path):
    options = [
        "--truths",
        "1",
        "--starts",
        "2",
        "--walkers",
        "2",
        "--episodes",
        "80",
        "--steps",
        "250",
        "--out",
        str(tmp_path),
    ]
    calibrate_pedestrians.main(["simulated", *options])
    result = written(tmp_path, "calibrate_simulated")
    (row,) = result["truths"]
    for name in recovery.FITTED:
        off = [abs(start[name] / row["truth"][name] - 1) for start in row["starts"]]
        assert min(off) > 0.29
        assert abs(row["fits"][row["best"]][name] / row["truth"][name] - 1) < 0.05, name
        assert result["largest_error"][name] < 0.05


def test_all_of_five_truths_are_found_again(full):
    if not full:
        pytest.skip("takes minutes: pytest --full")
    result = recovery.study(5, 4, 4, 100, 800, 0.0, 1, lambda: None)
    assert max(result["largest_error"].values()) < 0.05


def crowd(path, people=24, seed=0):
    """A recording in the ETH format: two at a time, at 1.4 m/s after a slow start, positions known to 5 cm."""
    generator = np.random.default_rng(seed)
    rows = []
    for person in range(people):
        way = 1 if person % 2 else -1
        t = 0.4 * np.arange(22)
        x = -8 * way + way * (1.4 * t - 1.5 * (1 - np.exp(-t / 3)))
        y = 0.3 * way + 0.0 * t
        x, y = x + generator.normal(0, 0.05, 22), y + generator.normal(0, 0.05, 22)
        frames = 6 * (np.arange(22) + 24 * (person // 2))
        rows += [f"{frame} {person} {a} 0 {b} 0 0 0" for frame, a, b in zip(frames, x, y, strict=True)]
    path.write_text("\n".join(rows))
    return path


def test_recorded_people_are_predicted_better_than_by_constant_velocity(tmp_path):
    data = crowd(tmp_path / "seq_made.obsmat.txt")
    (tmp_path / "seq_made.destinations.txt").write_text("30 0\n-30 0\n")
    calibrate_pedestrians.main(
        ["eth", "--data", str(data), "--starts", "2", "--steps", "80", "--out", str(tmp_path / "out")]
    )
    result = written(tmp_path / "out", "calibrate_eth")
    assert result["options"]["data"] == "seq_made.obsmat.txt"
    assert result["people"] == {"training": 14, "held_out": 10}
    calibrated, constant = (result["predictors"][name] for name in (comparison.CALIBRATED, "constant velocity"))
    for kind in ("ade", "fde"):
        assert calibrated[kind][2] < constant[kind][1]
        assert constant[kind][0] - calibrated[kind][0] == pytest.approx(
            result["gain_of_calibration"]["constant velocity"][kind][0], abs=2e-4
        )
        assert result["gain_of_calibration"]["constant velocity"][kind][1] > 0
    assert set(result["curves"]) == set(result["predictors"])
    assert 1.2 < result["calibrated"]["preferred_speed"] < 1.6


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["eth", "--data", "nowhere.txt"], "nowhere.txt: can't be read"),
        (["eth", "--data", "x", "--share", "1.5"], "share is 1.5: give a number between 0 and 1"),
        (["eth", "--data", "x", "--observe", "1"], "observe is 1: give at least 2"),
        (["simulated", "--truths", "0"], "truths is 0: give at least 1"),
        (["simulated", "--noise", "nan"], "noise is nan: give at least 0"),
        (["simulated", "--noise", "inf"], "noise is inf: give less than"),
        (["simulated", "--walkers", "65"], "walkers is 65: give at most 64"),
        (["simulated", "--seed", "4294967296"], "seed is 4294967296: give less than 4294967296"),
        (["simulated", "--out", __file__], f"--out is {__file__}: File exists: choose a folder that can be written"),
    ],
)
def test_wrong_input_ends_in_one_line_and_exit_request_2(capsys, arguments, message):
    with pytest.raises(SystemExit) as end:
        calibrate_pedestrians.main(arguments)
    assert end.value.code == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"error: {message}")


@pytest.mark.skipif(DATA is None, reason="JAXNAV_DATA is not set")
def test_constant_velocity_on_the_real_scene_is_what_numpy_says():
    path = pathlib.Path(DATA or "") / "eth_walking" / "seq_eth.obsmat.txt"
    recording = eth.read(path)
    assert recording.ids.shape == (360,)
    assert np.isfinite(recording.position[..., 0]).sum() == 8908
    cut = windows.cut(recording)
    constant = Behaviour(1.0, 0.0, 1.0, 0.1, memory=1e-3, relaxation=1e6)
    distance = measures.displacement(constant, cut, comparison.SETTING._replace(neighbors=1))
    table = np.loadtxt(path)
    expected = []
    for person in np.unique(table[:, 1]):
        track = table[table[:, 1] == person][:, [2, 4]]
        ends = range(7, len(track) - 12)
        steps = np.arange(1, 13)[:, None]
        mine = [
            np.linalg.norm(track[e] + steps * (track[e] - track[e - 1]) - track[e + 1 : e + 13], axis=1) for e in ends
        ]
        expected += [np.mean(mine, axis=0)] if mine else []
    assert len(expected) == 271
    np.testing.assert_allclose(measures.by_person(distance, cut).mean(axis=0), np.mean(expected, axis=0), rtol=1e-3)
