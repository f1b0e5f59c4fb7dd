"""Mean and interval of a metric over episodes: the episode is the unit, for timesteps are autocorrelated."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from xmarl_bench.entry import Summary

RESAMPLES = 5000
CONFIDENCE = 0.95


def summarise(values: Sequence[float | None], rng: np.random.Generator) -> Summary:
    """One value per episode, None where it is not a number, to mean and percentile bootstrap interval.

    What is not a number is left out of the mean and counted in `n_nan`, never turned into 0. The interval
    is None for fewer than two episodes; constant values give an interval of width 0.
    """
    x = np.array([value for value in values if value is not None], dtype=np.float64)
    n_nan = len(values) - x.size
    if x.size == 0:
        return Summary(value=None, interval=None, n=0, n_nan=n_nan)
    interval = None
    if x.size > 1:
        means = x[rng.integers(x.size, size=(RESAMPLES, x.size))].mean(axis=1)
        tail = (1.0 - CONFIDENCE) / 2
        low, high = np.quantile(means, [tail, 1.0 - tail])
        interval = (float(low), float(high))
    return Summary(value=float(x.mean()), interval=interval, n=int(x.size), n_nan=n_nan)
