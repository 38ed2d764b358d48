"""The study of language: what it says of predictions that are known, its pairs, and a study of made-up plays."""

import json
from types import SimpleNamespace

import numpy as np
import pytest

from experiments import study as scene_study
from experiments.language import report as language_report
from experiments.language import understanding as program
from jaxnav.language.phrases import SPLITS
from jaxnav.language.table import default_table
from jaxnav.training.config import preset
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
    plays = {
        "hard/narrow/phrases/test phrases/0": {"episodes": 4, "failed": [0, 1]},
        "hard/narrow/phrases/codes/0": {"episodes": 4, "failed": [1]},
        "hard/narrow/phrases/test phrases/1": {"episodes": 4, "failed": [3]},
        "hard/narrow/phrases/codes/1": {"episodes": 4, "failed": [2, 3]},
        "hard/doorway/phrases/test phrases/0": {"episodes": 4, "failed": [0, 1, 2, 3]},
        "hard/narrow/deaf/codes/0": {"episodes": 4, "failed": [0, 1, 2, 3]},
    }
    mean, half = language_report.paired({"plays": plays}, "narrow", "test phrases", "codes")
    # Of the two seeds' differences (-1, 0, 0, 0) and (0, 0, 1, 0) the mean varies from episode to episode.
    assert mean == 0 and half == pytest.approx(1.96 * np.std([-0.5, 0, 0.5, 0]) / 2)


def test_committed_markdown_is_that_of_the_committed_numbers():
    path = scene_study.RESULTS / "language.json"
    assert language_report.table(json.loads(path.read_text())) == path.with_suffix(".md").read_text()


def test_every_robot_plays_what_it_can_hear_once_and_goes_on(tmp_path, monkeypatch, capsys):
    done = []

    class Player:
        def __init__(self, run):
            pass

        def __call__(self, robot, heard, scene, episodes, seed):
            done.append((*robot, heard, scene))
            failed = np.arange(episodes) < (50 if heard == "codes" else 100)
            return ~failed, np.zeros(episodes, bool)

    def trained(options, suite, robot, seed, console):
        names = SUITES["parity" if suite == "parity" else "hard"]
        world = SimpleNamespace(scenes=[SimpleNamespace(name=name) for name in names])
        return SimpleNamespace(world=world, config=preset("quick")), (suite, robot, seed)

    monkeypatch.setattr(program, "trained", trained)
    monkeypatch.setattr(program, "Player", Player)
    monkeypatch.setattr(program, "understanding", lambda run, robot: (MEANT, SURE, REPLY))
    arguments = ["--out", str(tmp_path), "--runs", str(tmp_path / "runs"), "--seeds", "2", "--episodes", "1000"]
    program.main(arguments)
    assert len(done) == len(set(done)) and {heard for *_, heard, _ in done} == set(language_report.HEARD)
    assert {heard for _, robot, _, heard, _ in done if robot == "deaf"} == {"codes"}
    table = (tmp_path / "language.md").read_text()
    assert capsys.readouterr().out == table and "| hard | narrow | 0.900 ± 0.000 (0.000) |" in table
    assert "-10.00 ± 2.63 points" in table and (tmp_path / "language.png").stat().st_size > 10_000
    result = json.loads((tmp_path / "language.json").read_text())
    lost = "hard/corner/phrases/codes/1"
    plays = {key: play for key, play in result["plays"].items() if key != lost}
    (tmp_path / "language.json").write_text(json.dumps(result | {"plays": plays}))
    done.clear()
    program.main(arguments)
    assert done == [("hard", "phrases", 1, "codes", SUITES["hard"].index("corner"))]
    result["configs"]["hard phrases"]["agent"]["batch"] = 7
    before = json.dumps(result)
    (tmp_path / "language.json").write_text(before)
    with pytest.raises(SystemExit) as stop:
        program.main(arguments)
    message = capsys.readouterr().err
    assert stop.value.code == 2 and "configs.hard phrases.agent.batch" in message and "move it away" in message
    assert (tmp_path / "language.json").read_text() == before and len(done) == 1


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
