"""A run: its folder, its lines, and that an interruption changes nothing but the time it takes."""

import json
import os
import pathlib
import shutil
import signal
import time

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxnav.errors import UserError
from jaxnav.training.config import run_from_json
from jaxnav.training.dataclass_json import to_json
from jaxnav.training.loop import Trainer
from jaxnav.training.run import Run
from jaxnav.training.signals import Interrupted
from jaxnav.training.train import train as train_run


def content(folder):
    """{path: bytes} of all files, None of folders."""
    paths = sorted(pathlib.Path(folder).rglob("*"))
    return {str(path.relative_to(folder)): path.read_bytes() if path.is_file() else None for path in paths}


def lines(run):
    """metrics.jsonl without what the clock says."""
    return [{name: value for name, value in line.items() if name != "wall_seconds"} for line in run.files.metrics()]


def resume(config):
    run = Run(config)
    run.prepare_folder()
    return run, train_run(run, lambda line: None, time.monotonic())


def replaced(config, **fields):
    return run_from_json(to_json(config) | fields)


@pytest.fixture
def copied(finished, tmp_path):
    """(configuration that resumes it, folder) of a copy of the finished run that lost its last checkpoint."""
    folder = tmp_path / "run"
    shutil.copytree(finished[0].folder, folder)
    shutil.rmtree(folder / "checkpoints" / "step_20")
    return replaced(finished[0].config, out=str(folder), resume=True), folder


def test_the_folder_says_what_was_run_with_what(finished):
    run, _ = finished
    stored = json.loads((run.folder / "config.json").read_text())
    assert set(stored) == {"config", "sources", "shards", "embeddings", "versions", "git_commit", "device"}
    assert run_from_json(stored["config"]) == run.config
    assert {"python", "jaxnav", "jax", "jaxlib", "flax", "optax", "numpy"} <= set(stored["versions"])
    assert stored["versions"]["jax"] == jax.__version__
    assert "CPU cores" in stored["device"]
    assert Run.open(run.folder).config == run.config
    assert sorted(path.name for path in (run.folder / "checkpoints").iterdir()) == ["step_15", "step_20"]


def test_a_line_a_chunk_has_the_keys_of_the_contract(finished):
    metrics = finished[0].files.metrics()
    assert [line["env_steps"] for line in metrics] == [80, 160, 240, 320]
    assert [line["updates"] for line in metrics] == [10, 20, 30, 40]
    for line in metrics:
        assert set(line) - {"evaluation"} == {
            "env_steps", "updates", "wall_seconds", "success", "episodes", "reward", "q", "critic_loss", "actor_loss",
            "twist_entropy", "request_entropy", "twist_temperature", "request_temperature",
            "message_loss",
        }  # fmt: skip
    assert ["evaluation" in line for line in metrics] == [False, False, False, True]
    assert set(metrics[-1]["evaluation"]) == {"square"}
    seconds = [line["wall_seconds"] for line in metrics]
    assert sorted(seconds) == seconds
    # Nobody can time out in less than 12 steps of 12, so that some chunks have no success to tell of.
    assert all((line["success"]["square"] is None) == (line["episodes"] == 0) for line in metrics)
    assert sum(line["episodes"] for line in metrics) > 0


def test_resuming_repeats_what_was_lost_bit_for_bit(finished, copied, assert_same):
    config, folder = copied
    run, progress = resume(config)
    assert_same(progress, finished[1])
    assert lines(run) == lines(finished[0])
    assert run.files.metrics()[-1]["wall_seconds"] > run.files.metrics()[-2]["wall_seconds"]
    assert_same(Run.open(folder).restore(), finished[1])


def test_a_learner_of_rollouts_resumes_bit_for_bit(tmp_path, tiny, train, assert_same):
    run, progress = train(tiny(tmp_path / "run", algo="a2c"))
    assert [line["updates"] for line in run.files.metrics()] == [1, 2, 3, 4]
    assert {"critic_loss", "actor_loss", "twist_entropy", "q"} <= run.files.metrics()[0].keys()
    assert Run.open(run.folder).config == run.config
    shutil.rmtree(run.folder / "checkpoints" / "step_20")
    again, repeated = resume(replaced(run.config, resume=True))
    assert_same(repeated, progress)
    assert lines(again) == lines(run)


def test_resuming_without_a_checkpoint_begins_again(finished, copied, assert_same):
    config, folder = copied
    shutil.rmtree(folder / "checkpoints")
    run, progress = resume(config)
    assert_same(progress, finished[1])
    assert lines(run) == lines(finished[0])


