"""The command line from outside: what it trains, what it prints, and how it ends."""

import json
import os
import pathlib
import re
import shutil
import signal
import subprocess
import sys

import jax
import numpy as np
import pytest

from jaxnav import cli
from jaxnav.training.config import HSACHyperparameters, HSACRunConfig, TrainConfig
from jaxnav.training.run import Run
from jaxnav.world import Params, WorldConfig

# The smallest run worth interrupting: 12 chunks, each evaluated and saved.
SIZES = {
    "scene": "square", "world.beams": 16, "world.params.max-steps": 12, "agent.actor-widths": 16,
    "agent.critic-widths": 16, "agent.batch": 32, "agent.updates-per-step": 2, "train.episodes": 16,
    "train.replay-rows": 20, "train.steps-per-chunk": 5, "train.total-steps": 60, "train.evaluate-every": 1,
    "train.checkpoint-seconds": 0,
}  # fmt: skip


def sized(**changes):
    sizes = SIZES | {name.replace("__", "."): value for name, value in changes.items()}
    return [word for name, value in sizes.items() for word in (f"--{name}", str(value))]


@pytest.fixture(scope="module")
def jaxnav():
    """Runs the command in a process of its own."""

    def run(*arguments, **options):
        command = [sys.executable, "-m", "jaxnav.cli", *map(str, arguments)]
        return subprocess.run(command, capture_output=True, text=True, timeout=240, **options)

    return run


@pytest.fixture(scope="module")
def trained(jaxnav, tmp_path_factory):
    """(folder, what was printed) of a run that nothing disturbed."""
    folder = tmp_path_factory.mktemp("trained") / "run"
    done = jaxnav("train", *sized(), "--out", folder)
    assert done.returncode == 0, done.stderr
    return folder, done


def content(folder):
    """{path: bytes} of all files, None of folders."""
    paths = sorted(pathlib.Path(folder).rglob("*"))
    return {str(path.relative_to(folder)): path.read_bytes() if path.is_file() else None for path in paths}


