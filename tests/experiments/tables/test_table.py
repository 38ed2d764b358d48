"""The tables from end to end, with trainings and plays made up: what is done again, what is not, what is refused."""

import dataclasses
import json
import shutil
from types import SimpleNamespace

import jax
import numpy as np
import pytest

from experiments.tables import figure, methods, runs, table, table1, table2, table3, trajectories, tuning
from jaxnav import statistics
from jaxnav.training.config import preset
from jaxnav.training.population import Trained, member
from jaxnav.training.rollout import EpisodeSummary
from jaxnav.world import Params

SCENES = [scene for group in methods.GROUPS for scene in group]


class FakePrograms:
    """Trains and plays nothing: success depends on algorithm, scene and voice; seed 1 of TD3 breaks."""

    done: list
    play = methods.Programs.play

    def __init__(self, config, seeds, is_told=False):
        self.config, self.members, self.spoken = config, seeds, None
        self.population = self
        FakePrograms.done.append(("compile", config.algo, config.agent.encoder))

    def start(self, seeds, hyper, scene):
        FakePrograms.done.append(("train", self.config.algo, self.config.world.scenes[scene]))
        return scene

    def train(self, loop, hyper, steps, report, before):
        breaks = [None, 6400 if self.config.algo == "td3" else None, *[None] * (self.members - 2)]
        policies = np.arange(self.members, dtype=np.float32)
        return loop, Trained(env_steps=steps * self.config.train.episodes, policies=policies, broken=tuple(breaks))

    def policies(self, folder):
        return np.load(folder / "policies.npz")["000"]

    def player(self, parameters, voice):
        return parameters, voice

    def playing(self, player, scene, seed, episodes):
        actor, voice = player
        FakePrograms.done.append(("play", self.config.algo, self.config.world.scenes[scene], float(actor)))
        arrived = np.arange(episodes) % 10 < (8 if voice else 7) + (self.config.algo == "hsac")
        zero, no = np.zeros(episodes, int), np.zeros(episodes, bool)
        return EpisodeSummary(
            arrived=arrived, collided=~arrived, hit_pedestrian=no, truncated=no, steps=zero + 20,
            min_distance=zero + 0.5, comfortable_steps=zero + 15, request=zero, replied=no, agreed=no,
        )  # fmt: skip


@pytest.fixture
def run(monkeypatch, tmp_path):
    """A function (program, *arguments) that runs it in a folder of its own."""
    FakePrograms.done = []
    monkeypatch.setattr(methods, "Programs", FakePrograms)
    monkeypatch.setattr(trajectories, "draw", lambda table: None)
    monkeypatch.setattr(figure, "draw", lambda result, path: path.write_bytes(b"png"))
    monkeypatch.setattr(runs, "provenance", lambda: {"git_commit": "abc", "device": "none", "versions": {"jax": "0"}})
    monkeypatch.setattr(methods, "SCRIPTED", {})
    monkeypatch.setattr(statistics, "RESAMPLES", 99)  # most of the time goes into bootstraps
    tuned = {"algorithms": {algo: {"best": {"discount": 0.96}} for algo in ("hsac", "td3", "ppo", "a2c")}}
    (tmp_path / "tuning.json").write_text(json.dumps(tuned))
    monkeypatch.setattr(methods, "TUNED", tmp_path / "tuning.json")

    def run(program, *arguments):
        program.main(["--out", str(tmp_path / "out"), "--runs", str(tmp_path / "runs"), *arguments])
        name = program.__name__.rpartition(".")[2]
        return json.loads((tmp_path / "out" / f"{name}.json").read_text())

    return run


def test_every_method_scene_and_budget_has_a_row(run):
    result = run(table1, "--seeds", "3", "--episodes", "40")
    found = {(row["scene"], row["method"], row["budget"]) for row in result["rows"]}
    assert found == {(s, m, b) for s in SCENES for m in table1.METHODS for b in ("paper", "converged")}
    assert {row["env_steps"] for row in result["rows"] if row["budget"] == "paper"} == {128_000}
    trained = [what for what in FakePrograms.done if what[0] == "train"]
    assert len(trained) == len(set(trained)) == len(SCENES) * len(table1.METHODS)  # both budgets are one training
    assert len([what for what in FakePrograms.done if what[0] == "compile"]) == len(methods.GROUPS) * 4
    assert result["commit"] == "abc" and result["config"]["methods"]["HSAC"]["hyper"]["discount"] == 0.96
    hsac = next(row for row in result["rows"] if row["method"] == "HSAC")
    assert hsac["success"]["per_seed"] == [0.9] * 3 and hsac["comfort"]["mean"] == 0.75


