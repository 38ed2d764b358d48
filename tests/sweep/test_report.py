"""The report of a sweep against values known by construction, and against other ways of computing them."""

import dataclasses
import itertools
import json
import math
import os
import re
import unittest.mock

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxnav.errors import UserError
from jaxnav.sweep import Guard, Range, Sweep, progress, report
from jaxnav.sweep.importance import LEAST
from jaxnav.sweep.page import markdown
from jaxnav.training.config import preset

from .made_up import FLOATS, at, curve, identity, results, searched, trial, whole

VALUES = {name: at(FLOATS[name], 0.3) for name in ("hyper.actor_lr", "hyper.tau")}
GUARD = {"scene": "hard", "total_steps": 100, "every": 20, "reaches": 0.8, "slack": 1.1}


def exact(objectives, seeds=(7, 8, 9), state=None, guard=(), known=None):
    """A sweep of two complete trials, 0 and 1, of which the confirmation found these objectives: {of: [one a seed]}.

    state: {(of, seed): another state}; guard: {of: [env steps to the success, None for never]}.
    """
    search = [trial(n, 0.9 - 0.1 * n, values=VALUES, seed=n) for n in range(2)]
    again = [
        dataclasses.replace(trial(0, value), of=of, seed=seed, objective=value, values=VALUES if of is not None else {},
                            state=(state or {}).get((of, seed), "complete"))
        for of, values in objectives.items() for seed, value in zip(seeds, values, strict=True)
    ]  # fmt: skip
    guarded = [
        dataclasses.replace(trial(0, 0.5), of=of, seed=seed, curve=rising_at(steps))
        for of, found in dict(guard).items() for seed, steps in zip(seeds, found, strict=True)
    ]  # fmt: skip
    known = known or identity(guard=GUARD if guard else None)
    return results(search, numbered(again), numbered(guarded), known, confirmations=2, seeds=len(seeds))


def numbered(trials):
    return [dataclasses.replace(trial, number=n) for n, trial in enumerate(trials)]


def rising_at(steps):
    """A curve of two scenes, of which the second has the success of the guard only from those env steps on."""
    rows = []
    for row in curve(0.5):
        late = steps is not None and row["env_steps"] >= steps
        rows.append(row | {"scenes": {"a": {"success": 0.9}, "b": {"success": 0.8 if late else 0.79}}})
    return tuple(rows)


def row_of(summary, number):
    (row,) = [row for row in summary["confirmed"] if row["trial"] == number]
    return row


BETTER = {None: [0.80, 0.82, 0.90], 0: [0.85, 0.88, 0.94], 1: [0.70, 0.75, 0.80]}


def test_the_best_mean_wins_and_beats_base_if_every_seed_says_so():
    summary = report.summarise(exact(BETTER))
    assert summary["winner"]["trial"] == 0 and summary["winner"]["values"] == VALUES
    assert summary["winner"]["objective"] == pytest.approx((0.85 + 0.88 + 0.94) / 3)
    difference = row_of(summary, 0)["difference"]
    assert difference["per_seed"] == pytest.approx([0.05, 0.06, 0.04])
    assert difference["mean"] == pytest.approx(0.05) and difference["ci95"] == pytest.approx([0.04, 0.06])
    assert summary["winner"]["beats_base"] is True
    assert summary["answer"] == (
        "Trial 0 wins: its mean_success is 0.890 (0.850 to 0.940) over 3 fresh seeds. It beats base, which has 0.840: "
        "the difference over the same seeds is +0.050 (+0.040 to +0.060)."
    )
    assert [row["trial"] for row in summary["confirmed"]] == [None, 0, 1]


def test_differences_are_paired_by_seed_whatever_the_order_of_the_trainings():
    found = exact(BETTER)
    other = dataclasses.replace(found, phases=found.phases | {"confirm": found.phases["confirm"][::-1]})
    pairs = [[row_of(report.summarise(r), n)["difference"] for n in (0, 1)] for r in (found, other)]
    assert pairs[0] == pairs[1]


