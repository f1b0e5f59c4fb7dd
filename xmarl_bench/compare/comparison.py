"""Compares explainers on the same policies and states: differences, intervals, tests and tie groups.

Differences are paired. With several policies the units are their trainings, and cells weigh the same; with a
single policy its episodes. Intervals are Student's; the p-values of the paired t-test are corrected by Holm
for all pairs of the table (xmarl_bench.metrics.statistics). Interquartile mean, performance profile and
probability of improvement are those of Agarwal et al. (2021): the policies of a cell are its runs, all of the
same weight.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from xmarl_bench.compare.matching import Blocks, named
from xmarl_bench.errors import InputError, unknown
from xmarl_bench.metrics.performance_profile import Profile, performance_profile
from xmarl_bench.metrics.statistics import (
    Difference,
    groups_by_head,
    holm,
    interquartile_mean,
    over_units,
    probability_of_improvement,
)
from xmarl_bench.metrics.student import Design
from xmarl_bench.metrics.table import OF_EXPLAINERS, Direction, metrics_of

Floats = NDArray[np.float64]
BETTER = {
    metric.name: metric.direction
    for metric in metrics_of(*OF_EXPLAINERS)
    if metric.direction is not Direction.NONE
}


@dataclass(frozen=True)
class Standing:
    """One explainer in the order of a metric, best first."""

    explainer: str
    mean: Difference  # to 0: mean over cells of the mean over trainings of the mean over episodes
    iqm: float  # interquartile mean of the policies' means, or of the episodes of a single policy
    profile: Profile  # share of the same values above every score
    tie_group: int  # from 1; members do not differ significantly from the first of the group


@dataclass(frozen=True)
class Pair:
    """Two explainers, the first one better in the order."""

    first: str
    second: str
    difference: Difference  # first - second, paired
    # Probability that a run of the first is better than one of the second in its cell; None without numbers.
    improvement: float | None
    p_holm: float | None  # None for a single unit


@dataclass(frozen=True)
class Comparison:
    metric: str
    better: str  # "higher" or "lower"
    states: tuple[str, ...]  # policy and cell of each block
    trainings: int  # that are independent
    standings: tuple[Standing, ...]
    pairs: tuple[Pair, ...]  # every pair, by the order


def compare(blocks: Blocks, metric: str) -> Comparison:
    """Compare explainers by one metric of their episodes. Raises InputError if it was not measured."""
    if metric not in BETTER:
        raise unknown("metric", metric, BETTER)
    values = {explainer: _values(blocks, explainer, metric) for explainer in blocks}
    sign = -1.0 if BETTER[metric] is Direction.LOWER else 1.0
    zeros = [np.zeros_like(block) for block in next(iter(values.values()))]
    states = next(iter(blocks.values()))
    design = Design(
        clusters=tuple(block.training for block in states.values()),
        cells=tuple((block.cell.task, block.cell.n_agents) for block in states.values()),
    )
    means = {name: over_units(each, zeros, design=design) for name, each in values.items()}
    without = sorted(name for name, mean in means.items() if mean.value is None)
    if without:
        raise InputError(
            f"{metric} is not a number in any episode of {without[0]!r}: leave that explainer out, or choose "
            f"another metric."
        )
    order = sorted(values, key=lambda name: (-sign * (means[name].value or 0.0), name))
    pairs = list(combinations(order, 2))
    differences = {(a, b): over_units(values[a], values[b], design=design) for a, b in pairs}
    groups = groups_by_head(len(order), lambda head, k: differences[order[head], order[k]].holds_zero)
    p = [each.p for each in differences.values() if each.p is not None]
    corrected = iter(holm(p).tolist())
    runs = {name: _runs(blocks, name, each, sign) for name, each in values.items()}
    return Comparison(
        metric=metric,
        better=BETTER[metric].value,
        states=tuple(states),
        trainings=len(set(design.clusters)),
        standings=tuple(
            Standing(name, means[name], interquartile_mean(scores), performance_profile(scores), group + 1)
            for name, group in zip(order, groups, strict=True)
            for scores in [_scores(values[name])]
        ),
        pairs=tuple(
            Pair(
                a,
                b,
                difference,
                probability_of_improvement(runs[a], runs[b]),
                None if difference.p is None else next(corrected),
            )
            for (a, b), difference in differences.items()
        ),
    )


def _scores(values: Sequence[Floats]) -> Floats:
    """Means of the policies, or the episodes of a single policy."""
    return values[0] if len(values) == 1 else np.array([_mean(each) for each in values])


def _mean(values: Floats) -> float:
    """NaN without a number."""
    return float(np.nanmean(values)) if (~np.isnan(values)).any() else math.nan


def _runs(blocks: Blocks, explainer: str, values: Sequence[Floats], sign: float) -> dict[str, list[float]]:
    """Cell -> means of its policies, or the episodes of a single policy. Higher is better."""
    runs: dict[str, list[float]] = {}
    for (cell, _), each in zip(blocks[explainer].values(), values, strict=True):
        mean = sign * (each if len(values) == 1 else np.array([_mean(each)]))
        runs.setdefault(f"{cell.task}, {cell.n_agents} agents", []).extend(mean[~np.isnan(mean)].tolist())
    return runs


def _values(blocks: Blocks, explainer: str, metric: str) -> list[Floats]:
    """The metric's values for each policy and cell; NaN if an episode has no number."""
    found = []
    for states, (cell, _) in blocks[explainer].items():
        if metric in cell.not_measured:
            raise InputError(
                f"{metric} was not measured for {named(explainer, states)} ({cell.not_measured[metric]}): "
                f"choose another metric, or leave that entry out."
            )
        found.append(np.array([getattr(row, metric) for row in cell.episodes], dtype=np.float64))
    return found
