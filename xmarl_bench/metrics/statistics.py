"""Is one list of episodes better than another? Pure functions of arrays, with the generator passed in.

The episode is the unit throughout: timesteps of an episode are autocorrelated. Where several policies (or
training seeds) were measured, they are drawn first and their episodes within them, for what one policy shows
on many episodes is still one policy. Values that are not a number are left out and counted, never filled in.

Sources: Efron and Tibshirani, "An Introduction to the Bootstrap" (1993), percentile interval; Davison and
Hinkley (1997), section 3.8, hierarchical data; Kerby (2014), rank-biserial correlation; Holm (1979).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from xmarl_bench.errors import InputError

Floats = NDArray[np.float64]
RESAMPLES = 5000
CONFIDENCE = 0.95
CHUNK = 1_000_000  # numbers drawn at once: bounds memory; every array of 200 episodes or fewer is one chunk


@dataclass(frozen=True)
class Difference:
    """Mean of a - b over pairs, with its percentile bootstrap interval."""

    value: float | None  # None where no pair is left
    interval: tuple[float, float] | None  # None for fewer than two pairs
    n: int  # pairs
    n_nan: int  # pairs left out, for one of the two is not a number

    @property
    def holds_zero(self) -> bool:
        """Whether nothing speaks for a difference: 0 is in the interval, or there is no interval."""
        return self.interval is None or self.interval[0] <= 0.0 <= self.interval[1]


@dataclass(frozen=True)
class MannWhitney:
    """Two-sided Mann-Whitney U test, unpaired."""

    u: float  # pairs (x of a, y of b) with x > y; ties count half
    p: float  # in [0, 1]
    effect: (
        float  # rank-biserial correlation 2 U / (n_a n_b) - 1, in [-1, 1]: 1 where every a is above every b
    )


def paired_bootstrap(
    a: ArrayLike,
    b: ArrayLike,
    rng: np.random.Generator,
    *,
    resamples: int = RESAMPLES,
    confidence: float = CONFIDENCE,
) -> Difference:
    """Mean of a - b over the episodes (E,) that both have, in the same order."""
    return hierarchical_bootstrap([a], [b], rng, resamples=resamples, confidence=confidence)


def hierarchical_bootstrap(
    a: Sequence[ArrayLike],
    b: Sequence[ArrayLike],
    rng: np.random.Generator,
    *,
    resamples: int = RESAMPLES,
    confidence: float = CONFIDENCE,
) -> Difference:
    """Mean over policies of the mean of a - b over their episodes: one array (E_g,) per policy.

    Each resample draws policies with replacement, then as many episodes of each drawn one as it has. With
    one policy it is the plain paired bootstrap; with fewer than about five the interval is too narrow, as any
    percentile bootstrap of so few. A policy without a complete pair is left out. Raises InputError where
    arrays are no pairs.
    """
    pairs = [_difference(x, y) for x, y in _zip(a, b)]
    blocks = [x[~np.isnan(x)] for x in pairs]
    n, n_nan = sum(x.size for x in blocks), sum(int(np.isnan(x).sum()) for x in pairs)
    blocks = [x for x in blocks if x.size]
    if not blocks:
        return Difference(None, None, 0, n_nan)
    value = float(np.mean([x.mean() for x in blocks]))
    if n < 2:
        return Difference(value, None, n, n_nan)
    return Difference(value, percentiles(resampled_means(blocks, rng, resamples), confidence), n, n_nan)


def resampled_means(blocks: Sequence[Floats], rng: np.random.Generator, resamples: int = RESAMPLES) -> Floats:
    """(resamples,) means of means: blocks drawn with replacement, then entries (E_g,) of each drawn one."""
    total = np.zeros(resamples)
    for _ in blocks:
        drawn = rng.integers(len(blocks), size=resamples) if len(blocks) > 1 else np.zeros(resamples, int)
        for g, block in enumerate(blocks):
            chosen = np.flatnonzero(drawn == g)
            step = max(1, CHUNK // block.size)
            for first in range(0, chosen.size, step):
                some = chosen[first : first + step]
                total[some] += block[rng.integers(block.size, size=(some.size, block.size))].mean(axis=1)
    return total / len(blocks)


def percentiles(samples: Floats, confidence: float = CONFIDENCE) -> tuple[float, float]:
    """The central interval that holds that share of the samples."""
    tail = (1.0 - confidence) / 2
    low, high = np.quantile(samples, [tail, 1.0 - tail])
    return float(low), float(high)


def mann_whitney(a: ArrayLike, b: ArrayLike) -> MannWhitney | None:
    """Test of two lists of values that need not be pairs; None where one holds no number.

    Exact for up to 8 values in one of them without ties, else by the normal approximation with ties and
    continuity corrected (scipy.stats.mannwhitneyu). Values that are all the same differ with p = 1.
    """
    x, y = _numbers(a), _numbers(b)
    if not x.size or not y.size:
        return None
    if np.ptp(np.concatenate([x, y])) == 0.0:  # the approximation divides by their spread
        return MannWhitney(x.size * y.size / 2, 1.0, 0.0)
    from scipy.stats import mannwhitneyu  # here, for whoever only resamples need not wait for scipy

    result = mannwhitneyu(x, y, alternative="two-sided")
    u = float(result.statistic)
    return MannWhitney(u, float(result.pvalue), 2 * u / (x.size * y.size) - 1)


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


def tie_groups(
    ordered: Sequence[Sequence[ArrayLike]],
    rng: np.random.Generator,
    *,
    resamples: int = RESAMPLES,
    confidence: float = CONFIDENCE,
) -> list[int]:
    """The group, from 0, of each entry of a list that is sorted best first.

    ordered: for each entry its values, one array of episodes per policy, paired with those of the others.
    The first entry heads group 0. An entry stays in the group while the bootstrap interval of its difference
    to the group's head holds 0, and heads the next group otherwise: what shares a group with its head cannot
    be told from it on these episodes.
    """

    def tied(head: int, k: int) -> bool:
        difference = hierarchical_bootstrap(
            ordered[head], ordered[k], rng, resamples=resamples, confidence=confidence
        )
        return difference.holds_zero

    return groups_by_head(len(ordered), tied)


def groups_by_head(n: int, tied: Callable[[int, int], bool]) -> list[int]:
    """The group, from 0, of each of n in order: the first heads group 0, and one that is not `tied` to the
    head of the group before it heads the next. Every one but the first is asked about once, in order."""
    groups, head = [0] * min(n, 1), 0
    for k in range(1, n):
        if tied(head, k):
            groups.append(groups[-1])
        else:
            groups.append(groups[-1] + 1)
            head = k
    return groups


def _zip(a: Sequence[ArrayLike], b: Sequence[ArrayLike]) -> zip[tuple[ArrayLike, ArrayLike]]:
    if len(a) != len(b):
        raise InputError(f"values of {len(a)} and of {len(b)} policies are no pairs: give the same policies.")
    return zip(a, b, strict=True)


def _difference(a: ArrayLike, b: ArrayLike) -> Floats:
    x, y = np.asarray(a, dtype=np.float64), np.asarray(b, dtype=np.float64)
    if x.shape != y.shape or x.ndim != 1:
        raise InputError(f"values of shapes {x.shape} and {y.shape} are no pairs: give the same episodes.")
    return x - y


def _numbers(values: ArrayLike) -> Floats:
    x = np.asarray(values, dtype=np.float64)
    return x[~np.isnan(x)]
