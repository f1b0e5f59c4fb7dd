"""Intervals and tests: by hand, by scipy, and by their coverage and error rates."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy import stats

from xmarl_bench.errors import InputError
from xmarl_bench.metrics.statistics import (
    Difference,
    bonferroni,
    groups_by_head,
    holm,
    interquartile_mean,
    over_runs,
    over_samples,
    over_units,
    percentile_interval,
    percentiles,
    probability_of_improvement,
    rank_biserial,
)
from xmarl_bench.metrics.student import Design, interval_of, student_interval, student_p

P_VALUES = arrays(np.float64, st.integers(1, 12), elements=st.floats(0, 1))


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def test_differences_that_are_all_equal_have_the_p_of_the_sign_test() -> None:
    """And an interval if it is under 0.05: 1/16 of five, 1/32 of six."""
    a = np.arange(6.0)
    assert over_units([a], [a - 0.25]) == Difference(0.25, (0.25, 0.25), 1 / 32, 6, 6, 0)
    assert over_units([a[:5]], [a[:5] - 0.25]) == Difference(0.25, None, None, 5, 5, 0)
    assert over_units([a], [a]) == Difference(0.0, (0.0, 0.0), 1.0, 6, 6, 0)
    assert over_units([a[:2]], [a[:2]]) == Difference(0.0, (0.0, 0.0), 1.0, 2, 2, 0)
    np.testing.assert_array_equal(student_p(np.array([[0.1] * 3, [0.0] * 3, [-7.0] * 3])), [0.25, 1.0, 0.25])
    # Sums of the same numbers in another order are equal up to rounding.
    sums = [[0.1, 0.2, 0.3], [0.3, 0.2, 0.1], [0.2, 0.3, 0.1]]
    means = np.array([sum(each) / 3 for each in sums])
    assert len(set(means)) > 1
    assert student_p(means) == 0.25
    assert student_p(means - 0.2) == 1.0


def test_clusters_whose_means_are_equal_decide_nothing() -> None:
    """Two trainings with two policies each, of the same mean: their spread is not known."""
    pairs = Design(clusters=("a", "a", "b", "b"))
    for units in ([0.0, 0.1, 0.0, 0.1], [0.05] * 4):
        assert interval_of(np.array(units), design=pairs) is None
        assert student_p(np.array(units), design=pairs) == 0.5
    assert interval_of(np.array([-0.1, 0.1, -0.1, 0.1]), design=pairs) is None
    assert interval_of(np.zeros(4), design=pairs) == (0.0, 0.0)


@pytest.mark.slow
def test_rates_that_two_runs_share_by_chance_decide_nothing() -> None:
    """Two runs of 50 episodes, without a difference on average; one in twelve has both rates equal."""
    generator = rng(4)
    chances = np.clip(generator.normal(0.8, 0.03, (20_000, 2, 2)), 0.0, 1.0)  # (pair, run, side)
    units = np.diff(generator.binomial(50, chances), axis=-1)[..., 0] / 50
    assert np.mean((units == units[:, :1]).all(axis=1)) > 0.05
    assert np.mean(student_p(units) < 0.05) <= 0.05


def test_intervals_are_of_paired_differences_not_of_episodes() -> None:
    episodes = rng(1).normal(0, 10, 50)
    a, b = episodes + rng(2).normal(0.2, 0.1, 50), episodes
    assert not over_units([a], [b]).holds_zero
    assert over_units([a], [rng(3).permutation(b)]).holds_zero


def test_a_pair_with_nan_is_left_out_and_counted() -> None:
    difference = over_units([[1.0, np.nan, 3.0, 5.0]], [[0.0, 1.0, np.nan, 4.0]])
    assert (difference.value, difference.n, difference.n_nan) == (1.0, 2, 2)
    assert over_units([[np.nan]], [[1.0]]) == Difference(None, None, None, 0, 0, 1)
    one = over_units([[2.0, np.nan]], [[1.0, 1.0]])
    assert one == Difference(1.0, None, None, 1, 1, 1)
    assert one.holds_zero  # a single episode decides nothing


def test_the_units_of_a_single_policy_are_its_episodes() -> None:
    a, b = rng(4).normal(1, 1, 40), rng(5).normal(0.7, 1, 40)
    ours, theirs = over_units([a], [b]), stats.ttest_rel(a, b)
    assert ours.interval == pytest.approx(tuple(theirs.confidence_interval(0.95)))
    assert ours.p == pytest.approx(theirs.pvalue)
    assert ours.units == 40
    alone = over_runs([a], [b])
    assert (alone.value, alone.interval, alone.p, alone.units) == (ours.value, None, None, 1)


def test_independent_samples_are_compared_as_scipy_does_by_welch() -> None:
    a, b = rng(6).normal(1, 1, 30), rng(7).normal(0.5, 3, 12)
    ours = over_samples(np.append(a, np.nan), b)
    theirs = stats.ttest_ind(a, b, equal_var=False)
    assert ours.value == pytest.approx(a.mean() - b.mean())
    assert ours.interval == pytest.approx(tuple(theirs.confidence_interval(0.95)))
    assert ours.p == pytest.approx(theirs.pvalue)
    assert (ours.units, ours.n_nan) == (42, 1)
    assert over_samples([1.0, 1.0], [0.5, 0.5]) == Difference(0.5, None, None, 4, 4, 0)
    sure = over_samples([1.0] * 5, [0.5] * 5)
    assert (sure.interval, sure.p) == ((0.5, 0.5), 2 / 252)
    assert over_samples([1 / 3] * 2, [1 / 3 + 1e-16] * 2).p == 1.0
    assert over_samples([1.0], [0.5, 0.5]).interval is None
    assert over_samples([np.nan], [1.0]) == Difference(None, None, None, 0, 1, 1)


def test_runs_are_the_units_for_any_number_of_episodes() -> None:
    a = [rng(k).normal(k, 1, 10 + k) for k in range(4)]
    b = [rng(9 + k).normal(0, 1, 10 + k) for k in range(4)]
    ours, means = over_runs(a, b), [float((x - y).mean()) for x, y in zip(a, b, strict=True)]
    theirs = stats.ttest_1samp(means, 0.0)
    assert ours == over_units(a, b)
    assert ours.value == pytest.approx(np.mean(means))
    assert ours.interval == pytest.approx(tuple(theirs.confidence_interval(0.95)))
    assert ours.p == pytest.approx(theirs.pvalue)
    assert (ours.units, ours.n) == (4, sum(10 + k for k in range(4)))
    none = over_runs([*a, [np.nan]], [*b, [1.0]])  # a run without a number is left out
    assert (none.value, none.units, none.n_nan) == (ours.value, 4, 1)


def runs_of_a_cell(n_runs: int, spread: float, n_cells: int = 20_000) -> np.ndarray:
    """(cells, runs) mean differences of 50 episodes; runs differ by `spread` times what episodes do."""
    generator = rng(n_runs)
    runs = spread * generator.normal(size=(n_cells, n_runs, 1))
    return np.asarray((runs + generator.exponential(size=(n_cells, n_runs, 50)) - 1.0).mean(axis=-1))


@pytest.mark.slow
@pytest.mark.parametrize("n_runs", [3, 5])
@pytest.mark.parametrize("spread", [0.0, 0.3, 1.0])
def test_intervals_have_their_nominal_coverage(n_runs: int, spread: float) -> None:
    """And without a difference, one is found at most one time in twenty."""
    units = runs_of_a_cell(n_runs, spread)
    low, high = student_interval(units)
    assert 0.93 <= np.mean((low <= 0.0) & (high >= 0.0)) <= 0.97
    found = student_p(units) < 0.05
    above = units.mean(axis=1) > 0.0
    assert np.mean(found & above) <= 0.05
    assert np.mean(found & ~above) <= 0.05


def test_a_cluster_counts_as_one_by_hand() -> None:
    """Deviations -2, 0 and -1, 3 sum to -2 and 2: the error is sqrt(2 (4 + 4)) / 4 = 1."""
    difference = over_runs([[1.0], [3.0], [2.0], [6.0]], [[0.0]] * 4, design=Design(tuple("aabb")))
    half = float(stats.t.ppf(0.975, 1))
    assert difference.units == 2
    assert difference.value == 3.0
    assert difference.interval == pytest.approx((3.0 - half, 3.0 + half))
    assert difference.p == pytest.approx(2 * stats.t.sf(3.0, 1))


def test_a_cluster_weighs_no_more_for_its_units() -> None:
    design = Design(tuple("aaab"))
    assert over_runs([[0.0], [0.0], [0.0], [1.0]], [[0.0]] * 4, design=design).value == 0.5
    assert student_p(np.full(21, 0.1), design=Design((*"a" * 20, "b"))) == 0.5
    with pytest.raises(InputError, match="design of 4 for 2 runs"):
        over_runs([[0.0], [1.0]], [[0.0]] * 2, design=design)
    with pytest.raises(InputError, match="1 cells for 4 units"):
        Design(tuple("aaab"), ("one",))


def test_clusters_of_one_change_nothing_and_a_single_cluster_decides_nothing() -> None:
    a, b = [[1.0], [3.0], [2.5]], [[0.0], [1.0], [np.nan]]
    assert over_runs(a, b, design=Design(tuple("xyz"))) == over_runs(a, b)
    assert over_runs(a, b, design=Design(tuple("xyy"))).units == 2  # the third has no pair
    alone = over_runs(a, b, design=Design(tuple("xxz")))
    assert (alone.value, alone.interval, alone.p, alone.units) == (1.5, None, None, 1)


def test_cells_weigh_the_same_by_hand() -> None:
    """Weights 1/4, 1/4 and 1/2 give a mean of 4 and an effective number of 1 / (1/16 + 1/16 + 1/4) = 8/3.

    Their squares sum to 3/8 and their cubes to 5/32. Weighted deviations are -0.75, -0.25 and 1: the squared
    error is 1.625 x 3/8 / (3/8 - 10/32 + 9/64) = 3, with 5/3 degrees of freedom.
    """
    design = Design(clusters=(1, 2, 3), cells=("a", "a", "b"))
    difference = over_runs([[1.0], [3.0], [6.0]], [[0.0]] * 3, design=design)
    half = float(stats.t.ppf(0.975, 5 / 3)) * float(np.sqrt(3))
    assert difference.value == pytest.approx(4.0)
    assert difference.interval == pytest.approx((4.0 - half, 4.0 + half))
    assert difference.p == pytest.approx(2 * stats.t.sf(4.0 / np.sqrt(3), 5 / 3))
    lost = over_runs([[1.0], [3.0], [np.nan]], [[0.0]] * 3, design=design)
    kept = over_runs([[1.0], [3.0]], [[0.0]] * 2, design=Design((1, 2), ("a", "a")))
    assert lost == replace(kept, n_nan=1)


@pytest.mark.slow
@pytest.mark.parametrize("apart", [0.0, 1.0])
@pytest.mark.parametrize("runs", [(1, 1, 1, 1, 1, 1, 1, 1, 6), (2, 1, 2, 1, 2, 3, 1, 2, 1), (1, 5), (1, 20)])
def test_a_mean_of_cells_is_covered_whatever_their_numbers_of_runs(
    runs: tuple[int, ...], apart: float
) -> None:
    """Also if cells differ, by steps of `apart` standard deviations."""
    cells = tuple(cell for cell, n in enumerate(runs) for _ in range(n))
    units = rng(9).normal(size=(20_000, len(cells))) + apart * np.array(cells)
    low, high = student_interval(units, design=Design(tuple(range(len(cells))), cells))
    truth = apart * np.mean(np.unique(cells))
    assert np.mean((low <= truth) & (high >= truth)) >= 0.93


@pytest.mark.slow
def test_pairs_that_share_a_start_are_covered_as_clusters_only() -> None:
    """Ten trainings, each with and without a term, whose policies differ less than trainings do."""
    generator = rng(8)
    shared = generator.normal(size=(20_000, 10, 1)) + 0.3 * generator.normal(size=(20_000, 10, 2))
    units, design = shared.reshape(-1, 20), Design(tuple(np.repeat(np.arange(10), 2).tolist()))
    low, high = student_interval(units, design=design)
    assert 0.94 <= np.mean((low <= 0.0) & (high >= 0.0)) <= 0.96
    low, high = student_interval(units)
    assert np.mean((low <= 0.0) & (high >= 0.0)) < 0.88


def test_a_bootstrap_of_three_runs_does_not_cover() -> None:
    """The reason for Student's intervals."""
    units = runs_of_a_cell(3, 1.0, n_cells=400)
    intervals = [percentile_interval(each, rng(), resamples=300) for each in units]
    assert np.mean([low <= 0.0 <= high for low, high in intervals]) < 0.87


