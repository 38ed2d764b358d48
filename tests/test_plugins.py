"""Parts named file.py:NAME: loaded once, kept by a run, and refused in one line."""

import dataclasses
import json

import pytest

from jaxnav import plugins
from jaxnav.errors import UserError
from jaxnav.training.config import preset, resolve, run_from_json
from jaxnav.training.dataclass_json import to_json
from jaxnav.training.run import Run
from jaxnav.world import SCENES, Scene

SCENE = """
import dataclasses
from jaxnav.world import SCENES

loaded = []
YARD = dataclasses.replace(SCENES["square"], name="yard")
SHED = dataclasses.replace(SCENES["square"], name="shed", crowd=(2, 3))
BOTH = [YARD, SHED]
NUMBER = 3


def fast(events, params):
    return {"speed": events.v}
"""


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "mine" / "yards.py"
    path.parent.mkdir()
    path.write_text(SCENE)
    return path


def test_a_part_is_loaded_once_by_its_text(file, tmp_path):
    yard = plugins.load_part(f"{file}:YARD", "scene")
    copy = tmp_path / "copy.py"
    copy.write_text(SCENE)
    assert isinstance(yard, Scene) and yard.name == "yard" and yard.name not in SCENES
    assert plugins.load_part(f"{copy}:YARD", "scene") is yard
    assert [scene.name for scene in plugins.load_part(f"{file}:BOTH", "scene")] == ["yard", "shed"]
    assert plugins.load_part(f"{file}:fast", "reward").__name__ == "fast"


@pytest.mark.parametrize(
    ("text", "name", "kind", "says"),
    [
        (
            None,
            "no.py:YARD",
            "scene",
            r"world\.scenes is '.*no\.py:YARD': .* can't be read \(No such file.*: give ",
        ),
        ("x = 1\n\nraise OSError('no\\nroof')", "a.py:A", "scene", r"line 3 of it raises OSError \(no roof\): mend"),
        ("x = = 1", "a.py:A", "reward", r"world\.reward is .* line 1 of it raises SyntaxError \("),
        ("import sys\nsys.exit(3)", "a.py:A", "scene", r"line 2 of it raises SystemExit \(3\): mend"),
        (SCENE, "a.py:ROOF", "scene", r"there is no ROOF in it; choose from YARD, SHED, BOTH$"),
        (SCENE, "a.py", "scene", r"has no NAME: choose from YARD, SHED, BOTH$"),
        (SCENE, "a.py:", "scene", r"has no NAME: choose from YARD, SHED, BOTH$"),
        (SCENE, "a.py:NUMBER", "scene", r"of type int, not a Scene or several: choose from YARD"),
        (
            SCENE,
            "a.py:YARD",
            "encoder",
            r"agent\.encoder is .*, of type Scene, not an Encoder: .*a\.py has no encoder: add",
        ),
        (SCENE, "a.py:YARD", "learner", r"algo is .*, of type Scene, not what register_learner returns: "),
        (SCENE, "a.py:YARD", "reward", r"world\.reward is .*, of type Scene, not a function .*: choose from fast"),
    ],
)
def test_what_is_no_part_is_refused_in_one_line(tmp_path, text, name, kind, says):
    if text is not None:
        (tmp_path / "a.py").write_text(text)
    with pytest.raises(UserError, match=says) as error:
        plugins.load_part(f"{tmp_path}/{name}", kind)
    assert "\n" not in str(error.value)


def run_of(file, out):
    config = preset("quick", scenes=f"{file}:YARD,{file}:SHED")
    world = dataclasses.replace(config.world, reward=f"{file}:fast")
    return Run(resolve(dataclasses.replace(config, world=world, out=str(out))))


def test_a_run_keeps_its_files_and_opens_anywhere(file, tmp_path, monkeypatch):
    run = run_of(file, tmp_path / "run")
    assert run.world.config.scenes == ("yard", "shed") and run.config.world.pedestrians == 3
    run.prepare_folder()
    stored = json.loads((tmp_path / "run" / "config.json").read_text())
    assert stored["config"]["world"]["scenes"] == ["sources/yards.py:YARD", "sources/yards.py:SHED"]
    assert stored["config"]["world"]["reward"] == "sources/yards.py:fast"
    assert list(stored["sources"]) == ["yards.py"]

    (tmp_path / "run").rename(tmp_path / "moved")
    file.unlink()
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    opened = Run.open(tmp_path / "moved")
    assert opened.world.config.scenes == ("yard", "shed")
    assert opened.config.world.scenes[0] == f"{tmp_path}/moved/sources/yards.py:YARD"
    monkeypatch.chdir(tmp_path / "moved")
    assert Run.open(".").world.config.scenes == ("yard", "shed")


def test_a_run_is_resumed_with_the_files_it_was_started_with(file, tmp_path):
    run = run_of(file, tmp_path / "run")
    run.prepare_folder()
    again = Run(dataclasses.replace(run.config, resume=True))
    again.prepare_folder()
    file.write_text(SCENE + "\n# another")
    with pytest.raises(UserError, match=r"holds a run with another sources\.yards\.py: give the same values"):
        Run(dataclasses.replace(run.config, resume=True)).prepare_folder()


@pytest.mark.parametrize("change", ["edit", "remove"])
def test_a_changed_copy_is_refused_in_one_line(file, tmp_path, change):
    run_of(file, tmp_path / "run").prepare_folder()
    copy = tmp_path / "run" / "sources" / "yards.py"
    if change == "edit":
        copy.write_text(SCENE + "\n")
        says = (
            r"^\S*yards\.py has changed since the run was trained: undo the change, or train anew with another --out$"
        )
    else:
        copy.unlink()
        says = r"^\S*yards\.py, with which the run was trained, is missing: put it back, or train anew$"
    with pytest.raises(UserError, match=says):
        Run.open(tmp_path / "run")


def test_two_files_of_one_name_are_refused(file, tmp_path):
    other = tmp_path / "yards.py"
    other.write_text(SCENE.replace("yard", "garden"))
    config = preset("quick", scenes=f"{file}:YARD,{other}:YARD")
    with pytest.raises(UserError, match=r"two files are called yards\.py, .*: rename one"):
        plugins.keep(config, tmp_path / "run")


def test_a_configuration_without_files_is_left_as_it_is(tmp_path):
    config = resolve(preset("quick"))
    assert plugins.keep(config, tmp_path) == (config, {}) and list(tmp_path.iterdir()) == []
    data = json.loads(json.dumps(to_json(config)))
    assert run_from_json(plugins.check(data, {}, tmp_path)) == config