def test_a_seed_that_broke_is_left_out_openly(run):
    result = run(table1, "--seeds", "3", "--episodes", "40", "--suite", "parity")
    td3 = [row for row in result["rows"] if row["method"] == "TD3"]
    assert all(row["seeds"] == [0, 2] and row["excluded"] == {"1": 6400} for row in td3)
    assert all(len(row["success"]["per_seed"]) == 2 for row in td3)
    pair = next(p for p in result["pairs"] if p["other"] == "TD3" and p["budget"] == "converged")
    assert (pair["episodes"], pair["seeds"]) == (40, 2) and pair["difference"] == pytest.approx(0.1)


def test_measures_are_of_the_episodes_that_they_are_about():
    """Three episodes of two seeds: the second seed never arrives."""
    arrived = np.array([[True, True, False], [False] * 3])
    no = np.zeros_like(arrived)
    played = EpisodeSummary(
        arrived=arrived, collided=~arrived, hit_pedestrian=~arrived & [True, False, True], truncated=no,
        steps=np.array([[10, 20, 40], [5, 5, 10]]), min_distance=np.array([[0.5, 1.0, 0.1], [0.2, 0.2, 0.2]]),
        comfortable_steps=np.array([[10, 10, 15], [0, 0, 5]]), request=np.zeros((2, 3), int), replied=no, agreed=no,
    )  # fmt: skip
    found = {name: measure["per_seed"] for name, measure in methods.measures(played).items()}
    assert found == {
        "success": pytest.approx([2 / 3, 0.0]), "collision": pytest.approx([1 / 3, 1.0]),
        "human_collision": pytest.approx([1 / 3, 2 / 3]), "timeout": [0.0, 0.0],
        "steps": [15.0, None], "min_distance": [0.75, None],  # of those that arrived
        "comfort": [0.5, 0.25],  # of all steps
    }  # fmt: skip


def test_who_is_told_is_given_the_messages_themselves():
    observation = SimpleNamespace(dialogue=SimpleNamespace(message=np.array([0, 1, 2, 3])))
    world = SimpleNamespace(observe=lambda state, params: observation)
    learner = SimpleNamespace(answer=lambda actor, observation, heard: (actor, heard))
    actor, heard = methods.Told(SimpleNamespace(learner=learner, parameters="actor"))(None, world, None)
    assert actor == "actor"
    np.testing.assert_array_equal(heard, [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])


def test_a_half_finished_table_goes_on_and_tables_share_their_trainings(run, tmp_path):
    run(table1, "--seeds", "2", "--episodes", "20", "--suite", "parity")
    first = list(FakePrograms.done)
    again = run(table1, "--seeds", "2", "--episodes", "20", "--suite", "none")
    assert FakePrograms.done == first and len(again["rows"]) == 3 * 4 * 2
    whole = run(table1, "--seeds", "2", "--episodes", "20")
    later = FakePrograms.done[len(first) :]
    assert {what[2] for what in later if what[0] == "train"} == set(methods.GROUPS[1] + methods.GROUPS[2])
    assert len(whole["rows"]) == len(SCENES) * 4 * 2
    assert {(row["budget"], row["episodes"]) for row in whole["rows"]} == {("paper", 20), ("converged", 20)}
    FakePrograms.done = []
    run(table2, "--seeds", "2", "--episodes", "20")
    assert len([what for what in FakePrograms.done if what[0] == "train"]) == len(SCENES)  # of 2 requests alone
    FakePrograms.done = []
    result = run(table3, "--seeds", "2", "--episodes", "20")
    trained = [what for what in FakePrograms.done if what[0] == "train"]
    assert len(trained) == 2 * len(SCENES)  # without language, and with half of it
    muted = next(p for p in result["pairs"] if p["other"] == "HSAC muted" and p["budget"] == "converged")
    assert muted["difference"] == pytest.approx(0.1) and (muted["episodes"], muted["seeds"]) == (20, 2)
    FakePrograms.done = []
    again = run(table3, "--seeds", "2", "--episodes", "20")
    assert FakePrograms.done == [] and again["rows"] == result["rows"]


