"""Numbers over seeds, against closed forms and SciPy's."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import binomtest, bootstrap, trim_mean

from jaxnav import statistics
from jaxnav.statistics import wilson_interval

from .experiments.tables.made_up import scenes

SHARE = st.integers(0, 200).map(lambda count: count / 200)
SHARES = st.lists(SHARE, min_size=1, max_size=8)
EXAMPLES = settings(max_examples=40)  # each is a bootstrap


@pytest.mark.parametrize(
    ("values", "mean", "iqm"),
    [
        ([0.9, 0.0, 0.2, 0.1], 0.3, 0.15),  # the middle two
        ([0.5, 0.1, 0.3], 0.3, 0.3),  # a quarter of three is none
        ([0.0, 1.0, 0.5, 0.6, 0.7], 0.56, 0.6),
        ([0.0] * 2 + [0.2, 0.3, 0.4, 0.5] + [1.0] * 2, 0.425, 0.35),
        ([0.7], 0.7, 0.7),
    ],
)
def test_mean_and_interquartile_mean(values, mean, iqm):
    found = statistics.measure(values)
    assert (found["mean"], found["iqm"]) == pytest.approx((mean, iqm))
    assert found["per_seed"] == values and "wilson95" not in found


def test_the_interval_is_that_of_all_resamples():
    values = [0.1, 0.35, 0.4, 0.75, 0.95]
    means = np.mean(list(itertools.product(values, repeat=5)), axis=1)
    found = statistics.measure(values)["ci95"]
    assert found == pytest.approx(np.percentile(means, (2.5, 97.5)), abs=0.011)
    assert statistics.measure([0.0, 1.0])["ci95"] == [0.0, 1.0]  # both seeds the same one in half of the resamples


@EXAMPLES
@given(SHARES, st.randoms(use_true_random=False))
def test_a_measure_lies_among_its_values_whatever_their_order(values, random):
    found = statistics.measure(values, 200)
    low, high = found["ci95"]
    assert low - 1e-12 <= found["mean"] <= high + 1e-12
    assert min(values) <= found["iqm"] <= max(values)
    if len(values) > 1:
        assert min(values) <= low and high <= max(values)
    for value, (below, above) in zip(values, found["wilson95"], strict=True):
        assert below <= value <= above and below < above
    other = random.sample(values, len(values))
    again = statistics.measure(other, 200)
    assert again["per_seed"] == other
    assert {**again, "per_seed": 0, "wilson95": sorted(again["wilson95"])} == {
        **found, "per_seed": 0, "wilson95": sorted(found["wilson95"])
    }  # fmt: skip


@pytest.mark.parametrize("value", [0.1, 1 / 3, 1.0, 27.1])
@pytest.mark.parametrize("seeds", [2, 3, 10])
def test_the_interval_of_seeds_that_agree_is_a_point(value, seeds):
    found = statistics.measure([value] * seeds)
    assert (found["mean"], found["ci95"], found["iqm"]) == (value, [value, value], value)


def test_one_seed_has_wilsons_interval_of_a_proportion_and_none_of_anything_else():
    found = statistics.measure([0.95], 200)
    assert found["ci95"] == pytest.approx(list(binomtest(190, 200).proportion_ci(method="wilson")))
    assert found["wilson95"] == [found["ci95"]] == [wilson_interval(190, 200)]
    assert statistics.measure([1.0], 200)["ci95"][1] == 1.0
    assert statistics.measure([27.1])["ci95"] is None


def test_wilsons_intervals_are_of_each_seeds_episodes():
    found = statistics.measure([0.29, 0.57], 100)  # 0.29 * 100 is 28.999999999999996
    assert found["wilson95"] == [wilson_interval(29, 100), wilson_interval(57, 100)]


def test_what_has_no_value_is_left_out_of_the_mean():
    found = statistics.measure([None, 20.0, 22.0])
    assert (found["mean"], found["per_seed"]) == (21.0, [None, 20.0, 22.0])
    assert statistics.measure([None, 20.0]) == {"mean": 20.0, "ci95": None, "per_seed": [None, 20.0], "iqm": 20.0}
    nothing = {"mean": None, "ci95": None, "iqm": None}
    assert statistics.measure([None]) == {**nothing, "per_seed": [None]}
    assert statistics.measure([], 200) == {**nothing, "per_seed": [], "wilson95": []}
    assert statistics.measure([None, 0.5], 200)["wilson95"] == [None, wilson_interval(100, 200)]


@pytest.mark.parametrize("bad", [float("nan"), float("inf")])
def test_a_measure_refuses_what_is_not_finite(bad):
    with pytest.raises(ValueError, match="leave out what isn't finite"):
        statistics.measure([0.5, bad])


def test_the_interquartile_mean_of_a_suite_is_over_all_its_runs():
    found = statistics.suite_iqm(scenes([0.0, 0.95, 0.9, 1.0], [0.8, 0.7, 0.96, 0.1]))
    assert found["iqm"] == pytest.approx((0.7 + 0.8 + 0.9 + 0.95) / 4)
    assert (found["min"], found["reached"], found["runs"], found["scenes"]) == (0.0, 3 / 8, 8, 2)


def test_the_interval_of_a_suite_is_stratified_by_scene():
    """Scenes that differ from one another, not from seed to seed, leave nothing uncertain."""
    found = statistics.suite_iqm(scenes([0.25] * 4, [0.75] * 4))
    assert (found["iqm"], found["ci95"]) == (0.5, [0.5, 0.5])
    low, high = statistics.suite_iqm(scenes([0.25, 0.75] * 4))["ci95"]
    assert high - low > 0.2


def test_the_interval_of_a_scene_is_scipys():
    values = np.array([0.1, 0.35, 0.4, 0.5, 0.62, 0.75, 0.8, 0.95])
    other = bootstrap(
        (values,), lambda x, axis: trim_mean(x, 0.25, axis=axis), n_resamples=20_000, method="percentile",
        random_state=1, vectorized=True,
    )  # fmt: skip
    assert statistics.suite_iqm(scenes(values))["ci95"] == pytest.approx(other.confidence_interval, abs=0.02)


def test_scenes_with_one_seed_or_none_left():
    found = statistics.suite_iqm(scenes([0.5], [0.2, 0.8], []))
    assert (found["runs"], found["scenes"]) == (3, 2)
    assert found["ci95"] == pytest.approx([(0.5 + 0.4) / 3, (0.5 + 1.6) / 3])
    assert statistics.suite_iqm(scenes([0.5], [0.7]))["ci95"] is None
    assert statistics.suite_iqm(scenes([], [])) is statistics.suite_iqm([]) is None


@EXAMPLES
@given(st.lists(SHARES, min_size=1, max_size=4), st.randoms(use_true_random=False))
def test_a_suites_number_lies_in_its_interval_whatever_the_order(values, random):
    rows = scenes(*values)
    found = statistics.suite_iqm(rows)
    runs = list(itertools.chain(*values))
    assert found["min"] == min(runs) <= found["iqm"] <= max(runs)
    if found["ci95"] is not None:
        low, high = found["ci95"]
        assert low - 1e-12 <= found["iqm"] <= high + 1e-12
    other = [row | {"success": {"per_seed": random.sample(s := row["success"]["per_seed"], len(s))}} for row in rows]
    assert statistics.suite_iqm(random.sample(other, len(other))) == found
