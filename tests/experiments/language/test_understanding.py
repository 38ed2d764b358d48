"""The study of language: what it says of predictions that are known, its pairs, and a study of made-up plays."""

import json

import numpy as np
import pytest

from experiments import study
from experiments.language import report
from experiments.language import understanding as program
from jaxnav.language.phrases import SPLITS
from jaxnav.language.table import default_table
from jaxnav.statistics import packed
from jaxnav.world import SUITES
from jaxnav.world.types import LEFT, RIGHT

PHRASES = default_table().phrases
MEANT = np.array([phrase.message for phrase in PHRASES])
REPLY = np.array([phrase.reply for phrase in PHRASES])
SURE = np.ones(len(PHRASES))


def test_who_mixes_up_the_sides_is_wrong_about_these_messages_alone():
    mixed = np.where(MEANT == LEFT, RIGHT, np.where(MEANT == RIGHT, LEFT, MEANT))
    found = program.accuracy([(MEANT, SURE, REPLY), (mixed, SURE, 1 - REPLY)])
    for split in SPLITS:
        here = np.array([phrase.split == split for phrase in PHRASES])
        share = np.isin(MEANT[here], (LEFT, RIGHT)).mean()
        assert 0 < share < 1 and found[split]["phrases"] == here.sum()
        assert found[split]["per_seed"] == pytest.approx([1, 1 - share])
        assert found[split]["overall"] == pytest.approx(1 - share / 2)
        assert found[split]["ci95"][0] < 1 - share / 2 < found[split]["ci95"][1]
        assert found[split]["left_right_confused"] == pytest.approx(share / 2)
        assert found[split]["reply"] == 0.5
    confusion, test = np.array(found["confusion"]), np.array([phrase.split == "test" for phrase in PHRASES])
    assert confusion[LEFT, RIGHT] == confusion[LEFT, LEFT] == (MEANT[test] == LEFT).sum() / 2
    assert confusion.sum(axis=1) == pytest.approx([(MEANT[test] == message).sum() for message in range(len(confusion))])


def test_a_pair_is_a_difference_episode_by_episode():
    failed = {
        "hard/narrow/phrases/test phrases/0": [0, 1], "hard/narrow/phrases/messages/0": [1],
        "hard/narrow/phrases/test phrases/1": [3], "hard/narrow/phrases/messages/1": [2, 3],
        "hard/doorway/phrases/test phrases/0": [0, 1, 2, 3], "hard/narrow/deaf/messages/0": [0, 1, 2, 3],
    }  # fmt: skip
    plays = {
        name: {"episodes": 4, "arrived": packed(~np.isin(np.arange(4), episodes)[None])}
        for name, episodes in failed.items()
    }
    mean, half = report.paired({"rows": plays}, "narrow", "test phrases", "messages")
    # Of the two seeds' differences (-1, 0, 0, 0) and (0, 0, 1, 0) the mean varies from episode to episode.
    assert mean == 0 and half == pytest.approx(1.96 * np.std([-0.5, 0, 0.5, 0]) / 2)


def test_every_robot_plays_what_it_can_hear_once_and_goes_on(tmp_path, monkeypatch, capsys):
    done = []

    class Player:
        def __init__(self, run):
            pass

        def __call__(self, robot, heard, scene, episodes, seed):
            done.append((*robot, heard, scene))
            failed = np.arange(episodes) < (50 if heard == "messages" else 100)
            return ~failed, np.zeros(episodes, bool)

    def trained(config, name, console):
        return None, (*name.split()[:2], config.seed)

    monkeypatch.setattr(study, "trained", trained)
    monkeypatch.setattr(program, "Player", Player)
    monkeypatch.setattr(program, "understanding", lambda run, robot: (MEANT, SURE, REPLY))
    arguments = ["--out", str(tmp_path), "--runs", str(tmp_path / "runs"), "--seeds", "2", "--episodes", "1000"]
    program.main(arguments)
    assert len(done) == len(set(done)) and {heard for *_, heard, _ in done} == set(report.HEARD)
    assert {heard for _, robot, _, heard, _ in done if robot == "deaf"} == {"messages"}
    table = (tmp_path / "understanding.md").read_text()
    assert capsys.readouterr().out == table and "| hard | narrow | 0.900 ± 0.000 (0.000) |" in table
    assert "-10.00 ± 2.63 points" in table and (tmp_path / "understanding.png").stat().st_size > 10_000
    result = json.loads((tmp_path / "understanding.json").read_text())
    lost = "hard/corner/phrases/messages/1"
    plays = {key: play for key, play in result["rows"].items() if key != lost}
    (tmp_path / "understanding.json").write_text(json.dumps(result | {"rows": plays}))
    done.clear()
    program.main(arguments)
    assert done == [("hard", "phrases", 1, "messages", SUITES["hard"].index("corner"))]
    result["configs"]["hard phrases"]["agent"]["batch"] = 7
    before = json.dumps(result)
    (tmp_path / "understanding.json").write_text(before)
    with pytest.raises(SystemExit) as stop:
        program.main(arguments)
    message = capsys.readouterr().err
    assert stop.value.code == 2 and "configs.hard phrases.agent.batch" in message and "move it away" in message
    assert (tmp_path / "understanding.json").read_text() == before and len(done) == 1


@pytest.mark.parametrize(
    ("option", "value", "said"),
    [("--seeds", 0, "from 1"), ("--episodes", 1, "from 500"), ("--steps", 30, "multiple of 25"), ("--seed", -1, "0")],
)
def test_values_out_of_range_are_named(option, value, said, tmp_path, capsys):
    with pytest.raises(SystemExit) as stop:
        program.main([option, str(value), "--out", str(tmp_path)])
    message = capsys.readouterr().err
    assert stop.value.code == 2 and f"{option} is {value}" in message and said in message
    assert not any(tmp_path.iterdir())
