"""jaxnav understand and jaxnav talk from outside."""

import json
import shutil

from .conftest import fails


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


def test_a_run_of_another_table_or_that_hears_no_sentences_is_refused(capsys, trained, tmp_path):
    folder = tmp_path / "run"
    shutil.copytree(trained[0], folder)
    config = json.loads((folder / "config.json").read_text())
    (folder / "config.json").write_text(json.dumps(config | {"embeddings": "another"}))
    assert "was trained with another table of embeddings" in fails(capsys, "understand", "--run", folder, "Hi")
    config["config"]["agent"]["language"], config["embeddings"] = "codes", None
    (folder / "config.json").write_text(json.dumps(config))
    assert "hears no phrases" in fails(capsys, "understand", "--run", folder, "Hi")
