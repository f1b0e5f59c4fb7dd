"""Compares explainers on the same policies and states: by how much, how surely, and who cannot be told apart.

Differences are paired by episode, with bootstrap intervals that draw policies first where there are several
(xmarl_bench.metrics.statistics). Beside them stands the paper's test, Mann-Whitney U, which pools the
episodes of all policies and pairs nothing; its p-values are corrected for all pairs of the table, by
Bonferroni as in the paper and by Holm. "Paper" is Kailas, Jain and Ravichandar (ICML 2025).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xmarl_bench.compare.matching import Blocks, named
from xmarl_bench.errors import InputError
from xmarl_bench.metrics.statistics import (
    Difference,
    MannWhitney,
    bonferroni,
    hierarchical_bootstrap,
    holm,
    mann_whitney,
    tie_groups,
)
from xmarl_bench.metrics.table import OF_EXPLAINERS, Direction, metrics_of
from xmarl_bench.reproducible import derived_seed

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
    mean: Difference  # to 0: the mean over policies of the mean over episodes
    tie_group: int  # from 1; see xmarl_bench.metrics.statistics.tie_groups


@dataclass(frozen=True)
class Pair:
    """Two explainers, the first one better in the order."""

    first: str
    second: str
    difference: Difference  # first - second, paired
    test: MannWhitney | None  # of their episodes, unpaired; None where one has no number
    p_bonferroni: float | None
    p_holm: float | None


@dataclass(frozen=True)
class Comparison:
    metric: str
    better: str  # "higher" or "lower"
    states: tuple[str, ...]  # policy and cell of each block
    standings: tuple[Standing, ...]
    pairs: tuple[Pair, ...]  # every pair, by the order


def compare(blocks: Blocks, metric: str) -> Comparison:
    """Compare explainers by one metric of their episodes. Raises InputError where it was not measured."""
    if metric not in BETTER:
        raise InputError(f"{metric!r} compares nothing: choose one of {', '.join(BETTER)}.")
    values = {explainer: _values(blocks, explainer, metric) for explainer in blocks}
    sign = -1.0 if BETTER[metric] is Direction.LOWER else 1.0
    zeros = [np.zeros_like(block) for block in next(iter(values.values()))]

    def rng(*of: str) -> np.random.Generator:
        return np.random.default_rng(derived_seed("compare", metric, *of))

    means = {name: hierarchical_bootstrap(each, zeros, rng(name)) for name, each in values.items()}
    without = sorted(name for name, mean in means.items() if mean.value is None)
    if without:
        raise InputError(
            f"{metric} is not a number in any episode of {without[0]!r}: leave that explainer out, or choose "
            f"another metric."
        )
    order = sorted(values, key=lambda name: (-sign * (means[name].value or 0.0), name))
    groups = tie_groups([values[name] for name in order], rng("ties"))
    pairs = list(combinations(order, 2))
    tests = [mann_whitney(np.concatenate(values[a]), np.concatenate(values[b])) for a, b in pairs]
    p = [test.p for test in tests if test is not None]
    corrected = iter(zip(bonferroni(p).tolist(), holm(p).tolist(), strict=True))
    return Comparison(
        metric=metric,
        better=BETTER[metric].value,
        states=tuple(next(iter(blocks.values()))),
        standings=tuple(
            Standing(name, means[name], group + 1) for name, group in zip(order, groups, strict=True)
        ),
        pairs=tuple(
            Pair(
                a,
                b,
                hierarchical_bootstrap(values[a], values[b], rng(a, b)),
                test,
                *(next(corrected) if test is not None else (None, None)),
            )
            for (a, b), test in zip(pairs, tests, strict=True)
        ),
    )


def _values(blocks: Blocks, explainer: str, metric: str) -> list[Floats]:
    """Of each policy and cell, NaN where an episode has no number."""
    found = []
    for states, cell in blocks[explainer].items():
        if metric in cell.not_measured:
            raise InputError(
                f"{metric} was not measured for {named(explainer, states)} ({cell.not_measured[metric]}): "
                f"choose another metric, or leave that entry out."
            )
        rows = [getattr(row, metric) for row in cell.episodes]
        found.append(np.array([np.nan if value is None else value for value in rows], dtype=np.float64))
    return found


def records(comparisons: Sequence[Comparison]) -> list[Mapping[str, Any]]:
    """As JSON: numbers and nothing else."""
    return [asdict(comparison) for comparison in comparisons]