def fails(capsys, *arguments):
    """The one line on stderr with which a command ends that can't be done; nothing on stdout, exit code 2."""
    with pytest.raises(SystemExit) as stop:
        cli.main(list(map(str, arguments)))
    out, err = capsys.readouterr()
    assert stop.value.code == 2
    assert out == ""
    assert re.fullmatch(r"error: [^\n]+\n", err), err
    return err


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["trian"], ["'trian'", "train, sweep, evaluate, compare, render"]),
        (["--seed", 1], ["'--seed'", "train, sweep, evaluate, compare, render"]),
        (["train", "--preset", "fast"], ["preset", "'fast'", "quick, robust, lidar, grid"]),
        (["train", "--preset=fast"], ["preset", "'fast'", "quick, robust, lidar, grid"]),
        (["train", "--scene", "moon"], ["scene", "'moon'", "square, hallway, crosswalk"]),
        (["train", "--world.scenes", "moon"], ["scene", "'moon'", "square, hallway, crosswalk"]),
        (["train", "--algo", "dqn"], ["algo", "'dqn'", "hsac, td3, ppo, a2c"]),
        (["train", "--algo", "td3", "--agent.requests", 2], ["--agent.requests: td3 has no", "give --algo hsac"]),
        (["train", "--agent.horizon=5"], ["--agent.horizon: hsac has no", "give --algo ppo or a2c"]),
        (["train", "--algo=ppo", "--hyper.target_noise", 1], ["--hyper.target_noise: ppo has no", "give --algo td3"]),
        (["train", "--agent.wings", 1], ["Unrecognized", "--agent.wings", "--help"]),
        (["train", "--algo", "ppo", "--agent.horizon", 30], ["agent.horizon", "30", "train.steps_per_chunk", "25"]),
        (["train", "--algo", "ppo", "--agent.minibatches", 7], ["agent.minibatches", "7", "divisor", "1600"]),
        (["train", "--algo", "ppo", "--hyper.gae-lambda", 2], ["hyper.gae_lambda", "2", "0 to 1"]),
        (["train", "--agent.requests", 3], ["agent.requests", "3", "1, 2, 4"]),
        (["train", "--agent.heads", "two"], ["agent.heads", "'two'", "shared, per-request"]),
        (["train", "--agent.encoder", "grid"], ["world.observation", "pedestrian_map, sensor_map", "grid encoder"]),
        (["train", "--world.randomise", "sped", 0, 1], ["world.randomise", "'sped'", "fields of world.params"]),
        (["train", "--world.randomise", "compliance", 1, 0], ["world.randomise", "compliance", "lower end first"]),
        (["train", "--agent.encoder", "cnn"], ["agent.encoder", "'cnn'", "lidar"]),
        (["train", "--wings", 2], ["--wings", "--help"]),
        (["train", "square"], ["square", "--help"]),
        (["train", "--seed", "x"], ["--seed", "'x'"]),
        (["train", "--seed", -1], ["seed", "-1", "from 0 to"]),
        (["train", "--seed"], ["--seed"]),
        (["train", "--world.pedestrians", 17], ["world.pedestrians", "17", "hallway", "16"]),
        (["train", "--world.beams", -3], ["world.beams", "-3", "at least 2"]),
        (["train", "--world.params.body-radius", "nan"], ["world.params.body_radius", "nan", "give a number"]),
        (["train", "--world.params.robot-radius", -0.1], ["world.params.robot_radius", "-0.1", "above 0"]),
        (["train", "--world.params.compliance", 1.5], ["world.params.compliance", "1.5", "0 to 1"]),
        (["train", "--world.observation", "scan"], ["world.observation", "dialogue", "pedestrians"]),
        (["train", "--world.reward", "gold"], ["world.reward", "'gold'", "authors-code", "paper-text"]),
        (["train", "--hyper.discount", 2], ["hyper.discount", "2", "0 to 1"]),
        (["train", "--train.total-steps", 7], ["train.total_steps", "7", "multiple of train.steps_per_chunk"]),
        (["train", "--train.checkpoint-seconds", "nan"], ["train.checkpoint_seconds", "nan"]),
        (["evaluate"], ["run's folder"]),
        (["evaluate", "no/where"], ["no/where", "holds no run"]),
        (["evaluate", "x", "--episodes", 0], ["--episodes", "0", "from 1"]),
        (["evaluate", "x", "--seed", -1], ["--seed", "-1", "from 0"]),
        (["evaluate", "x", "--policy", "worst"], ["--policy", "'worst'", "one of last, best"]),
        (["evaluate", __file__], ["holds no run"]),
        (["render", "no/where"], ["no/where", "holds no run"]),
        (["render", "x", "--seed", 2**32], ["--seed", str(2**32), "from 0"]),
    ],
    ids=lambda value: " ".join(map(str, value))[:60],
)  # fmt: skip
def test_what_cannot_be_done_is_one_line_and_exit_code_2(capsys, tmp_path, monkeypatch, arguments, said):
    monkeypatch.chdir(tmp_path)
    error = fails(capsys, *arguments)
    assert all(word in error for word in said), error
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("encoding", ["utf-8", "ascii"])
def test_a_process_ends_with_that_line_too(tmp_path, encoding):
    """In every terminal: what the parser of options draws in boxes or, where there are none, in ASCII."""
    for arguments, said in (
        (["--scene", "moon"], "scene 'moon' is unknown: choose"),
        (["--train.episodes", "0"], "train.episodes is 0: give a whole number of at least 1"),
    ):
        command = [sys.executable, "-m", "jaxnav.cli", "train", *arguments]
        environment = os.environ | {"PYTHONIOENCODING": encoding}
        done = subprocess.run(command, capture_output=True, text=True, env=environment, cwd=tmp_path)
        assert (done.returncode, done.stdout) == (2, "")
        assert re.fullmatch(rf"error: {said}[^\n]+\n", done.stderr), done.stderr
    assert list(tmp_path.iterdir()) == []


def options_of(cls):
    return {name.replace("_", "-") for name in cls.__dataclass_fields__}


