"""Performance profiles: the share of training runs that score above tau, for every tau.

The run-score distribution of Agarwal et al. (2021), "Deep Reinforcement Learning at the Edge of the
Statistical Precipice": a competitor whose curve is above another everywhere is better. Their band is a
stratified bootstrap, which has no width if a cell has a single run, or if all runs are on one side of tau.
Ours is the exact binomial interval of Clopper and Pearson (1934) at each tau: it has at least its nominal
coverage for any number of independent runs, and more for runs of several cells with different probabilities
(Hoeffding 1956). Runs that share the start of their training are not independent: of these it is too narrow.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from xmarl_bench.metrics.student import CONFIDENCE


@dataclass(frozen=True)
class Profile:
    """A falling step function of tau. U is the number of different scores."""

    taus: tuple[float, ...]  # (U,) the scores, rising: at each of them the share falls
    shares: tuple[float, ...]  # (U + 1,) of runs above tau: 1 below taus[0], then from each of taus on
    band: tuple[tuple[float, float], ...]  # (U + 1,) interval of each share


def performance_profile(scores: ArrayLike) -> Profile:
    """(G,) scores of training runs -> the share of them above tau. Skips scores that are not numbers."""
    x = np.asarray(scores, dtype=np.float64)
    x = x[~np.isnan(x)]
    taus, counts = np.unique(x, return_counts=True)
    above = x.size - np.concatenate([[0], np.cumsum(counts)])
    return Profile(
        taus=tuple(taus.tolist()),
        shares=tuple((above / max(1, x.size)).tolist()),
        band=tuple(share_interval(int(k), x.size) for k in above),
    )


def share_interval(successes: int, trials: int, confidence: float = CONFIDENCE) -> tuple[float, float]:
    """Clopper and Pearson's interval of the probability of a success; [0, 1] without trials."""
    from scipy.special import betaincinv  # imported lazily: reading entries does not need scipy

    tail = (1.0 - confidence) / 2
    low = 0.0 if successes == 0 else betaincinv(successes, trials - successes + 1, tail)
    high = 1.0 if successes == trials else betaincinv(successes + 1, trials - successes, 1.0 - tail)
    return float(low), float(high)