def test_an_interval_is_that_of_all_resamples():
    values = [0.1, 0.35, 0.4, 0.75, 0.95]
    base = row_of(report.summarise(exact({None: values, 0: [0.0] * 5, 1: [0.0] * 5}, seeds=range(5))), None)
    means = np.mean(list(itertools.product(values, repeat=5)), axis=1)
    assert base["objective"]["ci95"] == pytest.approx(np.percentile(means, (2.5, 97.5)), abs=0.011)
    assert base["objective"]["mean"] == pytest.approx(0.51)


def test_a_difference_whose_interval_holds_0_is_open():
    summary = report.summarise(exact({None: [0.80, 0.82, 0.90], 0: [0.85, 0.81, 0.95], 1: [0.7, 0.7, 0.7]}))
    low, high = row_of(summary, 0)["difference"]["ci95"]
    assert low <= 0 < high and summary["winner"]["trial"] == 0
    assert summary["winner"]["beats_base"] is False
    assert "beats" not in summary["answer"] and "is open, since the interval holds 0" in summary["answer"]


def test_one_seed_has_no_interval_and_beats_nothing():
    summary = report.summarise(exact({None: [0.8], 0: [0.95], 1: [0.7]}, seeds=(7,)))
    assert all(row["objective"]["ci95"] is None for row in summary["confirmed"])
    assert summary["winner"]["trial"] == 0 and summary["winner"]["beats_base"] is False
    assert "over one fresh seed" in summary["answer"] and "open, since one seed has no interval" in summary["answer"]


@pytest.mark.parametrize("best", [0.84, 0.83])
def test_base_wins_where_nothing_is_better(best):
    summary = report.summarise(exact({None: [0.80, 0.82, 0.90], 0: [best] * 3, 1: [0.7] * 3}))
    assert summary["winner"]["trial"] is None
    assert summary["winner"]["beats_base"] is None
    assert summary["winner"]["values"] == pytest.approx({name: at(FLOATS[name], 0.5) for name in VALUES})
    assert summary["answer"].startswith("Nothing better than base was found among 2 candidates")


def test_less_may_be_better():
    summary = report.summarise(exact({None: [9.0, 8.0], 0: [9.5, 9.5], 1: [7.0, 6.5]}, seeds=(1, 2),
                                     known=identity(direction="minimize")))  # fmt: skip
    assert summary["winner"]["trial"] == 1 and summary["winner"]["beats_base"] is True
    assert [row["trial"] for row in summary["confirmed"]] == [None, 1, 0]
    assert [row["trial"] for row in summary["best"]] == [1, 0]


def test_one_that_is_too_slow_in_the_guard_cannot_win():
    # The limit is 1.1 times (200 + 400 + 600) / 3.
    guard = {None: [200, 400, 600], 0: [400, 400, 600], 1: [400, 400, 400]}
    summary = report.summarise(exact(BETTER | {1: [0.84, 0.84, 0.93]}, guard=guard))
    assert summary["guard"]["limit"] == pytest.approx(440)
    assert [row_of(summary, n)["guard"]["mean"] for n in (None, 0, 1)] == pytest.approx([400, 1400 / 3, 400])
    assert [row_of(summary, n)["guard"]["passes"] for n in (None, 0, 1)] == [True, False, True]
    assert summary["winner"]["trial"] == 1
    assert "Trial 0 has 0.890, but fails the guard, in which it takes 467 steps." in summary["answer"]
    assert "It passes the guard." in summary["answer"]


def test_exactly_the_slack_passes():
    guard = {None: [200, 200, 200], 0: [400, 400, 400], 1: [400, 400, 600]}
    known = identity(guard=GUARD | {"slack": 2.0})
    summary = report.summarise(exact(BETTER, guard=guard, known=known))
    assert [row_of(summary, n)["guard"]["passes"] for n in (0, 1)] == [True, False]


def test_a_seed_that_never_reaches_the_threshold_counts_with_all_its_steps():
    guard = {None: [200, 400, None], 0: [600, None, None], 1: [200, 200, 200]}
    summary = report.summarise(exact(BETTER, guard=guard))
    rows = {n: row_of(summary, n)["guard"] for n in (None, 0, 1)}
    assert [rows[n]["reached"] for n in rows] == [2, 1, 3]
    assert [rows[n]["mean"] for n in rows] == pytest.approx([1600 / 3, 2600 / 3, 200])  # 100 steps of 10 episodes
    assert rows[None]["per_seed"] == [200, 400, None]
    page = markdown(summary, "out")
    assert "at least 867 (600 to 1,000); 1 of 3 seeds reached it; fails" in page
    assert "a lower bound" in page