def test_an_interrupted_training_is_done_again_and_nothing_else(run, tmp_path):
    run(table2, "--seeds", "2", "--episodes", "20", "--suite", "parity")
    (tmp_path / "runs" / "hsac-2-requests-hallway-paper" / "played.npz").unlink()
    (tmp_path / "out" / "table2.json").unlink()
    FakePrograms.done = []
    run(table2, "--seeds", "2", "--episodes", "20", "--suite", "parity")
    assert [what[0] for what in FakePrograms.done] == ["compile", "play", "play"]


def test_rows_alone_carry_on_where_trainings_are_gone(run, tmp_path):
    """A half-finished table that was committed goes on in another clone."""
    run(table1, "--seeds", "2", "--episodes", "20", "--suite", "parity")
    shutil.rmtree(tmp_path / "runs")
    FakePrograms.done = []
    result = run(table2, "--seeds", "2", "--episodes", "20", "--suite", "parity")
    assert {what[:2] for what in FakePrograms.done if what[0] == "train"} == {("train", "hsac")}
    assert len([what for what in FakePrograms.done if what[0] == "train"]) == 3  # of 2 requests alone
    assert {pair["scene"] for pair in result["pairs"]} == set(methods.GROUPS[0])
    shutil.rmtree(tmp_path / "runs")
    FakePrograms.done = []
    whole = run(table1, "--seeds", "2", "--episodes", "20")
    assert {what[2] for what in FakePrograms.done if what[0] == "train"} == set(methods.GROUPS[1] + methods.GROUPS[2])
    assert len(whole["rows"]) == len(SCENES) * 4 * 2


def test_scripted_robots_are_played_once_and_their_rows_say_by_which_code(run, monkeypatch):
    played = []

    class FakePlayer:
        def __init__(self, world, params):
            self.scene = world.scenes[0].name

        def __call__(self, player, scene, seed, episodes):
            played.append((self.scene, episodes))
            return FakePrograms.playing(FakePrograms(preset("quick"), 1), (0.0, False), 0, seed, episodes)

    monkeypatch.setattr(methods, "SCRIPTED", {"planner": None})
    monkeypatch.setattr(methods, "Playing", FakePlayer)
    first = run(table2, "--seeds", "2", "--episodes", "20", "--suite", "parity")
    assert played == [(scene, 40) for scene in methods.GROUPS[0]]
    later = {"git_commit": "def", "device": "another", "versions": {}}
    monkeypatch.setattr(runs, "provenance", lambda: later)
    again = run(table3, "--seeds", "2", "--episodes", "20", "--suite", "parity")
    assert len(played) == 3
    for result in (first, again):
        rows = [row for row in result["rows"] if row["method"] == "planner"]
        assert {(row["commit"], row["device"], row["episodes"]) for row in rows} == {("abc", "none", 40)}
    new = [row for row in again["rows"] if row["method"] == "HSAC without language"]
    assert {(row["commit"], row["device"]) for row in new} == {("def", "another")}
    result = run(table1, "--seeds", "2", "--episodes", "20", "--suite", "parity")
    assert len(played) == 3
    paired = {(p["scene"], p["budget"]): p["difference"] for p in result["pairs"] if p["other"] == "planner"}
    # HSAC arrives in nine of ten episodes, who is made up here in eight.
    assert paired == {(s, b): pytest.approx(0.1) for s in methods.GROUPS[0] for b in ("paper", "converged")}


