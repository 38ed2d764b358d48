"""Checkpoints: bit for bit, or one line that says what is wrong and nothing changed."""

import errno
import os
import pathlib
import re
import shutil

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxnav.errors import UserError
from jaxnav.training.checkpoint import Checkpoints
from jaxnav.training.run import Run

CONFIG = {"seed": 0, "hyper": {"tau": 0.5}}


def state(fill):
    """Of every type that a run's state has; the noise can't be compressed, so that files have a size."""
    noise = jax.random.bits(jax.random.key(fill), (4096,), jnp.uint32)
    return {
        "key": jax.random.key(fill, impl="rbg"),
        "keys": jax.random.split(jax.random.key(fill, impl="rbg"), 3),
        "floats": jnp.array([fill, np.nan, -0.0, np.inf, 1e-42], jnp.float32),
        "count": jnp.int32(fill), "flags": jnp.arange(5) % 2 == 0, "small": jnp.arange(5, dtype=jnp.uint8) + fill,
        "noise": noise,
    }  # fmt: skip


def like():
    return jax.eval_shape(lambda: state(0))


def save(folder, *steps):
    checkpoints = Checkpoints(folder)
    for step in steps:
        checkpoints.save(step, state(step), {"config": CONFIG, "metrics_bytes": 10 * step, "wall_seconds": 1.5})
    return checkpoints


def content(folder):
    """{path: bytes} of all files, None of folders."""
    paths = sorted(pathlib.Path(folder).rglob("*"))
    return {str(path.relative_to(folder)): path.read_bytes() if path.is_file() else None for path in paths}


def test_restoring_is_bit_for_bit(tmp_path, assert_same):
    save(tmp_path, 3, 7)
    fresh = Checkpoints(tmp_path)
    assert fresh.latest_step() == 7
    restored, meta = fresh.restore(like(), CONFIG)
    assert_same(restored, state(7))
    assert np.signbit(restored["floats"][2])
    assert (meta["metrics_bytes"], meta["wall_seconds"], meta["config"]) == (70, 1.5, CONFIG)


def test_the_two_newest_are_kept_and_deleting_the_newest_falls_back(tmp_path, assert_same):
    save(tmp_path, 1, 2, 3)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["step_2", "step_3"]
    shutil.rmtree(tmp_path / "step_3")
    assert_same(Checkpoints(tmp_path).restore(like(), CONFIG)[0], state(2))


def test_none_is_said_to_be_none(tmp_path):
    assert Checkpoints(tmp_path / "empty").latest_step() is None
    with pytest.raises(UserError, match=r"holds no checkpoint: train"):
        Checkpoints(tmp_path / "empty").restore(like(), CONFIG)


def test_another_configuration_is_named_field_by_field(tmp_path):
    checkpoints = save(tmp_path, 1)
    before = content(tmp_path)
    with pytest.raises(UserError, match=r"step_1 is from another configuration \(hyper.tau, seed differ\): give"):
        checkpoints.restore(like(), {"seed": 1, "hyper": {"tau": 0.25}})
    assert content(tmp_path) == before


def attempt(folder):
    """((state, meta), None), or (None, what the `UserError` says)."""
    try:
        return Checkpoints(folder).restore(like(), CONFIG), None
    except UserError as error:
        return None, str(error)


