"""Compares lists of values, with intervals and p-values. Pure functions of arrays.

A statement about one policy has episodes as units, because the timesteps of an episode are autocorrelated. A
statement about a cell or an architecture has training runs as units: many episodes of one policy are still
one policy. Intervals are Student's over units: with three runs, a 95 % percentile bootstrap covers only 72 to
86 %, and pooled episodes of different runs are not a sample of one population. How runs that share a start,
and runs of several cells, are counted: xmarl_bench.metrics.student. Values that are not a number are skipped
and counted, never filled in.

Sources: Welch (1947), independent samples; Efron and Tibshirani, "An Introduction to the Bootstrap" (1993),
percentile interval of an entry's means; Holm (1979); Agarwal et al. (2021), "Deep Reinforcement Learning at
the Edge of the Statistical Precipice", interquartile mean and probability of improvement; Kerby (2014),
rank-biserial correlation.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from xmarl_bench.errors import InputError
from xmarl_bench.metrics.student import (
    CONFIDENCE,
    Design,
    interval_of,
    is_zero,
    mean_of,
    n_independent,
    standard_error,
    student_p,
)

Floats = NDArray[np.float64]
RESAMPLES = 5000
CHUNK = 1_000_000  # numbers drawn at once: bounds memory; every array of 200 episodes or fewer is one chunk


@dataclass(frozen=True)
class Difference:
    """Mean of a - b over pairs, with Student's interval over units."""

    value: float | None  # None if no pair is left
    interval: tuple[float, float] | None  # None for fewer than two units, or for few that are all equal
    p: float | None  # of the paired t-test, two-sided; None without an interval
    units: int  # independent ones: clusters of training runs, or the episodes of a single run
    n: int  # pairs of episodes
    n_nan: int  # pairs skipped because one of the two is not a number

    @property
    def holds_zero(self) -> bool:
        """Whether the data show no difference: 0 is in the interval, or there is no interval."""
        return self.interval is None or self.interval[0] <= 0.0 <= self.interval[1]

    def __str__(self) -> str:
        """Such as `+0.16 [+0.10, +0.22]`: the value with its interval, if there is one."""
        if self.value is None:
            return "undefined"
        known = "" if self.interval is None else f" [{self.interval[0]:+.2f}, {self.interval[1]:+.2f}]"
        return f"{self.value:+.2f}{known}"


def over_runs(
    a: Sequence[ArrayLike],
    b: Sequence[ArrayLike],
    *,
    design: Design | None = None,
    confidence: float = CONFIDENCE,
) -> Difference:
    """Mean over runs of the mean of a - b over their episodes: one array (E_g,) per run; the run is the unit.

    design: of the runs. Skips runs without a complete pair. Raises InputError if the arrays are not pairs.
    """
    pairs, n_nan = _pairs(a, b)
    if design is not None and len(design.clusters) != len(pairs):
        raise InputError(
            f"got a design of {len(design.clusters)} for {len(pairs)} runs: give that of the runs."
        )
    kept = [k for k, run in enumerate(pairs) if run.size]
    means = np.array([pairs[k].mean() for k in kept])
    design = None if design is None else design.of(kept)
    return _difference(means, sum(run.size for run in pairs), n_nan, confidence, design)


def over_units(a: Sequence[ArrayLike], b: Sequence[ArrayLike], *, design: Design | None = None) -> Difference:
    """As `over_runs`; a single run gives a statement about this run alone, with its episodes as units."""
    if len(a) != 1:
        return over_runs(a, b, design=design)
    (episodes,), n_nan = _pairs(a, b)
    return _difference(episodes, episodes.size, n_nan)


def over_samples(a: ArrayLike, b: ArrayLike, *, confidence: float = CONFIDENCE) -> Difference:
    """Mean of a less mean of b, of independent samples of units: Student's interval with Welch's degrees of
    freedom.

    Samples without any spread have the p of the permutation test, and an interval only if that decides.
    """
    from scipy.special import stdtr, stdtrit

    x, y = _numbers(a), _numbers(b)
    n, n_nan = x.size + y.size, np.size(a) + np.size(b) - x.size - y.size
    if not x.size or not y.size:
        return Difference(None, None, None, 0, n, n_nan)
    value = float(x.mean() - y.mean())
    if min(x.size, y.size) < 2:
        return Difference(value, None, None, n, n, n_nan)
    squares = [float(standard_error(each)) ** 2 for each in (x, y)]
    error = math.sqrt(sum(squares))
    if is_zero(np.append(x - x[0], y - y[0]), abs(value)):
        if is_zero(x[:1] - y[:1]):
            return Difference(value, (value, value), 1.0, n, n, n_nan)
        p = 2.0 / math.comb(n, x.size)  # all of one sample are above all of the other
        if p >= 1.0 - confidence:
            return Difference(value, None, None, n, n, n_nan)
        return Difference(value, (value, value), p, n, n, n_nan)
    freedom = sum(squares) ** 2 / sum(
        each**2 / (size - 1) for each, size in zip(squares, (x.size, y.size), strict=True)
    )
    half = float(stdtrit(freedom, 0.5 + confidence / 2)) * error
    p = 2.0 * float(stdtr(freedom, -abs(value) / error))
    return Difference(value, (value - half, value + half), p, n, n, n_nan)


