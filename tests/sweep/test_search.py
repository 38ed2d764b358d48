"""The search: who is drawn, stopped, confirmed, and that a kill at any moment changes none of it."""

import math

import pytest

from jaxnav.errors import UserError
from jaxnav.sweep import search
from jaxnav.sweep.report import summarise
from jaxnav.sweep.results import PHASES
from jaxnav.sweep.spec import FRESH_SEED
from jaxnav.sweep.store import Store, Study

EPISODES = 16


class Killed(BaseException):
    """What stands for kill -9: nothing catches it."""


def run(sweep, folder, engine):
    folder.mkdir(exist_ok=True)
    return search.run(sweep, folder, Store(folder, "tiny"), engine)


def key(results):
    """All that is found, the times aside."""
    return {
        phase: [(t.number, t.state, t.values, t.seed, t.of, t.objective, t.curve) for t in results.phases[phase]]
        for phase in PHASES
    }


@pytest.fixture(scope="module")
def whole(tiny_sweep, tmp_path_factory):
    from .conftest import MadeUp

    return run(tiny_sweep(), tmp_path_factory.mktemp("whole") / "sweep", MadeUp())


def test_every_trial_is_there_once_and_has_ended(whole, tiny_sweep):
    sweep = tiny_sweep()
    trials = whole.phases["search"]
    assert [trial.number for trial in trials] == list(range(sweep.trials))
    assert {trial.state for trial in trials} == {"complete", "stopped", "broken"}
    assert len({trial.seed for trial in trials}) == sweep.trials
    for trial in trials:
        steps = [row["env_steps"] for row in trial.curve]
        assert steps == [EPISODES * 5 * (i + 1) for i in range(len(steps))]  # no round is lost or counted twice
        if trial.state == "complete":
            assert len(trial.curve) == 4
        if trial.state == "broken":
            assert trial.curve[-1]["broken"] and trial.curve[-1]["objective"] is None


def test_values_lie_in_their_ranges_and_base_is_one_of_them(whole, tiny_sweep):
    sweep = tiny_sweep()
    values = [trial.values for trial in whole.phases["search"]]
    assert sum(found == sweep.base_values() for found in values) == 1
    for found in values:
        assert set(found) == {*sweep.space, *sweep.sizes}
        assert all(allowed.low <= found[name] <= allowed.high for name, allowed in sweep.space.items())
        assert found["agent.updates_per_step"] in (1, 2)


@pytest.mark.parametrize(("direction", "sign"), [("maximize", 1), ("minimize", -1)])
def test_whoever_is_stopped_was_not_among_the_best_third(tmp_path, tiny_sweep, made_up, direction, sign):
    """Asynchronous halving by hand: at its rung a trial is stopped if, of those that came there so far, too many were
    better. Trials end in turns, so what "so far" means follows from the order of their numbers and lengths."""
    results = run(tiny_sweep(direction=direction, confirm=0, members=7, trials=14), tmp_path / "sweep", made_up)
    trials = results.phases["search"]
    # All 14 begin in the first turn: at each rung the best third goes on of those that have come there unbroken.
    for rung in (0, 1):
        came = [t for t in trials if len(t.curve) > rung and not t.curve[rung]["broken"]]
        came.sort(key=lambda t: (-sign * t.curve[rung]["objective"], t.number))
        going = math.ceil(len(came) / 3)
        assert 0 < going < len(came)
        assert {t.number for t in came[:going]} == {t.number for t in trials if len(t.curve) > rung + 1}


def test_the_best_are_confirmed_beside_base_with_the_same_fresh_seeds(whole, tiny_sweep):
    sweep = tiny_sweep()
    done = [t for t in whole.phases["search"] if t.state == "complete" and t.values != sweep.base_values()]
    best = [t.number for t in sorted(done, key=lambda t: -t.objective)[:2]]
    trials = whole.phases["confirm"]
    seeds = {of: sorted(t.seed for t in trials if t.of == of) for of in (None, *best)}
    assert len(trials) == 9 and {t.of for t in trials} == set(seeds)
    assert all(found == [FRESH_SEED + i for i in range(3)] for found in seeds.values())
    for trial in trials:
        assert trial.state == "complete" and len(trial.curve) == 4
        of = next((t.values for t in done if t.number == trial.of), sweep.base_values())
        assert trial.values == of


def test_the_guard_ends_with_the_success_that_it_asks_for(whole):
    for trial in whole.phases["guard"]:
        success = [row["scenes"]["square"]["success"] for row in trial.curve]
        assert all(value < 0.8 for value in success[:-1])
        assert success[-1] >= 0.8 or len(success) == 3


