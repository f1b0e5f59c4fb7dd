"""Intervals and tests: by hand, by scipy, and by how often they are right."""

from __future__ import annotations

from itertools import product

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
    hierarchical_bootstrap,
    holm,
    mann_whitney,
    paired_bootstrap,
    percentiles,
    resampled_means,
    tie_groups,
)

P_VALUES = arrays(np.float64, st.integers(1, 12), elements=st.floats(0, 1))


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def test_a_constant_difference_has_an_interval_of_no_width() -> None:
    a = np.array([0.5, 1.5, 2.5])
    assert paired_bootstrap(a, a - 0.25, rng()) == Difference(0.25, (0.25, 0.25), 3, 0)


def test_pairs_matter_not_the_spread_of_the_episodes() -> None:
    episodes = rng(1).normal(0, 10, 50)
    a, b = episodes + rng(2).normal(0.2, 0.1, 50), episodes
    assert not paired_bootstrap(a, b, rng()).holds_zero
    assert paired_bootstrap(a, rng(3).permutation(b), rng()).holds_zero


def test_what_is_not_a_number_is_left_out_of_its_pair_and_counted() -> None:
    difference = paired_bootstrap([1.0, np.nan, 3.0, 5.0], [0.0, 1.0, np.nan, 4.0], rng())
    assert (difference.value, difference.n, difference.n_nan) == (1.0, 2, 2)
    assert paired_bootstrap([np.nan], [1.0], rng()) == Difference(None, None, 0, 1)
    one = paired_bootstrap([2.0, np.nan], [1.0, 1.0], rng())
    assert one == Difference(1.0, None, 1, 1)
    assert one.holds_zero  # one episode proves nothing


def test_the_interval_is_scipys() -> None:
    a, b = rng(4).normal(1, 1, 40), rng(5).normal(0.7, 1, 40)
    ours = paired_bootstrap(a, b, rng(), resamples=40_000).interval
    theirs = stats.bootstrap(
        (a - b,), np.mean, method="percentile", n_resamples=40_000, rng=rng(6)
    ).confidence_interval
    assert ours is not None
    np.testing.assert_allclose(ours, theirs, atol=0.01)


def test_all_resamples_of_two_pairs_are_enumerated() -> None:
    """Of 2 values, resampled means are 0, 1/2, 1 with odds 1 : 2 : 1."""
    means = resampled_means([np.array([0.0, 1.0])], rng(), 40_000)
    values, counts = np.unique(means, return_counts=True)
    assert values.tolist() == [0.0, 0.5, 1.0]
    np.testing.assert_allclose(counts / 40_000, [0.25, 0.5, 0.25], atol=0.01)


def test_policies_are_drawn_before_their_episodes() -> None:
    """Two policies of constant values: a resample's mean is 0, 1/2 or 1, whatever the number of episodes."""
    means = resampled_means([np.zeros(3), np.ones(50)], rng(), 40_000)
    values, counts = np.unique(means, return_counts=True)
    assert values.tolist() == [0.0, 0.5, 1.0]
    np.testing.assert_allclose(counts / 40_000, [0.25, 0.5, 0.25], atol=0.01)


def test_two_policies_of_two_episodes_by_enumeration() -> None:
    blocks = [np.array([0.0, 1.0]), np.array([4.0, 8.0])]
    exact = [
        (blocks[g][i] + blocks[g][j] + blocks[h][k] + blocks[h][m]) / 4
        for g, h, i, j, k, m in product(range(2), repeat=6)
    ]
    means = resampled_means(blocks, rng(), 60_000)
    assert set(means) == set(exact)
    assert np.mean(means) == pytest.approx(np.mean(exact), abs=0.03)
    assert np.std(means) == pytest.approx(np.std(exact), abs=0.03)


def test_each_policy_counts_the_same_however_many_episodes_it_has() -> None:
    a = [np.full(2, 1.0), np.full(98, 0.0)]
    assert hierarchical_bootstrap(a, [np.zeros(2), np.zeros(98)], rng()).value == 0.5


def test_more_policies_widen_what_their_differences_say_of_others() -> None:
    """Many episodes of few policies that disagree: pooled episodes would be far too sure."""
    policies = [rng(k).normal(mean, 0.1, 100) for k, mean in enumerate((-1.0, 0.0, 2.0, 1.0))]
    zeros = [np.zeros(100)] * 4
    by_policy = hierarchical_bootstrap(policies, zeros, rng()).interval
    pooled = paired_bootstrap(np.concatenate(policies), np.concatenate(zeros), rng()).interval
    assert by_policy is not None
    assert pooled is not None
    assert by_policy[1] - by_policy[0] > 5 * (pooled[1] - pooled[0])


def test_the_interval_holds_the_truth_as_often_as_it_says() -> None:
    held = 0
    for seed in range(300):
        draw = rng(7000 + seed)
        a, b = draw.normal(0.3, 1, 50), draw.normal(0, 1, 50)
        interval = paired_bootstrap(a, b, draw, resamples=500).interval
        assert interval is not None
        held += interval[0] <= 0.3 <= interval[1]
    assert 0.90 <= held / 300 <= 0.98