def test_resuming_a_finished_run_changes_nothing(finished, tmp_path, assert_same):
    folder = tmp_path / "run"
    shutil.copytree(finished[0].folder, folder)
    before = content(folder)
    _, progress = resume(replaced(finished[0].config, out=str(folder), resume=True))
    assert_same(progress, finished[1])
    assert content(folder) == before


def test_a_signal_saves_and_the_rest_can_be_done_later(finished, tmp_path, tiny, assert_same):
    before = {n: signal.getsignal(n) for n in (signal.SIGINT, signal.SIGTERM)}
    # Nothing would be saved but for the signal.
    config = replaced(tiny(tmp_path / "run"), train=to_json(tiny(checkpoint_seconds=1e9).train))
    run = Run(config)
    run.prepare_folder()

    def report(line):
        if line["env_steps"] == 160:
            os.kill(os.getpid(), signal.SIGTERM)

    with pytest.raises(Interrupted) as caught:
        train_run(run, report, time.monotonic())
    assert caught.value.signal == signal.SIGTERM
    assert {n: signal.getsignal(n) for n in before} == before
    assert len(run.files.metrics()) == 2
    assert [path.name for path in (run.folder / "checkpoints").iterdir()] == ["step_10"]
    run, progress = resume(replaced(config, resume=True))
    assert_same(progress, finished[1])
    assert lines(run) == lines(finished[0])


