"""The recipes of docs/extending.md, as an outsider follows them: files of their own, and no edit of the package."""

import dataclasses
import pathlib
import re
import shutil
import subprocess
import sys

import pytest

import jaxnav
from jaxnav.export.of_run import export_run
from jaxnav.export.verify import verify
from jaxnav.training.run import Run

ROOT = pathlib.Path(__file__).parents[1]
RECIPES = ROOT / "docs" / "recipes"
LONGEST = {"scene.py": 25, "people.py": 40, "reward.py": 15, "encoder.py": 60, "learner.py": 80, "request.patch": None}


def test_the_page_shows_the_files_and_they_are_short():
    page = (ROOT / "docs" / "extending.md").read_text()
    shown = dict(re.findall(r"<!-- (\S+) -->\n```\w+\n(.*?)```\n", page, re.DOTALL))
    assert shown == {name: (RECIPES / name).read_text() for name in LONGEST}
    for name, most in LONGEST.items():
        assert most is None or shown[name].count("\n") <= most, name
    assert set(LONGEST) == {path.name for path in RECIPES.iterdir() if path.is_file()}


def test_a_robot_trains_with_a_scene_people_a_reward_and_an_encoder_from_files(tmp_path, monkeypatch):
    """Named relative to where the command runs, and opened again from another folder, after the files are gone."""
    shutil.copytree(RECIPES, tmp_path / "mine", ignore=shutil.ignore_patterns("__pycache__"))
    monkeypatch.chdir(tmp_path / "mine")
    base = jaxnav.preset("quick", "td3")
    world = dataclasses.replace(
        base.world, scenes=("scene.py:JUNCTION",), people="people.py:POLITE", reward="reward.py:sparse",
        pedestrians=2, beams=12, params=base.world.params.replace(max_steps=12.0),
    )  # fmt: skip
    sizes = {"actor_widths": (16,), "critic_widths": (16,), "batch": 32}
    config = dataclasses.replace(
        base, world=world, agent=dataclasses.replace(base.agent, encoder="encoder.py:SECTORS", **sizes),
        train=dataclasses.replace(base.train, episodes=16, replay_rows=20, total_steps=10, steps_per_chunk=10),
    )  # fmt: skip
    lines = []
    jaxnav.train(config, out=tmp_path / "run", report=lines.append, finish=False)
    assert lines[-1]["env_steps"] == 160
    shutil.rmtree(tmp_path / "mine")
    monkeypatch.chdir(tmp_path)
    moved = (tmp_path / "run").rename(tmp_path / "elsewhere")
    policy = jaxnav.load(moved)
    assert [scene.name for scene in policy.world.scenes] == ["junction"]
    (episode,) = jaxnav.record(policy, episodes=1)
    terms = episode.outcomes.reward_terms
    assert set(terms) == {"arrival", "collision", "closeness", "progress"}
    assert sum(terms.values()) == pytest.approx(episode.outcomes.reward)
    export_run(Run.open(moved), policy, "last", tmp_path / "bundle")
    assert "selftest passed" in verify(tmp_path / "bundle")


def test_a_request_is_added_in_three_places(tmp_path):
    """A copy of the package with the patch: a pedestrian who agrees slows down, words and networks know the request."""
    shutil.copytree(ROOT / "jaxnav", tmp_path / "jaxnav", ignore=shutil.ignore_patterns("__pycache__"))
    subprocess.run(["git", "apply", RECIPES / "request.patch"], cwd=tmp_path, check=True)
    assert len(re.findall(r"^\+\+\+ ", (RECIPES / "request.patch").read_text(), re.MULTILINE)) <= 4
    done = subprocess.run([sys.executable, "-c", _SLOWS_DOWN], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == [str(tmp_path / "jaxnav" / "__init__.py"), "0.5", "5"]


_SLOWS_DOWN = """
import dataclasses
import jax, jax.numpy as jnp
import jaxnav
from jaxnav.export.of_run import export_run
from jaxnav.export.verify import verify
from jaxnav.training.run import Run
from jaxnav.agents import HSAC, HSACConfig
from jaxnav.agents.networks import Actor
from jaxnav.language.speaker import Context, sentences
from jaxnav.world.people import intend
from jaxnav.world.types import AGREES, REQUESTS

world, params = jaxnav.World(), jaxnav.Params()
slow = REQUESTS.index("slow-down")
with jax.disable_jit(False):
    state = jax.jit(world.reset)(jax.random.key(0), params)

    @jax.jit
    def speed(request):
        encounters = state.encounters.replace(
            is_open=jnp.array([True]), reply=jnp.array([AGREES]), request=jnp.array([request])
        )
        found = intend(state.pedestrians, encounters, state.traits, params)
        return jnp.hypot(found.vx, found.vy)[0]

assert sentences(Context(slow)) and sentences(Context(slow, "pedestrian"))
print(jaxnav.__file__, round(float(speed(slow) / speed(0)), 3), HSAC(HSACConfig(requests=5)).requests)
"""