def test_a_candidate_that_broke_cannot_win():
    summary = report.summarise(exact(BETTER, state={(0, 8): "broken"}))
    row = row_of(summary, 0)
    assert row["broken"] == 1 and row["objective"]["per_seed"] == [0.85, None, 0.94]
    assert row["difference"]["per_seed"] == pytest.approx([0.05, 0.04])
    assert summary["winner"]["trial"] is None
    assert "non-finite with 1 of 3 seeds" in summary["answer"]
    assert "it can't win" in markdown(summary, "out")


def test_a_broken_base_speaks_with_the_seeds_it_has():
    summary = report.summarise(exact(BETTER, state={(None, 9): "broken"}))
    assert row_of(summary, None)["objective"]["mean"] == pytest.approx(0.81)
    assert row_of(summary, 0)["difference"]["per_seed"] == pytest.approx([0.05, 0.06])
    broken = report.summarise(exact(BETTER, state={(None, seed): "broken" for seed in (7, 8, 9)}))
    assert broken["winner"]["trial"] == 0 and broken["winner"]["beats_base"] is False
    assert "no seed of base came to its end" in broken["answer"]


def test_a_winner_that_is_better_only_by_the_seeds_base_lacks_beats_nothing():
    values = {None: [0.95, 0.90, 0.0], 0: [0.94, 0.89, 0.99], 1: [0.1, 0.1, 0.1]}
    summary = report.summarise(exact(values, state={(None, 9): "broken"}))
    assert summary["winner"]["trial"] == 0 and summary["winner"]["beats_base"] is False
    assert "open, since base lacks seeds" in summary["answer"]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda r: {"budget": r.budget | {"trials": 5}}, "3 of 5 trials of the search have not begun"),
        (lambda r: without(r, "confirm"), "2 of 3 candidates, base among them, were confirmed with all of 3 seeds"),
        (lambda r: without(r, "guard"), "2 of 3 candidates, base among them, were seen by the guard"),
        (lambda r: running(r, "confirm"), "1 confirming trainings still run"),
        (lambda r: running(r, "guard"), "1 trainings of the guard still run"),
        (lambda r: running(r, "search"), "1 trials of the search still run"),
        (lambda r: {"budget": r.budget | {"seeds": 4}}, "0 of 3 candidates"),
    ],
)
def test_there_is_no_winner_while_something_is_missing(change, words):
    found = exact(BETTER, guard={None: [200] * 3, 0: [200] * 3, 1: [200] * 3})
    assert report.summarise(found)["winner"] is not None
    summary = report.summarise(dataclasses.replace(found, **change(found)))
    assert summary["winner"] is None
    assert words in " ".join(summary["missing"]) and words in summary["answer"]
    assert row_of(summary, None)["objective"]["mean"] is not None  # what is known is shown


def without(found, phase):
    return {"phases": found.phases | {phase: found.phases[phase][:-1]}}


def running(found, phase):
    *others, last = found.phases[phase]
    return {"phases": found.phases | {phase: [*others, dataclasses.replace(last, state="running")]}}


def test_more_trials_may_ask_for_another_candidate():
    found = exact(BETTER)
    better = dataclasses.replace(found.phases["search"][0], number=2, objective=0.95)
    more = dataclasses.replace(
        found, budget=found.budget | {"trials": 3}, phases=found.phases | {"search": [*found.phases["search"], better]}
    )
    summary = report.summarise(more)
    assert summary["winner"] is None and "2 of 3 candidates" in summary["answer"]
    equal = dataclasses.replace(better, objective=found.phases["search"][1].objective)
    again = dataclasses.replace(more, phases=more.phases | {"search": [*found.phases["search"], equal]})
    assert report.summarise(again)["winner"]["trial"] == 0  # either of the two may have had the last place