def test_the_percentile_interval_equals_scipy_s_and_is_in_the_range() -> None:
    x = rng(4).normal(1, 1, 40)
    ours = percentile_interval(x, rng(), resamples=40_000)
    theirs = stats.bootstrap((x,), np.mean, method="percentile", n_resamples=40_000, rng=rng(6))
    assert ours == pytest.approx(tuple(theirs.confidence_interval), abs=0.01)
    nearly = np.array([1.0] * 49 + [0.0])
    assert percentile_interval(nearly, rng())[1] <= 1.0
    assert percentile_interval(np.full(4, 2.0), rng()) == (2.0, 2.0)
    assert percentile_interval(x, rng(1)) == percentile_interval(x, rng(1)) != percentile_interval(x, rng(2))


def test_arrays_of_different_lengths_are_refused() -> None:
    with pytest.raises(InputError, match="cannot be paired"):
        over_units([[1.0, 2.0]], [[1.0, 2.0, 3.0]])
    with pytest.raises(InputError, match="cannot be paired"):
        over_runs([[1.0]], [[1.0], [2.0]])


def test_percentiles_by_hand() -> None:
    assert percentiles(np.arange(101.0), 0.9) == pytest.approx((5.0, 95.0))


@given(
    arrays(np.float64, 12, elements=st.integers(-3, 3)), arrays(np.float64, 9, elements=st.integers(-3, 3))
)
def test_rank_biserial_equals_a_count_of_pairs(a: np.ndarray, b: np.ndarray) -> None:
    assert rank_biserial(a, b) == pytest.approx(float(np.sign(a[:, None] - b[None, :]).mean()))
    assert rank_biserial([*a, np.nan], b) == rank_biserial(a, b)
    assert rank_biserial([np.nan], b) is None