def percentile_interval(
    x: Floats, rng: np.random.Generator, *, resamples: int = RESAMPLES, confidence: float = CONFIDENCE
) -> tuple[float, float]:
    """(E,) -> percentile bootstrap interval of the mean. It stays within the range of the values."""
    means = np.empty(resamples)
    step = max(1, CHUNK // x.size)
    for first in range(0, resamples, step):
        n = min(step, resamples - first)
        means[first : first + n] = x[rng.integers(x.size, size=(n, x.size))].mean(axis=1)
    return percentiles(means, confidence)


def percentiles(samples: Floats, confidence: float = CONFIDENCE) -> tuple[float, float]:
    """The central interval that holds a share `confidence` of the samples."""
    tail = (1.0 - confidence) / 2
    low, high = np.quantile(samples, [tail, 1.0 - tail])
    return float(low), float(high)


def bonferroni(p: ArrayLike) -> Floats:
    """(m,) p-values of one family -> min(1, m p)."""
    x = np.asarray(p, dtype=np.float64)
    return np.minimum(1.0, x * x.size)


def holm(p: ArrayLike) -> Floats:
    """(m,) p-values of one family -> Holm's step-down adjustment: never above Bonferroni's.

    The k-th smallest (from 0) becomes min(1, (m - k) p), but no less than the one before it.
    """
    x = np.asarray(p, dtype=np.float64)
    order = np.argsort(x, kind="stable")
    adjusted = np.empty_like(x)
    adjusted[order] = np.minimum(1.0, np.maximum.accumulate((x.size - np.arange(x.size)) * x[order]))
    return adjusted


def rank_biserial(a: ArrayLike, b: ArrayLike) -> float | None:
    """Share of pairs (x of a, y of b) with x > y, less that with x < y: in [-1, 1]. None without numbers."""
    x, y = _numbers(a), _numbers(b)
    if not x.size or not y.size:
        return None
    ordered = np.sort(y)
    below = np.searchsorted(ordered, x, side="left").sum()
    above = y.size * x.size - np.searchsorted(ordered, x, side="right").sum()
    return float(below - above) / (x.size * y.size)


def interquartile_mean(x: ArrayLike) -> float:
    """Mean of the middle half of the values: cuts off a quarter of them, rounded down, at each end."""
    ordered = np.sort(_numbers(x))
    cut = ordered.size // 4
    return float(ordered[cut : ordered.size - cut].mean()) if ordered.size else math.nan


def probability_of_improvement(
    a: Mapping[str, Sequence[float]], b: Mapping[str, Sequence[float]]
) -> float | None:
    """Cell -> scores of its runs, for two competitors: P(a run of a beats a run of b), ties count half.

    Mean over cells of all pairs of runs within a cell; None if no cell has runs of both.
    """
    both = [(runs, b[cell]) for cell, runs in a.items() if runs and b[cell]]
    shares = [np.mean([(x > y) + 0.5 * (x == y) for x in ours for y in theirs]) for ours, theirs in both]
    return float(np.mean(shares)) if shares else None


def groups_by_head(n: int, tied: Callable[[int, int], bool]) -> list[int]:
    """Groups n ordered items: returns the number of each item's group, from 0.

    The first item heads group 0. An item that is not `tied` to the head of the current group heads the next
    one. `tied` is called once for every item but the first, in order.
    """
    groups, head = [0] * min(n, 1), 0
    for k in range(1, n):
        if tied(head, k):
            groups.append(groups[-1])
        else:
            groups.append(groups[-1] + 1)
            head = k
    return groups


def _difference(
    units: Floats, n: int, n_nan: int, confidence: float = CONFIDENCE, design: Design | None = None
) -> Difference:
    if not units.size:
        return Difference(None, None, None, 0, n, n_nan)
    value, independent = float(mean_of(units, design)), n_independent(units, design)
    interval = interval_of(units, confidence, design=design)
    p = None if interval is None else float(student_p(units, design=design))
    return Difference(value, interval, p, independent, n, n_nan)


def _pairs(a: Sequence[ArrayLike], b: Sequence[ArrayLike]) -> tuple[list[Floats], int]:
    """a - b of each run where both are numbers, maybe nowhere, and the number of other pairs."""
    if len(a) != len(b):
        raise InputError(
            f"{len(a)} policies cannot be paired with {len(b)}: give values of the same policies."
        )
    runs, n_nan = [], 0
    for one, other in zip(a, b, strict=True):
        x, y = np.asarray(one, dtype=np.float64), np.asarray(other, dtype=np.float64)
        if x.shape != y.shape or x.ndim != 1:
            raise InputError(
                f"values of shapes {x.shape} and {y.shape} cannot be paired: give the same episodes."
            )
        difference = (x - y)[~np.isnan(x - y)]
        n_nan += x.size - difference.size
        runs.append(difference)
    return runs, n_nan


def _numbers(values: ArrayLike) -> Floats:
    x = np.asarray(values, dtype=np.float64)
    return x[~np.isnan(x)]
