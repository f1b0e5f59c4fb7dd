"""Ranks competitors, with intervals of ranks and tie groups.

Comparisons are paired: competitors are compared on the same units. With several policies the units are
training runs, in clusters where they share a start, with a single policy its episodes
(xmarl_bench.metrics.student).
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from xmarl_bench.metrics.statistics import groups_by_head, holm
from xmarl_bench.metrics.student import (
    CONFIDENCE,
    Design,
    interval_of,
    mean_of,
    n_independent,
    student_p,
)

DIGITS = 6  # decimal digits; smaller differences are rounding, as between attention and attention-rowmax

Floats = NDArray[np.float64]
Explainer = TypeVar("Explainer", bound=Hashable)
Policy = TypeVar("Policy", bound=Hashable)


@dataclass(frozen=True)
class Place:
    """A competitor's place. With fewer than two units there are no intervals, and all are tied."""

    rank: int  # from 1, by value; equal values share a rank
    rank_interval: tuple[int, int] | None  # 95 %, from the significant differences to the others, by Holm
    interval: tuple[float, float] | None  # 95 %, of the mean; also None if all of few units are equal
    tie_group: int  # from 1; members do not differ significantly from the first of the group
    ties_first: bool  # no significant difference to the first of all, whoever stands between


def places(
    values: Sequence[float],
    blocks: Sequence[Floats],
    most: float = np.inf,
    design: Design | None = None,
) -> list[Place]:
    """The places of R competitors.

    values: R means, which give the order. They count as equal if DIGITS digits are.
    blocks: for each policy the competitors' episodes (R, E_g), NaN if a value is not a number. An episode
        counts if all competitors have a number.
    most: the largest possible value, at which intervals end. design: of the policies.
    """
    if not values:
        return []
    rounded = np.round(np.asarray(values), DIGITS)
    order = np.argsort(-rounded, kind="stable")
    ranks = 1 + (rounded[None, :] > rounded[:, None]).sum(axis=1)
    units, design = _units(blocks, design)
    n = len(values)
    if n_independent(units, design) < 2:
        return [Place(int(rank), None, None, 1, True) for rank in ranks]
    intervals = [interval_of(row, design=design) for row in units]
    difference = np.round(units[:, None] - units[None, :], DIGITS)  # (R, R, U)
    p, better = student_p(difference, design=design), mean_of(difference, design) > 0.0
    sure = np.zeros((n, n), dtype=bool)
    for r in range(n):
        others = np.delete(np.arange(n), r)
        sure[r, others] = holm(p[r, others]) < 1.0 - CONFIDENCE
    never_above = (sure & better) | ((difference == 0.0).all(axis=-1) & ~np.eye(n, dtype=bool))
    first, last = 1 + (sure & better.T).sum(axis=1), n - never_above.sum(axis=1)
    differs = p < 1.0 - CONFIDENCE
    groups = groups_by_head(n, lambda head, k: not differs[order[head], order[k]])
    group_of = {int(r): group + 1 for r, group in zip(order, groups, strict=True)}
    return [
        Place(
            int(ranks[r]),
            (int(first[r]), int(last[r])),
            None if (each := intervals[r]) is None else (each[0], min(each[1], most)),
            group_of[r],
            not differs[order[0], r],
        )
        for r in range(n)
    ]


def _units(blocks: Sequence[Floats], design: Design | None) -> tuple[Floats, Design | None]:
    """(R, U) means of the policies with their design, or the episodes of a single policy."""
    complete = [block[:, ~np.isnan(block).any(axis=0)] for block in blocks]
    if len(blocks) == 1:
        return complete[0], None
    kept = [k for k, block in enumerate(complete) if block.shape[1]]
    means = [complete[k].mean(axis=1) for k in kept]
    return np.stack(means, axis=1) if means else blocks[0][:, :0], design and design.of(kept)


def complete_part(scored: Mapping[Policy, Sequence[Explainer]]) -> tuple[list[Policy], list[Explainer]]:
    """The policies and explainers to compare means over, such that every pair was scored.

    For each t, take the policies with at least t explainers, and the explainers that all of these have.
    Returns those of the t with the most pairs. So a policy with few explainers, or an explainer scored on few
    policies, does not exclude others.
    """
    best: tuple[list[Policy], list[Explainer]] = ([], [])
    for least in sorted({len(each) for each in scored.values()}):
        policies = [policy for policy, each in scored.items() if len(each) >= least]
        shared = [name for name in scored[policies[0]] if all(name in scored[policy] for policy in policies)]
        if len(policies) * len(shared) > len(best[0]) * len(best[1]):
            best = policies, shared
    return best