@given(arrays(np.float64, st.integers(1, 30), elements=st.floats(-5, 5)))
def test_the_interquartile_mean_equals_scipy_s(x: np.ndarray) -> None:
    assert interquartile_mean(x) == pytest.approx(float(stats.trim_mean(x, 0.25)))


def test_probability_of_improvement_by_hand() -> None:
    """3 of 4 pairs and a tie in one cell, none in the other: the mean of 0.875 and 0."""
    a, b = {"one": [2.0, 3.0], "other": [0.0]}, {"one": [1.0, 2.0], "other": [1.0]}
    assert probability_of_improvement(a, b) == pytest.approx((3.5 / 4 + 0.0) / 2)
    assert probability_of_improvement(b, a) == pytest.approx(1.0 - 0.4375)
    assert probability_of_improvement(a, a) == 0.5


def test_bonferroni_and_holm_by_hand() -> None:
    p = [0.01, 0.04, 0.03, 0.5]
    np.testing.assert_allclose(bonferroni(p), [0.04, 0.16, 0.12, 1.0])
    np.testing.assert_allclose(holm(p), [0.04, 0.09, 0.09, 0.5])  # 4p; 3p = 0.09; 2p = 0.08 raised to 0.09; p
    assert bonferroni([]).size == holm([]).size == 0


@given(P_VALUES)
def test_holm_is_between_p_and_bonferroni_and_keeps_the_order(p: np.ndarray) -> None:
    adjusted = holm(p)
    assert bool(((p <= adjusted) & (adjusted <= bonferroni(p))).all())
    assert bool((np.diff(adjusted[np.argsort(p, kind="stable")]) >= 0).all())
    assert adjusted[np.argmin(p)] == bonferroni(p)[np.argmin(p)]


def test_groups_are_compared_with_their_first_member() -> None:
    """A chain of small steps is not one group: later members are near each other but not near the first."""
    values = [1.0, 0.9, 0.5, 0.45, 0.0]
    assert groups_by_head(5, lambda head, k: values[head] - values[k] < 0.3) == [0, 0, 1, 1, 2]
    chain = [-0.2 * k for k in range(5)]
    assert groups_by_head(5, lambda head, k: chain[head] - chain[k] < 0.3) == [0, 0, 1, 1, 2]
    assert groups_by_head(0, lambda head, k: True) == []