def test_a_training_is_timed_once_whoever_was_played_after_it(run, tmp_path):
    result = run(table3, "--seeds", "2", "--episodes", "20", "--suite", "parity")
    rows = {(row["method"], row["budget"]): row for row in result["rows"] if row["scene"] == "square"}
    timed = [
        row | {"train_seconds": {"paper": 10.0, "converged": 25.0}[budget] if method != "HSAC that only hears" else 7.0}
        for (method, budget), row in rows.items() if method != "HSAC without language"
    ]  # fmt: skip
    assert len(timed) == 7  # three kinds of playing one training of two budgets, and another training
    options = table.Options(seeds=2, episodes=20, runs=tmp_path / "runs", out=tmp_path / "out")
    assert table.Table(options, table3.METHODS).train_seconds(timed) == 32.0


@pytest.fixture
def small():
    """A configuration in miniature."""
    base = preset("quick", "a2c")
    return dataclasses.replace(
        base,
        world=dataclasses.replace(base.world, scenes=("square",), beams=16, params=Params(max_steps=40.0)),
        agent=dataclasses.replace(base.agent, actor_widths=(16,), critic_widths=(16,)),
        train=dataclasses.replace(base.train, episodes=8, steps_per_chunk=5, total_steps=10),
    )


def test_kept_policies_are_players_of_their_method(small, tmp_path):
    """Traced alone: nothing is compiled."""
    programs = methods.Programs(small, 2)
    start = jax.eval_shape(lambda: programs.population.start(range(2), small.hyper))
    leaves = jax.tree.leaves(programs.agent.policy(start.learner))
    np.savez(
        tmp_path / "policies.npz", **{f"{i:03d}": np.zeros(leaf.shape, leaf.dtype) for i, leaf in enumerate(leaves)}
    )
    player = programs.player(member(programs.policies(tmp_path), 1), True)
    world, params = programs.population.world, small.world.params
    state = jax.eval_shape(world.reset, jax.random.key(0), params)
    action = jax.eval_shape(lambda player, state: player(state, world, params), player, state)
    assert (action.twist.shape, action.request.shape) == ((2,), ())


def test_robots_that_are_really_trained_and_played(small, full, monkeypatch, tmp_path):
    """In miniature, with nothing made up."""
    if not full:
        pytest.skip("compiles for a minute: pytest --full")
    monkeypatch.setattr(methods, "configuration", lambda method, scenes, env_steps: small)
    monkeypatch.setattr(methods, "GROUPS", (("square",),))
    monkeypatch.setattr(methods, "SCRIPTED", {})
    monkeypatch.setattr(table, "PAPER_STEPS", 40)
    monkeypatch.setattr(trajectories, "draw", lambda table: None)
    monkeypatch.setattr(figure, "draw", lambda result, path: None)
    monkeypatch.setattr(methods, "BLOCK", 16)
    sizes = ["--seeds", "2", "--episodes", "16", "--converged", "80", "--suite", "parity"]
    table.main("table1", ("A2C",), [], [*sizes, "--runs", str(tmp_path), "--out", str(tmp_path / "out")])
    result = json.loads((tmp_path / "out" / "table1.json").read_text())
    rows = result["rows"]
    assert result["train_seconds"] == rows[1]["train_seconds"] > 0  # both budgets are one training
    assert [(row["budget"], row["env_steps"]) for row in rows] == [("paper", 40), ("converged", 80)]
    programs = methods.Programs(small, 2)
    early, late = (programs.policies(tmp_path / f"a2c-square-{row['budget']}") for row in rows)
    assert any((a != b).any() for a, b in zip(jax.tree.leaves(early), jax.tree.leaves(late), strict=True))
    found = {name: np.array(rows[1][name]["per_seed"]) for name in ("success", "collision", "timeout", "comfort")}
    assert found["success"] + found["collision"] + found["timeout"] == pytest.approx(1)
    assert all(0 < comfort < 1 for comfort in found["comfort"])


def refused(run, capsys, *arguments):
    with pytest.raises(SystemExit) as stop:
        run(*arguments)
    assert stop.value.code == 2
    error = capsys.readouterr().err
    assert "Traceback" not in error
    return error.splitlines()[-1]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--seeds", "0"), ["--seeds is 0", "from 1"]),
        (("--converged", "100"), ["--converged is 100", "multiple of 128000"]),
        (("--suite", "easy"), ["--suite 'easy'", "parity"]),
        (("--seed", str(2**31)), ["--seed is 2147483648", "validation"]),
    ],
)
def test_bad_options_name_field_value_and_remedy(run, capsys, arguments, words, tmp_path):
    line = refused(run, capsys, table1, *arguments)
    assert all(word in line for word in words)
    assert not (tmp_path / "out").exists()


