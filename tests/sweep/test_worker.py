"""Where populations train: a process that was lost changes nothing, and programs are compiled once."""

import dataclasses
import shutil

import pytest

from jaxnav.errors import UserError
from jaxnav.sweep import phases
from jaxnav.sweep.worker import SlotFill, Worker


def job_of(sweep, folder):
    (found, _), *_ = phases.populations(sweep, folder, "search", sweep.base, [{}], 1, 0, "validation")
    return found


def fill(sweep, round, slot, rate):
    return SlotFill(round, slot, seed=slot, values=sweep.base_values() | {"hyper.actor_lr": rate})


def plain(round):
    """All but the time."""
    return dataclasses.replace(round, seconds=0.0)


@pytest.fixture(scope="module")
def played(tiny_sweep, tmp_path_factory):
    """(sweep, job, fills, worker, its rounds): two trials begin, one takes the place of the second before the last."""
    sweep = tiny_sweep(sizes={}, rungs=(5, 10), members=2)
    where = job_of(sweep, tmp_path_factory.mktemp("worker"))
    fills = [fill(sweep, 0, 0, 1e-3), fill(sweep, 0, 1, 3e-3), fill(sweep, 2, 1, 2e-3)]
    worker = Worker()
    rounds = [worker.advance(where, i, [f for f in fills if f.round <= i]) for i in range(3)]
    return sweep, where, fills, worker, rounds


def test_slots_are_apart(played):
    _, _, _, _, rounds = played
    for round in rounds:
        assert len(round.scenes) == len(round.losses) == 2 and round.broken == [False, False]
        assert round.losses[0] != round.losses[1]
        assert set(round.scenes[0]) == {"square"} and 0 <= round.scenes[0]["square"]["success"] <= 1


def test_asked_again_it_answers_again(played):
    _, where, fills, worker, rounds = played
    assert worker.advance(where, 2, fills) is rounds[2]


@pytest.mark.parametrize("kept", [True, False], ids=["with its checkpoint", "without"])
def test_a_lost_process_is_made_up_for(played, tmp_path, kept):
    """Bit for bit, from the last checkpoint or from nothing; also if it was lost before it could answer."""
    _, where, fills, worker, rounds = played
    folder = tmp_path / "population"
    if kept:
        shutil.copytree(where.folder, folder)
        shutil.rmtree(folder / "step_3")
    other = Worker()
    other._programs = worker._programs  # compiled already
    moved = dataclasses.replace(where, folder=str(folder))
    assert plain(other.advance(moved, 2, fills)) == plain(rounds[2])
    again = Worker()
    again._programs = worker._programs
    assert plain(again.advance(where, 2, fills)) == plain(rounds[2])  # told from the checkpoint itself
    assert again._held[where.name].round == 3


def test_a_population_may_go_on_in_another_size(played, tmp_path, tiny_sweep):
    """In a folder of its own: checkpoints of the other size aren't in its way, nor is how often they are made."""
    _, where, *_ = played
    sweep = tiny_sweep(sizes={}, rungs=(5, 10), members=3)
    assert job_of(sweep, tmp_path).folder != job_of(dataclasses.replace(sweep, members=2), tmp_path).folder
    train = dataclasses.replace(where.config.train, checkpoint_seconds=9.0)
    rarer = dataclasses.replace(where, config=dataclasses.replace(where.config, train=train))
    assert rarer.program() == where.program()


def test_memory_for_all_populations_is_asked_for_at_once(played, tmp_path, monkeypatch):
    _, where, _, worker, _ = played
    population, _ = worker._programs[where.program()]
    jobs = [dataclasses.replace(where, name=name, folder=str(tmp_path)) for name in "abc"]
    fresh = Worker()
    fresh._programs = worker._programs
    monkeypatch.setattr(
        "jaxnav.training.population.free_memory", lambda: population.bytes_needed + population.bytes_held
    )
    with pytest.raises(UserError, match=r"members is 2: 3 populations of 2 members need .*: at most 1 fit"):
        fresh.prepare(jobs)
    fresh.prepare(jobs[:1])


def test_a_checkpoint_of_other_trials_is_refused(played):
    _, where, fills, worker, _ = played
    other = Worker()
    other._programs = worker._programs
    with pytest.raises(Exception, match="another configuration"):
        other.advance(where, 2, [dataclasses.replace(fills[0], seed=99), *fills[1:]])


def test_populations_that_are_alike_share_a_program(played, tmp_path):
    _, where, fills, worker, _ = played
    second = dataclasses.replace(where, name="search-1", folder=str(tmp_path), seed=7)
    worker.advance(second, 0, fills[:2])
    assert len(worker._programs) == 1
    worker.forget("search-1")
    assert list(worker._held) == [where.name]