def test_base_among_the_trials_is_confirmed_as_base_alone():
    found = exact(BETTER)
    known = found.identity
    base = {name: at(FLOATS[name], 0.5) for name in VALUES}
    trials = [*found.phases["search"], trial(2, 0.99, values=base)]
    more = dataclasses.replace(found, budget=found.budget | {"trials": 3}, identity=known,
                               phases=found.phases | {"search": trials})  # fmt: skip
    assert report.summarise(more)["winner"]["trial"] == 0


def test_without_confirmation_one_seed_chooses():
    trials = [trial(0, 0.8, values=VALUES), trial(1, 0.9, values=VALUES), trial(2, 0.99, "stopped", 20, VALUES)]
    summary = report.summarise(results(trials))
    assert summary["winner"] == {"trial": 1, "values": VALUES, "objective": pytest.approx(0.9), "ci95": None,
                                 "seeds": 1, "beats_base": None}  # fmt: skip
    assert summary["answer"].startswith("Trial 1 has the best mean_success of the search, 0.900. One seed chose it")
    assert [row["trial"] for row in summary["best"]] == [1, 0, 2]  # those that came furthest first


@pytest.mark.parametrize("state", ["stopped", "broken"])
def test_nothing_complete_gives_no_winner(state, tmp_path):
    summary = report.write(results([trial(n, 0.5, state, 20, VALUES) for n in range(3)]), tmp_path)
    assert summary["winner"] is None and summary["missing"] == []
    assert summary["answer"] == "No winner: nothing in the search came to its end."


def test_nothing_begun_can_be_written(tmp_path):
    summary = report.write(results(trials=8, confirmations=2), tmp_path)
    assert summary["winner"] is None and summary["best"] == [] and summary["confirmed"] == []
    assert "8 of 8 trials of the search have not begun" in summary["answer"]