def _killed_at(monkeypatch, count):
    """Die at that change of the store, half of it done."""
    left = [count]
    inner = {name: getattr(Study, name) for name in ("add", "report", "end")}

    def dying(name):
        def change(self, *arguments):
            left[0] -= 1
            if left[0] == 0:
                if name == "report" and count % 2:
                    storage = self._study._storage
                    monkeypatch.setattr(type(storage), "set_trial_user_attr", _dies)
                    return inner[name](self, *arguments)
                if name != "report" and count % 2:
                    inner[name](self, *arguments)
                raise Killed
            return inner[name](self, *arguments)

        return change

    for name in inner:
        monkeypatch.setattr(Study, name, dying(name))


def _dies(*_):
    raise Killed


@pytest.mark.parametrize("count", [1, 2, 3, 6, 7, 8, 9, 11, 12, 13, 14, 17, 20, 25, 33, 40, 47, 60, 75, 90, 101])
def test_a_sweep_that_was_killed_goes_on_as_if_it_had_not_been(tmp_path, tiny_sweep, whole, made_up, count):
    with pytest.MonkeyPatch.context() as patch:
        _killed_at(patch, count)
        with pytest.raises(Killed):
            run(tiny_sweep(), tmp_path / "sweep", made_up)
    assert key(run(tiny_sweep(), tmp_path / "sweep", made_up)) == key(whole)


def test_a_sweep_that_is_done_is_done(tmp_path, tiny_sweep, whole, made_up):
    run(tiny_sweep(), tmp_path / "sweep", made_up)
    asked = len(made_up.rounds)
    assert key(run(tiny_sweep(), tmp_path / "sweep", made_up)) == key(whole)
    assert len(made_up.rounds) == asked


def nothing(scenes):
    return float("nan")


def wrong(scenes):
    return scenes["moon"]


@pytest.mark.parametrize(
    ("objective", "message"),
    [
        (nothing, "objective nothing is nan: have it give a finite number"),
        (wrong, r"objective wrong failed \(KeyError"),
    ],
)
def test_an_objective_that_is_no_number_is_named(tmp_path, tiny_sweep, made_up, objective, message):
    with pytest.raises(UserError, match=message):
        run(tiny_sweep(objective=objective), tmp_path / "sweep", made_up)


def test_fewer_slots_than_trials_that_train_are_refused(tmp_path, tiny_sweep, made_up):
    with pytest.MonkeyPatch.context() as patch:
        _killed_at(patch, 14)
        with pytest.raises(Killed):
            run(tiny_sweep(), tmp_path / "sweep", made_up)
    with pytest.raises(UserError, match=r"members is 1, but trial .* trains in slot [12].*give as many as before"):
        run(tiny_sweep(members=1), tmp_path / "sweep", made_up)


@pytest.mark.parametrize("changes", [{"trials": 40}, {"confirm": 1}, {"confirm": 0}, {"seeds": 4}, {"members": 5}])
@pytest.mark.parametrize("count", [90, 105])
def test_a_sweep_may_go_on_as_a_larger_or_smaller_one(tmp_path, tiny_sweep, made_up, changes, count):
    """Killed while it confirms: who trains then comes to an end, by the program of its sizes, whoever is best now."""
    sizes = {"agent.updates_per_step": (1, 2, 4, 8)}
    with pytest.MonkeyPatch.context() as patch:
        _killed_at(patch, count)
        with pytest.raises(Killed):
            run(tiny_sweep(sizes=sizes, trials=16), tmp_path / "sweep", made_up)
    store = Store(tmp_path / "sweep", "tiny")
    assert any(trial.state == "running" for trial in store.trials("confirm"))
    sweep = tiny_sweep(sizes=sizes, **{"trials": 16} | changes)
    results = run(sweep, tmp_path / "sweep", made_up)
    for phase in PHASES if sweep.confirm else PHASES[:1]:
        assert all(trial.state != "running" for trial in results.phases[phase])
    for phase in PHASES:
        study = store.open(phase, sweep)
        for trial, place in zip(study.trials(), study.places().values(), strict=True):
            assert f"updates_per_step={trial.values['agent.updates_per_step']}-" in place.population
    assert summarise(results)["missing"] == []


def test_a_sweep_can_be_given_more_trials(tmp_path, tiny_sweep, made_up):
    few = run(tiny_sweep(trials=6, confirm=0), tmp_path / "sweep", made_up)
    more = run(tiny_sweep(trials=11, confirm=0), tmp_path / "sweep", made_up)
    assert key(more)["search"][:6] == key(few)["search"]
    assert len(more.phases["search"]) == 11 and all(t.state != "running" for t in more.phases["search"])
    # A population goes on from the round that it had come to: none is played twice, none left out.
    for population in {name for name, _, _ in made_up.rounds}:
        rounds = [round for name, round, _ in made_up.rounds if name == population]
        assert rounds == list(range(len(rounds)))