@pytest.mark.parametrize(
    ("command", "options"),
    [
        (
            "train",
            {"preset", "algo", "scene", "seed", "out", "resume"}
            | {f"world.{name}" for name in options_of(WorldConfig)}
            | {f"world.params.{name}" for name in options_of(Params)}
            | {f"agent.{name}" for name in options_of(HSACRunConfig().agent)}
            | {f"hyper.{name}" for name in options_of(HSACHyperparameters)}
            | {f"train.{name}" for name in options_of(TrainConfig)},
        ),
        ("evaluate", {"episodes", "seed", "scene", "policy", "json"}),
        ("render", {"seed", "policy"}),
    ],
)
def test_help_tells_of_every_option(capsys, command, options):
    with pytest.raises(SystemExit) as stop:
        cli.main([command, "--help"])
    assert stop.value.code == 0
    shown = set(re.findall(r"--([a-z][\w.-]*)", capsys.readouterr().out))
    assert options <= shown


@pytest.mark.parametrize("arguments", [["--help"], ["-h"]])
def test_help_tells_of_every_command(capsys, arguments):
    with pytest.raises(SystemExit) as stop:
        cli.main(arguments)
    assert stop.value.code == 0
    out = capsys.readouterr().out
    assert all(f"\n  {command} " in out for command in ("train", "evaluate", "render"))


def test_training_fills_its_folder_and_says_so(trained):
    folder, done = trained
    names = {
        "config.json", "metrics.jsonl", "checkpoints", "evaluation.json", "trajectories.png", "episode.gif",
        "learning_curve.png", "bundle",
    }  # fmt: skip
    assert {path.name for path in folder.iterdir()} == names
    assert str(folder) in done.stdout.splitlines()[-1]
    assert all(name in done.stdout for name in names - {"checkpoints"})
    # Not on a terminal: a line for each evaluation, with what remains to be done.
    progress = done.stderr.splitlines()[-12:]
    assert all(re.match(r" *\d+%  .*success square [\d.]+, \d+ s left$", line) for line in progress), done.stderr
    assert progress[-1].startswith("100%")
    result = json.loads((folder / "evaluation.json").read_text())
    assert (result["policy"], result["episodes"], result["seed"]) == ("last", 500, 0)


def test_evaluate_prints_one_json_object(jaxnav, trained):
    folder, _ = trained
    before = content(folder)
    done = jaxnav("evaluate", folder, "--episodes", 500, "--json")
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.count("\n") == 1
    result, stored = json.loads(done.stdout), json.loads((folder / "evaluation.json").read_text())
    # The checkpoint holds the very policy that training evaluated.
    assert result["scenes"] == stored["scenes"]
    assert content(folder) == before


def test_a_policy_plays_in_other_scenes_and_the_result_says_what_changed(capsys, trained, tmp_path):
    folder, file = trained[0], tmp_path / "yard.py"
    file.write_text(
        "import dataclasses\nfrom jaxnav import SCENES\nYARD = dataclasses.replace(SCENES['square'], name='yard')\n"
    )
    cli.main(["evaluate", str(folder), "--scene", f"{file}:YARD,hallway", "--episodes", "20", "--json"])
    result = json.loads(capsys.readouterr().out)
    assert list(result["scenes"]) == ["yard", "hallway"]
    assert result["trained_in"] == ["square"]
    assert result["changed"] == {"world.nearest": 1, "world.scenes": [f"{file}:YARD", "hallway"]}
    # The yard is a square of another name: the same episodes end in the same way.
    cli.main(["evaluate", str(folder), "--episodes", "20", "--json"])
    here = json.loads(capsys.readouterr().out)
    assert here["scenes"]["square"] == result["scenes"]["yard"] and "trained_in" not in here


def test_compare_plays_runs_on_the_same_episodes(capsys, trained):
    folder = str(trained[0])
    cli.main(["compare", folder, folder, "--episodes", "20", "--json"])
    result = json.loads(capsys.readouterr().out)
    first, second = result["players"]
    found = result["scenes"]["square"]
    assert found["differences"] == [{"one": first, "other": second, "difference": 0.0, "ci95": [0.0, 0.0]}]
    assert found["players"][first] == found["players"][second]
    cli.main(["compare", folder, folder, "--episodes", "20"])
    assert f"{first} (open)" in " ".join(capsys.readouterr().out.split())
    assert "give the folders of at least two runs" in fails(capsys, "compare", folder)