@settings(max_examples=50)
@given(
    st.lists(st.sampled_from(["running", "stopped", "broken", "complete"]), max_size=12),
    st.lists(st.sampled_from(["running", "broken", "complete"]), max_size=12),
    st.integers(0, 3), st.integers(1, 3), st.booleans(), st.integers(0, 3),
)  # fmt: skip
def test_counts_add_up_whatever_the_states(search, confirm, confirmations, seeds, guard, more):
    trials = [trial(n, 0.5 + 0.01 * n, state, 40, VALUES) for n, state in enumerate(search)]
    again = [
        dataclasses.replace(trial(n, 0.5), state=state, of=[None, 0, 1][n % 3], seed=n // 3)
        for n, state in enumerate(confirm)
    ]
    known = identity(guard=GUARD if guard else None)
    found = results(trials, again, again if guard else [], known, len(trials) + more, confirmations, seeds)
    summary = report.summarise(found)
    for phase, counted in summary["counts"].items():
        states = {state: n for state, n in counted.items() if state not in ("asked", "begun")}
        assert sum(states.values()) == counted["begun"] == len(found.phases[phase])
        assert states["complete"] == sum(trial.state == "complete" for trial in found.phases[phase])
    assert (summary["winner"] is None) or not summary["missing"]
    assert not any(phase_runs(found)) or summary["winner"] is None
    json.dumps(summary, allow_nan=False)
    markdown(summary, "out")


def phase_runs(found):
    return [trial.state == "running" for trials in found.phases.values() for trial in trials]


@pytest.mark.parametrize(("floats", "sizes", "direction"), [(2, 0, "maximize"), (5, 2, "maximize"), (3, 1, "minimize")])
def test_the_value_that_decides_is_the_most_important(floats, sizes, direction):
    known = identity(floats, sizes, direction)
    trials = searched(60, known)
    if direction == "minimize":
        trials = [flipped(trial) for trial in trials]
    shares = report.summarise(results(trials, known=known))["importance"]["shares"]
    assert next(iter(shares)) == "hyper.actor_lr" and shares["hyper.actor_lr"] > 0.6
    assert set(shares) == {*known["space"], *known["sizes"]} and sum(shares.values()) == pytest.approx(1)


def flipped(trial):
    rows = tuple(row | {"objective": -row["objective"]} for row in trial.curve)
    return dataclasses.replace(trial, curve=rows, objective=-trial.objective)


def test_less_of_the_negative_matters_as_more_does():
    found = []
    for direction in ("maximize", "minimize"):
        known = identity(5, 2, direction)
        trials = searched(60, known) if direction == "maximize" else [flipped(t) for t in searched(60, known)]
        found.append(report.summarise(results(trials, known=known))["importance"])
    assert found[0] == found[1]


def test_a_size_can_be_the_most_important():
    known, trials = identity(2, 2), []
    for found in searched(40, identity(2, 2), stopped=0.0):
        widths = tuple(found.values["agent.actor_widths"])
        values = found.values | {"agent.actor_widths": widths}
        trials.append(dataclasses.replace(found, values=values, curve=curve(0.9 if widths == (64, 64) else 0.5)))
    assert next(iter(report.summarise(results(trials, known=known))["importance"]["shares"])) == "agent.actor_widths"


def test_stopped_trials_speak_of_importance_and_later_rounds_do_not():
    known = identity(2)
    trials = searched(40, known, stopped=0.9)
    found = report.summarise(results(trials, known=known))["importance"]
    assert found["trials"] == 40 and found["env_steps"] == 200
    # What happens after the first rung is of no account; broken and running ones, and those outside, aren't either.
    changed = [
        dataclasses.replace(t, curve=(t.curve[0], *(row | {"objective": 0.1} for row in t.curve[1:]))) for t in trials
    ]
    changed += [
        dataclasses.replace(trials[0], number=40 + n, state=state) for n, state in enumerate(("broken", "running"))
    ]
    changed.append(dataclasses.replace(trials[0], number=42, values=trials[0].values | {"hyper.tau": 1.0}))
    assert report.summarise(results(changed, known=known))["importance"] == found


def test_importance_is_not_made_up():
    known = identity(2)
    few = report.summarise(results(searched(LEAST - 1, known), known=known))["importance"]
    assert few["shares"] is None and "fewer than" in few["why"]
    equal = [dataclasses.replace(t, curve=curve(0.5)) for t in searched(20, known)]
    assert report.summarise(results(equal, known=known))["importance"]["why"] == "all trials are equally good"


@pytest.mark.parametrize("direction", ["maximize", "minimize"])
def test_where_most_fail_alike_importance_is_of_the_others(direction):
    known = identity(3, direction=direction)
    trials = [dataclasses.replace(t, curve=curve(t.objective if t.values["hyper.tau"] > 0.02 else 0.1))
              for t in searched(60, known, stopped=0.0, noise=0)]  # fmt: skip
    trials = [flipped(t) for t in trials] if direction == "minimize" else trials
    found = report.summarise(results(trials, known=known))["importance"]
    assert found["better"] == sum(t.values["hyper.tau"] > 0.02 for t in trials) < 30
    assert next(iter(found["shares"])) == "hyper.tau" and found["shares"]["hyper.tau"] > 0.5


def test_device_hours_are_by_phase():
    found = whole(count=20, candidates=2, seeds=3)  # rounds of 36 s, of which a complete trial has five
    hours = report.summarise(found)["device_hours"]
    rounds = sum(len(trial.curve) for trial in found.phases["search"])
    assert hours == pytest.approx({"search": 0.01 * rounds, "confirm": 0.45, "guard": 0.45})


def test_files_are_whole_and_say_the_same(tmp_path):
    found = whole(count=20, seeds=3)
    summary = report.write(found, tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["summary.json", "summary.md", "summary.png"]
    assert json.loads((tmp_path / "summary.json").read_text()) == summary
    page = (tmp_path / "summary.md").read_text()
    assert summary["answer"] in page
    assert f"    jaxnav train --from-sweep {tmp_path}\n    jaxnav sweep --report {tmp_path}\n" in page
    assert (tmp_path / "summary.png").read_bytes().startswith(b"\x89PNG")
    for header, *rows in tables(page):
        assert all(len(row) == len(header) for row in rows)


def tables(page):
    """The tables of a page: rows of cells, the header first."""
    found = re.findall(r"(?:^\|.*\|\n)+", page, flags=re.MULTILINE)
    return [[re.split(r"(?<!\\)\|", line)[1:-1] for line in table.splitlines()] for table in found]


def test_the_table_of_trials_adds_up_to_the_store(tmp_path):
    found = whole(count=30)
    report.write(found, tmp_path)
    *_, table = tables((tmp_path / "summary.md").read_text())
    header, _, *rows = [[cell.strip() for cell in row] for row in table]
    assert header[1:3] == ["asked", "begun"] and header[3:-1] == list(progress.STATES)
    for row in rows:
        assert sum(map(int, row[3:-1])) == int(row[2]) == len(found.phases[row[0]])


def test_names_with_marks_of_markdown_stay_what_they_are(tmp_path):
    found = whole(count=12, candidates=1, seeds=2)
    name, scene = "a|b *c* _d_ <e> `f` [g]\n# h", "maps/x|y_z.yaml"
    renamed = [
        dataclasses.replace(t, curve=tuple(row | {"scenes": {scene: {"success": 0.9}}} for row in t.curve))
        for t in found.phases["confirm"]
    ]
    found = dataclasses.replace(
        found,
        name=name,
        phases=found.phases | {"confirm": renamed},
        identity=found.identity | {"objective": "<lambda>"},
    )
    folder = tmp_path / "a b"
    folder.mkdir()
    report.write(found, folder)
    page = (folder / "summary.md").read_text()
    assert page.splitlines()[0] == r"# Sweep a\|b \*c\* \_d\_ \<e\> \`f\` \[g\] \# h"
    assert r"success in maps/x\|y_z.yaml" in page and r"\<lambda\>" in page
    assert f"--from-sweep '{folder}'" in page
    for header, *rows in tables(page):
        assert all(len(row) == len(header) for row in rows)


@pytest.mark.parametrize(("number", "remedy"), [(28, "free some space"), (13, "make it writable")])
def test_a_file_that_cannot_be_written_leaves_the_old_one(tmp_path, number, remedy):
    found = whole(count=12, candidates=1, seeds=2)
    report.write(found, tmp_path)
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}

    def fail(path, *_):
        raise OSError(number, os.strerror(number))

    with unittest.mock.patch("pathlib.Path.replace", fail), pytest.raises(UserError, match=remedy) as error:
        report.write(dataclasses.replace(found, name="another"), tmp_path)
    assert "summary.json" in str(error.value)
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before


def test_a_folder_that_is_none_is_a_user_error(tmp_path):
    with pytest.raises(UserError, match=r"summary\.json can't be written"):
        report.write(whole(count=12, candidates=1, seeds=2), tmp_path / "none")


def test_objectives_that_are_not_finite_count_for_nothing():
    found = exact(BETTER)
    more = [trial(2, 0.99, "broken", values=VALUES), trial(3, 0.5, values=VALUES)]
    more[1] = dataclasses.replace(more[1], objective=math.nan)
    again = [dataclasses.replace(t, objective=math.inf) if (t.of, t.seed) == (1, 8) else t
             for t in found.phases["confirm"]]  # fmt: skip
    phases = {"search": [*found.phases["search"], *more], "confirm": again}
    summary = report.summarise(dataclasses.replace(found, budget=found.budget | {"trials": 4}, phases=phases))
    assert [row["trial"] for row in summary["best"]] == [0, 1]
    assert row_of(summary, 1)["objective"]["per_seed"] == [0.7, None, 0.8]
    assert summary["winner"]["trial"] == 0
    json.dumps(summary, allow_nan=False)


def test_it_reads_what_a_sweep_says_of_itself():
    names = {"hyper.tau": Range(0.001, 0.05, log=True), "world.params.reward_collision": Range(-50.0, -5.0)}
    sweep = Sweep(
        base=preset("quick"), space=names, sizes={"agent.actor_widths": ((64, 64), (128, 128))}, guard=Guard()
    )
    known = sweep.identity()
    values = sweep.base_values() or {}
    base = dataclasses.replace(trial(0, 0.5, total=1), values=values)
    found = dataclasses.replace(results([base], [base, base], known=known, confirmations=1, seeds=2), name="own")
    summary = report.summarise(found)
    assert row_of(summary, None)["values"] == progress.plain(values)
    assert summary["counts"]["confirm"]["asked"] == 2  # the only trial is base, which is confirmed anyway
    json.dumps(summary, allow_nan=False)