def test_the_same_generator_gives_the_same_interval() -> None:
    a, b = rng(1).normal(size=30), rng(2).normal(size=30)
    assert paired_bootstrap(a, b, rng(3)) == paired_bootstrap(a, b, rng(3))
    assert paired_bootstrap(a, b, rng(3)) != paired_bootstrap(a, b, rng(4))


def test_what_are_no_pairs_is_refused() -> None:
    with pytest.raises(InputError, match=r"shapes \(2,\) and \(3,\)"):
        paired_bootstrap([1.0, 2.0], [1.0, 2.0, 3.0], rng())
    with pytest.raises(InputError, match="of 1 and of 2 policies"):
        hierarchical_bootstrap([[1.0]], [[1.0], [2.0]], rng())


def test_percentiles_by_hand() -> None:
    assert percentiles(np.arange(101.0), 0.9) == pytest.approx((5.0, 95.0))


def test_mann_whitney_by_hand() -> None:
    """Three above three: U = 9, and 2 of the 20 orders are as extreme."""
    result = mann_whitney([4.0, 5.0, 6.0], [1.0, 2.0, 3.0])
    assert result is not None
    assert (result.u, result.effect) == (9.0, 1.0)
    assert result.p == pytest.approx(0.1)
    swapped = mann_whitney([1.0, 2.0, 3.0], [4.0, 5.0, 6.0])
    assert swapped is not None
    assert (swapped.u, swapped.effect, swapped.p) == (0.0, -1.0, result.p)
    tied = mann_whitney([1.0, 2.0], [2.0, 3.0])
    assert tied is not None
    assert tied.u == 0.5


@given(
    arrays(np.float64, 12, elements=st.integers(-3, 3)), arrays(np.float64, 9, elements=st.integers(-3, 3))
)
def test_u_counts_pairs_and_p_is_scipys(a: np.ndarray, b: np.ndarray) -> None:
    result = mann_whitney(a, b)
    assert result is not None
    pairs = np.sign(a[:, None] - b[None, :])
    assert result.u == pytest.approx(float((pairs > 0).sum() + (pairs == 0).sum() / 2))
    assert result.effect == pytest.approx(float(pairs.mean()))
    if len({*a, *b}) > 1:
        assert result.p == pytest.approx(stats.mannwhitneyu(a, b).pvalue)


def test_mann_whitney_at_its_limits() -> None:
    same = mann_whitney([2.0, 2.0], [2.0, 2.0, 2.0])
    assert same is not None
    assert (same.p, same.effect) == (1.0, 0.0)
    assert mann_whitney([np.nan], [1.0]) is None
    assert mann_whitney([1.0, np.nan, 3.0], [2.0]) == mann_whitney([1.0, 3.0], [2.0])


def test_bonferroni_and_holm_by_hand() -> None:
    p = [0.01, 0.04, 0.03, 0.5]
    np.testing.assert_allclose(bonferroni(p), [0.04, 0.16, 0.12, 1.0])
    np.testing.assert_allclose(holm(p), [0.04, 0.09, 0.09, 0.5])  # 4p; 3p = 0.09; 2p = 0.08 raised to 0.09; p
    assert bonferroni([]).size == holm([]).size == 0


@given(P_VALUES)
def test_holm_lies_between_p_and_bonferroni_and_keeps_the_order(p: np.ndarray) -> None:
    adjusted = holm(p)
    assert bool(((p <= adjusted) & (adjusted <= bonferroni(p))).all())
    assert bool((np.diff(adjusted[np.argsort(p, kind="stable")]) >= 0).all())
    assert adjusted[np.argmin(p)] == bonferroni(p)[np.argmin(p)]


def test_tie_groups_are_told_by_the_difference_to_their_head() -> None:
    noise = [rng(k).normal(0, 0.1, 60) for k in range(5)]
    means = [1.0, 0.999, 0.5, 0.5, 0.0]
    entries = [[mean + each] for mean, each in zip(means, noise, strict=True)]
    assert tie_groups(entries, rng()) == [0, 0, 1, 1, 2]


def test_a_chain_of_small_steps_is_not_one_group() -> None:
    """Each entry is near the one before it, but no longer near the head."""
    entries = [[rng(k).normal(-0.03 * k, 0.1, 60)] for k in range(8)]
    groups = tie_groups(entries, rng())
    assert groups[0] == 0
    assert groups[-1] > 0
    assert sorted(groups) == groups


def test_tie_groups_at_their_limits() -> None:
    assert tie_groups([], rng()) == []
    assert tie_groups([[[1.0]], [[0.0]]], rng()) == [0, 0]  # one episode tells nothing apart
    assert tie_groups([[[1.0, 1.0]], [[0.0, 0.0]]], rng()) == [0, 1]