def test_render_draws_the_pictures_again(jaxnav, trained, tmp_path):
    folder, pictures = tmp_path / "run", ("trajectories.png", "episode.gif", "learning_curve.png")
    shutil.copytree(trained[0], folder)
    for name in pictures:
        (folder / name).unlink()
    done = jaxnav("render", folder)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.splitlines() == [str(folder / name) for name in pictures]
    for name in pictures:
        assert (folder / name).read_bytes()[:4] in (b"\x89PNG", b"GIF8"), name


class Interruptible:
    """A training process whose lines on stderr are read as they come."""

    def __init__(self, *arguments):
        command = [sys.executable, "-m", "jaxnav.cli", "train", *map(str, arguments)]
        self.process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)

    def stop(self, number, chunks):
        """Send the signal once ``chunks`` lines of progress were printed; (exit code, what was printed after)."""
        seen = 0
        while seen < chunks:
            line = self.process.stderr.readline()
            assert line, "ended too early"
            seen += "%  " in line
        self.process.send_signal(number)
        rest = self.process.communicate()[1]
        return self.process.returncode, rest


def test_a_run_interrupted_in_every_way_ends_like_one_never_touched(jaxnav, trained, tmp_path):
    """kill -9, Ctrl-C and SIGTERM, each followed by --resume: the same parameters and the same lines, bit for bit."""
    folder = tmp_path / "run"
    arguments = [*sized(), "--out", folder]
    code, rest = Interruptible(*arguments).stop(signal.SIGKILL, chunks=3)
    assert code == -signal.SIGKILL
    for number, code in ((signal.SIGINT, 130), (signal.SIGTERM, 143)):
        saved = Run.open(folder)
        stopped, rest = Interruptible(*arguments, "--resume").stop(number, chunks=2)
        assert stopped == code
        assert "Traceback" not in rest
        assert f"--resume --out {folder}" in rest
        # What was saved is what the last line tells of: nothing is lost.
        lines = saved.files.metrics()
        assert int(saved.restore().loop.counter) * 16 == lines[-1]["env_steps"]
    assert not (folder / "evaluation.json").exists()
    done = jaxnav("train", *arguments, "--resume")
    assert done.returncode == 0, done.stderr

    whole, resumed = (Run.open(path) for path in (trained[0], folder))
    a, b = whole.files.metrics(), resumed.files.metrics()
    assert len(a) == 12
    for line in (*a, *b):
        assert line.pop("wall_seconds") > 0
    assert a == b
    for (path, x), y in zip(
        jax.tree_util.tree_leaves_with_path(whole.restore()), jax.tree.leaves(resumed.restore()), strict=True
    ):
        if jax.numpy.issubdtype(x.dtype, jax.dtypes.prng_key):
            x, y = jax.random.key_data(x), jax.random.key_data(y)
        np.testing.assert_array_equal(x, y, err_msg=jax.tree_util.keystr(path))


def test_a_loss_that_turns_non_finite_stops_the_run(jaxnav, tmp_path):
    folder = tmp_path / "a [bold]run[/b] of mine"
    done = jaxnav("train", *sized(), "--hyper.critic-lr", 1e38, "--out", folder)
    assert done.returncode == 2
    assert "Traceback" not in done.stderr
    error = done.stderr.splitlines()[-1]
    assert re.match(r"error: .*critic_loss.* turned non-finite by step 5 .*lower .*hyper.critic.lr", error), error
    assert f"training in {folder} (preset quick, seed 0); the first chunk compiles" in done.stderr.splitlines()
    assert not (folder / "evaluation.json").exists()


def test_a_folder_that_holds_a_run_is_not_touched(capsys, trained):
    folder, _ = trained
    before = content(folder)
    assert "already holds a run" in fails(capsys, "train", *sized(), "--out", folder)
    assert "another hyper.tau:" in fails(capsys, "train", *sized(hyper__tau=0.5), "--resume", "--out", folder)
    assert "scene 'moon' is unknown" in fails(capsys, "evaluate", folder, "--scene", "moon")
    assert content(folder) == before


def test_the_last_preset_counts_like_the_last_of_every_option(capsys):
    assert "scene 'moon'" in fails(capsys, "train", "--preset", "fast", "--preset", "quick", "--scene", "moon")
    assert "preset 'fast'" in fails(capsys, "train", "--preset", "quick", "--preset=fast", "--scene", "moon")


