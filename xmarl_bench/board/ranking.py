"""Who is better than whom, and how sure that is: ranks with intervals, and tie groups.

Everything is paired: competitors are compared on the same units. These are the training runs where several
policies stand behind a mean, and the episodes of a single one (xmarl_bench.metrics.statistics).
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from xmarl_bench.metrics.statistics import CONFIDENCE, groups_by_head, holm, student_interval, student_p

DIGITS = 6  # after the point; what is beyond is rounding, as between attention and attention-rowmax

Floats = NDArray[np.float64]
Explainer = TypeVar("Explainer", bound=Hashable)
Policy = TypeVar("Policy", bound=Hashable)


@dataclass(frozen=True)
class Place:
    """Where a competitor stands. Without two units nothing is known: no intervals, all tied."""

    rank: int  # from 1, by value; equal values share one
    rank_interval: tuple[int, int] | None  # 95 %: who is surely better or worse, by Holm over its differences
    interval: tuple[float, float] | None  # 95 %, of the mean
    tie_group: int  # from 1; who shares it with the group's first cannot be told from the first


def places(values: Sequence[float], blocks: Sequence[Floats], most: float = np.inf) -> list[Place]:
    """The places of R competitors.

    values: R means, which decide the order. They are equal where DIGITS digits are.
    blocks: for each policy the competitors' episodes (R, E_g), NaN where one is not a number. An episode
        counts where all competitors have a number.
    most: the largest value that there can be; intervals end there.
    """
    if not values:
        return []
    rounded = np.round(np.asarray(values), DIGITS)
    order = np.argsort(-rounded, kind="stable")
    ranks = 1 + (rounded[None, :] > rounded[:, None]).sum(axis=1)
    units = _units(blocks)
    n = len(values)
    if units.shape[1] < 2:
        return [Place(int(rank), None, None, 1) for rank in ranks]
    low, high = student_interval(units)
    difference = np.round(units[:, None] - units[None, :], DIGITS)  # (R, R, U)
    p, better = student_p(difference), difference.mean(axis=-1) > 0.0
    sure = np.zeros((n, n), dtype=bool)
    for r in range(n):
        others = np.delete(np.arange(n), r)
        sure[r, others] = holm(p[r, others]) < 1.0 - CONFIDENCE
    never_above = (sure & better) | ((difference == 0.0).all(axis=-1) & ~np.eye(n, dtype=bool))
    first, last = 1 + (sure & better.T).sum(axis=1), n - never_above.sum(axis=1)
    groups = groups_by_head(n, lambda head, k: bool(p[order[head], order[k]] >= 1.0 - CONFIDENCE))
    group_of = {int(r): group + 1 for r, group in zip(order, groups, strict=True)}
    return [
        Place(
            int(ranks[r]),
            (int(first[r]), int(last[r])),
            (float(low[r]), min(float(high[r]), most)),
            group_of[r],
        )
        for r in range(n)
    ]


def _units(blocks: Sequence[Floats]) -> Floats:
    """(R, U): means of the policies, or the episodes of a single one."""
    complete = [block[:, ~np.isnan(block).any(axis=0)] for block in blocks]
    complete = [block for block in complete if block.shape[1]]
    if len(blocks) == 1:
        return complete[0] if complete else blocks[0][:, :0]
    means = [block.mean(axis=1) for block in complete]
    return np.stack(means, axis=1) if means else blocks[0][:, :0]


def complete_part(scored: Mapping[Policy, Sequence[Explainer]]) -> tuple[list[Policy], list[Explainer]]:
    """The policies and explainers to compare means over: every chosen pair was scored.

    Of the policies with at least t explainers, and the explainers that all of these have, those of the t with
    the most pairs. So a policy that few explained, or an explainer scored on few policies, shuts nobody out.
    """
    best: tuple[list[Policy], list[Explainer]] = ([], [])
    for least in sorted({len(each) for each in scored.values()}):
        policies = [policy for policy, each in scored.items() if len(each) >= least]
        shared = [name for name in scored[policies[0]] if all(name in scored[policy] for policy in policies)]
        if len(policies) * len(shared) > len(best[0]) * len(best[1]):
            best = policies, shared
    return best
