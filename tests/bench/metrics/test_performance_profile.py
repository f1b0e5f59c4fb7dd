"""Performance profiles: by hand, by their definition over several tasks, and the coverage of bands."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from xmarl_bench.metrics.performance_profile import Profile, performance_profile, share_interval
from xmarl_bench.metrics.statistics import interquartile_mean, probability_of_improvement

TASKS = st.lists(st.lists(st.integers(-3, 3), min_size=3, max_size=3), min_size=1, max_size=4)


def share_above(profile: Profile, tau: float) -> float:
    return profile.shares[int(np.searchsorted(profile.taus, tau, side="right"))]


def test_a_profile_by_hand() -> None:
    profile = performance_profile([0.5, 0.2, math.nan, 0.5, 0.9])
    assert profile.taus == (0.2, 0.5, 0.9)
    assert profile.shares == (1.0, 0.75, 0.25, 0.0)
    assert [share_above(profile, tau) for tau in (0.1, 0.2, 0.3, 0.5, 0.89, 0.9, 2.0)] == [
        1.0, 0.75, 0.75, 0.25, 0.25, 0.0, 0.0,
    ]  # fmt: skip
    assert performance_profile([]) == Profile((), (0.0,), ((0.0, 1.0),))


def test_profiles_equal_those_of_rliable() -> None:
    """Results of rliable 1.2.0 on these matrices of four runs of three tasks.

    Its dependencies (arch with pandas 3) do not import together, so the tests cannot depend on it.
    """
    one = [[0.13, -0.13, 0.64], [0.10, -0.54, 0.36], [1.30, 0.95, -0.70], [-1.27, -0.62, 0.04]]
    other = [[-2.33, -0.22, -1.25], [-0.73, -0.54, -0.32], [0.41, 1.04, -0.13], [1.37, -0.67, 0.35]]
    profile = performance_profile(np.ravel(one))
    shares = [share_above(profile, tau) for tau in np.linspace(-2.0, 2.0, 9)]
    assert shares == pytest.approx(np.array([12, 12, 11, 8, 7, 3, 1, 0, 0]) / 12)
    assert interquartile_mean(np.ravel(one)) == pytest.approx(-0.04 / 6)
    cells = [{str(k): list(runs) for k, runs in enumerate(np.transpose(each))} for each in (one, other)]
    assert probability_of_improvement(cells[0], cells[1]) == 0.59375


@given(TASKS, st.floats(-4, 4))
def test_a_profile_is_the_mean_over_tasks_of_the_share_of_runs_above_tau(
    scores: list[list[int]], tau: float
) -> None:
    """The paper's definition, for tasks with equally many runs."""
    matrix = np.array(scores, dtype=np.float64)  # (tasks, runs)
    expected = np.mean([np.mean(task > tau) for task in matrix])
    assert share_above(performance_profile(matrix.ravel()), tau) == pytest.approx(expected)


@pytest.mark.parametrize(("successes", "trials"), [(0, 1), (1, 1), (2, 3), (3, 3), (4, 9), (0, 9)])
def test_the_band_equals_scipy_s_exact_interval(successes: int, trials: int) -> None:
    theirs = stats.binomtest(successes, trials).proportion_ci(0.95, method="exact")
    assert share_interval(successes, trials) == pytest.approx((theirs.low, theirs.high))


def chances(each: Sequence[float]) -> np.ndarray:
    """(G + 1,): the probability that k of the runs are above tau, given each run's probability."""
    total = np.ones(1)
    for p in each:
        total = np.convolve(total, [1.0 - p, p])
    return total


@pytest.mark.parametrize("runs", [1, 3, 5, 9])
def test_bands_have_their_nominal_coverage(runs: int) -> None:
    """Computed over all outcomes without simulation, for equal runs and for runs of different cells."""
    bands = np.array([share_interval(k, runs) for k in range(runs + 1)])
    rng = np.random.default_rng(runs)
    alike = [np.full(runs, p) for p in np.linspace(0.0, 1.0, 101)]
    unlike = [rng.beta(0.5, 0.5, runs) for _ in range(200)]
    for each in (*alike, *unlike):
        held = (bands[:, 0] <= each.mean() + 1e-12) & (bands[:, 1] >= each.mean() - 1e-12)
        assert chances(each.tolist())[held].sum() >= 0.95


def test_a_bootstrap_of_few_runs_does_not_cover() -> None:
    """If three runs are all above tau, their bootstrap interval has no width."""
    assert share_interval(3, 3)[0] == pytest.approx(0.292, abs=1e-3)
    missed = sum(chances([0.8] * 3)[[0, 3]])  # resampling 0 of 3 or 3 of 3 changes nothing
    assert missed > 0.5