# Coroutines that Orbax gave up complain when they are collected, here at some time in pytest.
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_every_truncated_file_is_found_or_does_not_matter(tmp_path, assert_same):
    """Each file in turn is cut to half, emptied, deleted: restored bit for bit all the same, or refused in one line."""
    save(tmp_path / "whole", 1, 2)
    refused = set()
    files = [path for path in content(tmp_path / "whole") if path.startswith("step_2/")]
    for name in files:
        if (tmp_path / "whole" / name).is_dir():
            continue
        for damage in (
            lambda path: os.truncate(path, path.stat().st_size // 2),
            lambda path: os.truncate(path, 0),
            os.unlink,
        ):
            folder = tmp_path / "damaged"
            shutil.rmtree(folder, ignore_errors=True)
            shutil.copytree(tmp_path / "whole", folder)
            damage(folder / name)
            before = content(folder)
            restored, refusal = attempt(folder)
            assert content(folder) == before
            if refusal:
                refused.add(name)
                assert re.fullmatch(rf"{folder.resolve()}/step_2 is damaged: delete it .*", refusal)
            else:
                assert_same(restored[0], state(2))
    largest = max(files, key=lambda name: len(content(tmp_path / "whole")[name] or b""))
    assert largest in refused
    assert {"step_2/meta/metadata", "step_2/state/_METADATA", "step_2/state/manifest.ocdbt"} <= refused


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.parametrize("pattern", ["state/**/d/*", "meta/metadata"])
def test_changed_bytes_are_found(tmp_path, assert_same, pattern):
    """At up to 200 places of the file, one at a time: restored bit for bit, or refused in one line."""
    checkpoints = save(tmp_path, 1)
    meta = checkpoints.restore(like(), CONFIG)[1]
    data = max((tmp_path / "step_1").glob(pattern), key=lambda path: path.stat().st_size)
    whole, refused = data.read_bytes(), 0
    for at in range(0, len(whole), len(whole) // 200 + 1):
        data.write_bytes(whole[:at] + bytes([whole[at] ^ 0x10]) + whole[at + 1 :])
        restored, refusal = attempt(tmp_path)
        if refusal:
            assert re.fullmatch(r"\S+step_1 is (damaged|from another configuration)[^\n]+", refusal)
            refused += 1
        else:
            assert_same(restored[0], state(1))
            assert restored[1] == meta
    assert refused > 10


@pytest.mark.parametrize("item", ["state", "meta"])
def test_a_missing_half_is_damage(tmp_path, item):
    save(tmp_path, 1)
    shutil.rmtree(tmp_path / "step_1" / item)
    with pytest.raises(UserError, match="step_1 is damaged"):
        Checkpoints(tmp_path).restore(like(), CONFIG)


def test_damage_is_told_without_a_word_from_the_libraries(tmp_path, capfd):
    save(tmp_path, 1)
    largest = max((path for path in tmp_path.rglob("*") if path.is_file()), key=lambda path: path.stat().st_size)
    os.truncate(largest, 100)
    with pytest.raises(UserError, match="is damaged"):
        Checkpoints(tmp_path).restore(like(), CONFIG)
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize(
    "error",
    [
        OSError(errno.ENOSPC, "No space left on device"),
        ValueError("RESOURCE_EXHAUSTED: Error writing local file: No space left on device\nand more"),
        RuntimeError("No space left on device"),
        Exception("No space left on device"),  # Orbax raises this, too
    ],
)
def test_a_full_disk_is_told_in_one_line_and_the_older_checkpoint_stays(tmp_path, monkeypatch, error, assert_same):
    checkpoints = save(tmp_path, 1)

    def fail(*args, **kwargs):
        raise error

    monkeypatch.setattr(checkpoints._manager, "save", fail)
    with pytest.raises(UserError, match=r"checkpoint of step 2 \(.*No space left.*\): free some space, then") as caught:
        checkpoints.save(2, state(2), {"config": CONFIG})
    assert "\n" not in str(caught.value)
    assert_same(Checkpoints(tmp_path).restore(like(), CONFIG)[0], state(1))


def test_what_a_killed_save_leaves_is_passed_over_and_written_over(tmp_path, assert_same):
    save(tmp_path, 1, 2)
    # Under this name Orbax writes until a checkpoint is whole.
    shutil.copytree(tmp_path / "step_2", tmp_path / "step_3.orbax-checkpoint-tmp")
    checkpoints = Checkpoints(tmp_path)
    assert checkpoints.latest_step() == 2
    assert_same(checkpoints.restore(like(), CONFIG)[0], state(2))
    save(tmp_path, 3)
    assert_same(Checkpoints(tmp_path).restore(like(), CONFIG)[0], state(3))


def test_a_run_restores_what_it_had(finished, assert_same):
    run, progress = finished
    assert_same(Run.open(run.folder).restore(), progress)
    assert_same(run.policy("last", progress).parameters, progress.loop.learner.averaged)
    assert_same(run.policy("best", progress).parameters, progress.best.actor)