def test_there_has_to_be_a_run_to_resume(capsys, tmp_path):
    error = fails(capsys, "train", "--resume", "--out", tmp_path / "run")
    assert "holds no run to resume" in error
    assert list(tmp_path.iterdir()) == []


def test_export_writes_a_bundle_that_verifies(capsys, trained, tmp_path):
    """The one that training wrote is the same; the policy that did best is another one."""
    folder, _ = trained
    cli.main(["export", str(folder), "--out", str(tmp_path / "last")])
    assert f"{tmp_path / 'last'}: " in capsys.readouterr().out
    assert content(tmp_path / "last") == content(folder / "bundle")
    cli.main(["export", "--verify", str(tmp_path / "last")])
    assert "is whole; selftest passed, 128 recorded inputs" in capsys.readouterr().out
    origin = json.loads((folder / "bundle" / "contract.json").read_text())["origin"]
    stored = json.loads((folder / "config.json").read_text())
    assert origin["run"] == "run" and origin["policy"] == "last" and origin["git_commit"] == stored["git_commit"]
    assert origin["evaluation"] == json.loads((folder / "evaluation.json").read_text())
    assert origin["config"]["train"] == stored["config"]["train"]
    said = fails(capsys, "export", folder, "--out", tmp_path / "last")
    assert "already holds a bundle: give another --out" in said


def test_what_can_be_wrong_about_an_export_is_one_line(capsys, trained, tmp_path):
    folder, _ = trained
    assert "no run is given: jaxnav export RUN" in fails(capsys, "export")
    assert "give it alone" in fails(capsys, "export", folder, "--verify", folder / "bundle")
    assert "holds no bundle" in fails(capsys, "export", "--verify", tmp_path)
    assert "holds no run" in fails(capsys, "export", tmp_path)
    assert "'worst'" in fails(capsys, "export", folder, "--policy", "worst")
    bare = tmp_path / "bare"
    bare.mkdir()
    shutil.copy(folder / "config.json", bare)
    assert "holds no checkpoint" in fails(capsys, "export", bare)
    out = tmp_path / "out"
    assert "can't be run" in fails(capsys, "export", folder, "--out", out, "--torchscript", tmp_path / "python")
    assert not out.exists() and sorted(path.name for path in tmp_path.iterdir()) == ["bare"]


@pytest.mark.parametrize("command", ["evaluate", "render", "export"])
def test_a_damaged_checkpoint_is_one_line(jaxnav, trained, tmp_path, command):
    folder = tmp_path / "run"
    shutil.copytree(trained[0], folder)
    newest = folder / "checkpoints" / "step_60"
    os.truncate(max((path for path in newest.rglob("*") if path.is_file()), key=lambda path: path.stat().st_size), 100)
    before = content(folder)
    done = jaxnav(command, folder)
    assert (done.returncode, done.stdout) == (2, "")
    assert re.fullmatch(rf"error: {re.escape(str(newest))} is damaged: [^\n]+\n", done.stderr)
    assert content(folder) == before


def test_a_disk_that_fills_up_is_one_line_and_the_older_checkpoints_stay(trained, tmp_path):
    """No file may grow beyond 40 kB, which the checkpoints of this run do: writing fails like on a full disk."""
    folder = tmp_path / "run"
    code = (
        "import resource, signal, sys, jaxnav.cli as cli;"
        "signal.signal(signal.SIGXFSZ, signal.SIG_IGN);"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (40_000, 40_000));"
        "cli.main(sys.argv[1:])"
    )
    shutil.copytree(trained[0], folder)
    shutil.rmtree(folder / "checkpoints" / "step_60")
    command = [sys.executable, "-c", code, "train", *sized(), "--resume", "--out", str(folder)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=240)
    assert done.returncode == 2, done.stderr
    assert "Traceback" not in done.stderr
    error = done.stderr.splitlines()[-1]
    assert re.match(
        r"error: \S+/checkpoints could not take the checkpoint of step 60 \(.+\): .*go on with --resume", error
    )
    assert int(Run.open(folder).restore().loop.counter) == 55


