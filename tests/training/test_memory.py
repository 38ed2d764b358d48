"""Replay that does not fit is refused before training."""

import dataclasses
from types import SimpleNamespace

import jax
import psutil
import pytest

from jaxnav.errors import UserError
from jaxnav.training import memory
from jaxnav.training.run import Run

TRANSITION = 194  # bytes; any number would do


@pytest.fixture
def machine(monkeypatch, tmp_path):
    """Sets what the machine says of itself: main memory, memory of an accelerator, limit of a container."""

    def say(total, accelerator=None, container="max"):
        stats = accelerator and {"bytes_limit": accelerator}
        monkeypatch.setattr(jax, "devices", lambda: [SimpleNamespace(memory_stats=lambda: stats)])
        monkeypatch.setattr(psutil, "virtual_memory", lambda: SimpleNamespace(total=total))
        (tmp_path / "limit").write_text(container + "\n")
        monkeypatch.setattr(memory, "_CONTAINER_LIMIT", tmp_path / "limit")

    return say


def test_replay_and_its_copy_have_to_fit(machine, tiny, tmp_path):
    row = TRANSITION * tiny(tmp_path).train.episodes
    machine(total=2 * 100 * row)
    memory.check_memory(tiny(tmp_path, replay_rows=100), TRANSITION)
    with pytest.raises(UserError, match=r"train\.replay_rows is 101: .* of memory: give at most 100$"):
        memory.check_memory(tiny(tmp_path, replay_rows=101), TRANSITION)


def test_a_device_holds_its_share_of_replay_and_the_whole_copy(machine, tiny, tmp_path):
    row = TRANSITION * tiny(tmp_path).train.episodes
    machine(total=10**12, accelerator=125 * row)
    memory.check_memory(tiny(tmp_path, replay_rows=100), TRANSITION, share=0.25)
    with pytest.raises(UserError, match=r"give at most 100$"):
        memory.check_memory(tiny(tmp_path, replay_rows=101), TRANSITION, share=0.25)


def test_a_row_that_does_not_fit_asks_for_fewer_episodes(machine, tiny, tmp_path):
    machine(total=1000)
    with pytest.raises(UserError, match=r"give fewer train\.episodes$"):
        memory.check_memory(tiny(tmp_path), TRANSITION)


def test_one_who_resumes_is_not_told_to_change_the_run(machine, tiny, tmp_path):
    machine(total=1000)
    with pytest.raises(UserError, match=r"resume it where there is more$"):
        memory.check_memory(dataclasses.replace(tiny(tmp_path), resume=True), TRANSITION)


def test_a_run_too_large_leaves_no_folder(machine, tiny, tmp_path):
    run = Run(tiny(tmp_path / "run"))
    machine(total=1000)
    with pytest.raises(UserError, match=r"train\.replay_rows"):
        run.prepare_folder()
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("said", "available"),
    [
        ({"total": 8000}, 8000),
        ({"total": 8000, "container": "5000"}, 5000),
        ({"total": 8000, "container": "9223372036854771712"}, 8000),
        ({"total": 8000, "container": "5000", "accelerator": 7000}, 7000),
    ],
)
def test_memory_is_that_of_the_device_or_of_the_container(machine, said, available):
    machine(**said)
    assert memory.available_memory() == available


def test_a_system_without_containers_counts_whole(machine, monkeypatch, tmp_path):
    machine(total=8000)
    monkeypatch.setattr(memory, "_CONTAINER_LIMIT", tmp_path / "none")
    assert memory.available_memory() == 8000