def test_results_of_another_configuration_are_not_mixed(run, capsys, tmp_path):
    run(table2, "--seeds", "2", "--episodes", "20", "--suite", "parity")
    before = (tmp_path / "out" / "table2.json").read_bytes()
    line = refused(run, capsys, table2, "--seeds", "2", "--episodes", "30", "--suite", "parity")
    assert "table2.json is of another configuration (config.episodes differ)" in line and "move it away" in line
    assert (tmp_path / "out" / "table2.json").read_bytes() == before
    (tmp_path / "out" / "table2.json").write_text("{}")
    assert "is no result of this program" in refused(run, capsys, table2, "--seeds", "2", "--episodes", "20")
    line = refused(run, capsys, table3, "--seeds", "2", "--episodes", "20", "--suite", "parity")
    assert "table2.json is no result of a table" in line and "move it away" in line


def test_a_table_of_nothing_is_none(run, capsys, tmp_path):
    assert "--suite both" in refused(run, capsys, table1, "--suite", "none")
    assert not (tmp_path / "out" / "table1.json").exists()


def test_trainings_of_another_configuration_are_not_used(run, capsys, tmp_path):
    run(table2, "--seeds", "2", "--episodes", "20", "--suite", "parity")
    tuned = json.loads(methods.TUNED.read_text())
    tuned["algorithms"]["hsac"]["best"]["discount"] = 0.5
    methods.TUNED.write_text(json.dumps(tuned))
    (tmp_path / "out" / "table2.json").unlink()
    line = refused(run, capsys, table2, "--seeds", "2", "--episodes", "20", "--suite", "parity")
    assert "training.json is of another configuration (hyper.discount differ)" in line and "--runs" in line


def test_an_algorithm_without_requests_is_refused_for_table_2(run, capsys, monkeypatch):
    line = refused(run, capsys, table2, "--algo", "td3")
    assert "td3" in line and "requests" in line and "hsac" in line


def test_untuned_algorithms_are_named(run, capsys):
    methods.TUNED.unlink()
    assert "python -m experiments.tables.tuning" in refused(run, capsys, table1)


def test_draws_of_tuning_stay_in_their_ranges():
    for algo, space in tuning.SPACES.items():
        values = tuning.drawn(space, 200, np.random.default_rng(0))
        assert values.keys() == space.keys(), algo
        for name, (low, high) in space.items():
            assert low <= values[name].min() and values[name].max() <= high
            assert values[name].std() > 0.2 * (high - low) / 2


def test_tuning_is_not_done_twice(tmp_path, monkeypatch, capsys):
    tuned = []

    def fake(algo, options, console):
        tuned.append(algo)
        hyper = {name: getattr(preset("quick", algo).hyper, name) for name in tuning.SPACES[algo]}
        trial = {"hyper": hyper, "success": {"narrow": 0.5}, "score": 0.5, "broken": None}
        return {"best": hyper, "trials": [trial] * options.trials}

    monkeypatch.setattr(tuning, "tune", fake)
    tuning.main(["--out", str(tmp_path), "--trials", "2"])
    assert tuned == ["hsac", "td3", "ppo", "a2c"]
    tuning.main(["--out", str(tmp_path), "--trials", "2"])
    assert len(tuned) == 4
    with pytest.raises(SystemExit):
        tuning.main(["--out", str(tmp_path), "--trials", "3"])
    assert "trials differ" in capsys.readouterr().err
    stored = json.loads((tmp_path / "tuning.json").read_text())
    stored["algorithms"]["td3"]["config"]["agent"]["batch"] = 7
    (tmp_path / "tuning.json").write_text(json.dumps(stored))
    with pytest.raises(SystemExit):
        tuning.main(["--out", str(tmp_path), "--trials", "2"])
    assert "td3 of another configuration (agent.batch differ)" in capsys.readouterr().err and len(tuned) == 4