@pytest.fixture
def usual_interrupt():
    """SIGINT interrupts, also where a shell started the tests in the background and had it ignored."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def test_a_second_signal_has_its_usual_effect(tmp_path, tiny, usual_interrupt):
    run = Run(tiny(tmp_path / "run"))
    run.prepare_folder()

    def report(line):
        os.kill(os.getpid(), signal.SIGINT)
        # Two at once may be delivered as one.
        for _ in range(500):
            if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
                break
            time.sleep(0.01)
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(5.0)

    with pytest.raises(KeyboardInterrupt):
        train_run(run, report, time.monotonic())
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_training_traces_its_chunk_once_also_after_resuming(copied, tmp_path, tiny, monkeypatch):
    traces, chunk = [], Trainer.train_chunk

    def train_chunk(self, loop, hyper):
        traces.append(None)
        return chunk(self, loop, hyper)

    monkeypatch.setattr(Trainer, "train_chunk", train_chunk)
    resume(tiny(tmp_path / "new"))
    assert len(traces) == 1
    shutil.rmtree(tmp_path / "new" / "checkpoints" / "step_20")
    resume(replaced(tiny(tmp_path / "new"), resume=True))
    assert len(traces) == 2


def test_the_best_actor_is_the_last_of_the_best_by_its_worst_scene(tmp_path, tiny, monkeypatch, assert_same):
    scores = iter([0.2, 0.6, 0.6, 0.4])
    run = Run(tiny(tmp_path / "run", evaluate_every=1))
    seen = []

    def success(policy, seed):
        seen.append((seed, jax.device_get(policy.parameters)))
        return {"square": next(scores), "hallway": 0.9}

    monkeypatch.setattr(run.evaluator, "success", success)
    run.prepare_folder()
    progress = train_run(run, lambda line: None, time.monotonic())
    assert (float(progress.best.score), int(progress.best.step)) == (pytest.approx(0.6), 15)
    assert_same(jax.device_get(progress.best.actor), seen[2][1])
    assert {seed for seed, _ in seen} == {2**31}  # never the seed of the evaluations that count


def test_a_loss_that_turns_non_finite_stops_and_the_last_good_checkpoint_stays(tmp_path, tiny):
    run = Run(tiny(tmp_path / "run"))
    run.prepare_folder()

    def report(line):
        if line["env_steps"] == 160:
            run.hyper = run.hyper.replace(critic_lr=jnp.float32(1e38))

    with pytest.raises(UserError, match=r"critic_loss.* turned non-finite by step 15 .* step 10 is kept"):
        train_run(run, report, time.monotonic())
    assert len(run.files.metrics()) == 2
    assert int(run.restore().loop.counter) == 10
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(run.restore().loop.learner))


def refused(config, match):
    """Preparing its folder is a `UserError` of one line, and nothing in and beside the folder changes."""
    before = content(pathlib.Path(config.out).parent)
    with pytest.raises(UserError, match=match) as caught:
        Run(config).prepare_folder()
    assert "\n" not in str(caught.value)
    assert content(pathlib.Path(config.out).parent) == before


def test_a_folder_that_holds_a_run_is_left_alone(copied):
    config, _ = copied
    refused(replaced(config, resume=False), r"--out \S+run already holds a run: go on with --resume, or give another")


def test_a_folder_with_something_else_is_left_alone(tmp_path, tiny):
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "thesis.tex").write_text("years of work")
    refused(tiny(tmp_path / "run"), "is not empty: ")


def test_a_file_is_no_folder(tmp_path, tiny):
    (tmp_path / "run").write_text("years of work")
    refused(tiny(tmp_path / "run"), "is a file: give a folder")
    refused(tiny(tmp_path / "run" / "below"), "can't be made .*: give another --out")


def test_there_has_to_be_a_run_to_resume(tmp_path, tiny):
    refused(replaced(tiny(tmp_path / "run"), resume=True), "holds no run to resume: leave out --resume")


def test_resuming_with_another_value_names_it(copied):
    config, _ = copied
    hyper = to_json(config.hyper) | {"tau": 0.5}
    refused(replaced(config, hyper=hyper, seed=1), r"another hyper.tau, seed: give the same values to resume it")


def test_how_often_a_resumed_run_is_saved_may_change(copied, finished, assert_same):
    config, _ = copied
    train = to_json(config.train) | {"checkpoint_seconds": 7.0}
    assert_same(resume(replaced(config, train=train))[1], finished[1])


def test_there_is_no_best_policy_before_an_evaluation(finished):
    run, progress = finished
    none = progress.best.replace(score=jnp.float32(-1.0))
    with pytest.raises(UserError, match=r"has no best policy .*: give --policy last"):
        run.policy("best", progress.replace(best=none))


@pytest.mark.parametrize("damage", [os.unlink, lambda path: os.truncate(path, 50)])
def test_resuming_without_the_lines_of_before_is_refused(copied, damage):
    config, folder = copied
    damage(folder / "metrics.jsonl")
    before = content(folder)
    run = Run(config)
    run.prepare_folder()
    with pytest.raises(UserError, match=r"metrics\.jsonl .*: train anew with another --out"):
        train_run(run, lambda line: pytest.fail("trained all the same"), time.monotonic())
    assert content(folder) == before


def test_a_line_that_was_cut_short_is_not_a_metric(copied):
    _, folder = copied
    before = Run.open(folder).files.metrics()
    with open(folder / "metrics.jsonl", "a") as file:
        file.write('{"env_steps": 4')
    assert Run.open(folder).files.metrics() == before


@pytest.mark.parametrize(
    "text",
    ["", "{", "[]", "{}", '{"config": 3}', '{"config": {}}', '{"config": {"seed": 0}}', "\0\0"],
)
def test_a_damaged_configuration_is_named(tmp_path, text):
    (tmp_path / "config.json").write_text(text)
    with pytest.raises(UserError, match=r"config\.json can't be read \(.+\): train anew") as caught:
        Run.open(tmp_path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("name", "value"), [("seed", "x"), ("scene", "moon"), ("algo", "dreamer"), ("hyper", {}), ("train", None)]
)
def test_a_configuration_that_no_longer_holds_is_named(finished, tmp_path, name, value):
    stored = json.loads((finished[0].folder / "config.json").read_text())
    stored["config"][name] = value
    (tmp_path / "config.json").write_text(json.dumps(stored))
    with pytest.raises(UserError, match=r"config\.json can't be read \(.+\): train anew"):
        Run.open(tmp_path)


def test_a_hyperparameter_that_is_no_number_is_named(finished, tmp_path):
    stored = json.loads((finished[0].folder / "config.json").read_text())
    stored["config"]["hyper"]["tau"] = "a lot"
    (tmp_path / "config.json").write_text(json.dumps(stored))
    with pytest.raises(UserError, match=r"config\.json can't be read \(.+\): train anew"):
        Run.open(tmp_path)


@pytest.mark.parametrize("where", ["nowhere", "config.json", "."])
def test_what_is_no_run_is_said_to_be_none(tmp_path, where):
    if where == "config.json":
        (tmp_path / where).write_text("{}")
    with pytest.raises(UserError, match="holds no run: there is no"):
        Run.open(tmp_path / where)


def test_reading_a_run_without_checkpoints_leaves_it_alone(copied):
    _, folder = copied
    shutil.rmtree(folder / "checkpoints")
    before = content(folder)
    with pytest.raises(UserError, match=r"holds no checkpoint: train"):
        Run.open(folder).restore()
    assert content(folder) == before