def test_understand_prints_an_object_a_line(jaxnav, trained):
    """The phrases of the table need no encoder; an untrained robot may take them for anything."""
    said = ["I'm in a hurry", "Watch out on your right!", "", "\N{THUMBS UP SIGN}"]
    done = jaxnav("understand", "--run", trained[0], "--json", input="\n".join(said) + "\n")
    assert done.returncode == 0, done.stderr
    rows = [json.loads(line) for line in done.stdout.splitlines()]
    assert [row["text"] for row in rows] == said
    for row in rows:
        assert set(row) == {"text", "message", "confidence"} and 0.25 <= row["confidence"] <= 1.0
        assert row["message"] in ("silence", "stop", "right", "left")
    assert [(row["message"], row["confidence"]) for row in rows[2:]] == [("silence", 1.0)] * 2
    assert "heard as silence" in done.stderr
    done = jaxnav("understand", "--run", trained[0], *said[:2])
    assert [line.split("  ")[-1 - line.endswith(")")] for line in done.stdout.splitlines()] == said[:2]


def test_talk_replays_a_conversation_and_draws_it(jaxnav, trained, tmp_path):
    script, picture = tmp_path / "script.txt", tmp_path / "talk.gif"
    script.write_text("0.8 I'm in a hurry\n99 Thank you\n")
    done = jaxnav("talk", trained[0], "--script", script, "--gif", picture)
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    said = [line for line in lines if line.startswith("  0.8 s  ")]
    assert said[0] == "  0.8 s  pedestrian: I'm in a hurry" and "understood: " in said[1]
    assert "not said, the episode was over: 99 Thank you" in lines
    assert lines[-1] == f"drawn in {picture}"
    assert picture.read_bytes()[:4] == b"GIF8"


def test_talk_at_the_prompt_ends_with_the_input(jaxnav, trained):
    done = jaxnav("talk", trained[0], input="\nI'm in a hurry\n1.2\nquit\n")
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.count("you> ") == 4
    assert "#" * 20 in done.stdout and "pedestrian: I'm in a hurry" in done.stdout
    assert jaxnav("talk", trained[0], input="\n").returncode == 0


def test_what_can_be_wrong_about_words_is_one_line(capsys, trained, tmp_path, monkeypatch):
    folder, script = trained[0], tmp_path / "script.txt"
    script.write_text("soon Stop!\n")
    for name in ("OPENAI_BASE_URL", "OPENAI_MODEL", "OPENAI_API_KEY"):
        monkeypatch.delenv(name, raising=False)
    assert "holds no run" in fails(capsys, "talk", tmp_path / "none")
    assert "holds no run" in fails(capsys, "understand", "--run", tmp_path / "none", "Hi")
    assert "scene 'moon' is unknown" in fails(capsys, "talk", folder, "--scene", "moon")
    assert "write seconds and a sentence" in fails(capsys, "talk", folder, "--script", script)
    assert "ends in .gif" in fails(capsys, "talk", folder, "--gif", tmp_path / "talk.png")
    assert "in a folder that exists" in fails(capsys, "talk", folder, "--gif", tmp_path / "no" / "talk.gif")
    assert "--speaker is 'parrot': give one of templates, llm" in fails(capsys, "talk", folder, "--speaker", "parrot")
    assert "OPENAI_BASE_URL, OPENAI_MODEL, OPENAI_API_KEY not set" in fails(capsys, "talk", folder, "--speaker", "llm")
    assert "language command 'burn' is unknown" in fails(capsys, "language", "burn")
    assert "--encoder 'ear' is unknown" in fails(capsys, "language", "build", "--encoder", "ear")
    assert "ends in .npz" in fails(capsys, "language", "build", "--out", tmp_path / "table.csv")
    assert "--phrases is 'exam': give one of test" in fails(capsys, "evaluate", folder, "--phrases", "exam")


def test_a_run_of_another_table_or_without_ears_is_refused(capsys, trained, tmp_path):
    folder = tmp_path / "run"
    shutil.copytree(trained[0], folder)
    config = json.loads((folder / "config.json").read_text())
    (folder / "config.json").write_text(json.dumps(config | {"embeddings": "another"}))
    assert "was trained with another table of embeddings" in fails(capsys, "understand", "--run", folder, "Hi")
    config["config"]["agent"]["language"], config["embeddings"] = "codes", None
    (folder / "config.json").write_text(json.dumps(config))
    assert "hears no phrases" in fails(capsys, "understand", "--run", folder, "Hi")
