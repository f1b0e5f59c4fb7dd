"""Who is better than whom, and how sure that is: ranks with intervals, and tie groups.

All competitors of a resample are given the same episodes, so every difference between two of them is paired.
Where several policies stand behind a mean, policies are drawn first and then as many episodes of each drawn
one as it has, as in `xmarl_bench.metrics.statistics.hierarchical_bootstrap`; the tie groups are by the
rule of its `tie_groups`. Sums run in one order on every machine (no BLAS), so that a board is the same bytes
everywhere.
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from xmarl_bench.metrics.statistics import CHUNK, RESAMPLES, groups_by_head, percentiles

DIGITS = 9  # after the point; what is beyond is rounding, as between attention and attention-rowmax

Floats = NDArray[np.float64]
Explainer = TypeVar("Explainer", bound=Hashable)
Policy = TypeVar("Policy", bound=Hashable)


@dataclass(frozen=True)
class Place:
    """Where a competitor stands. Without two complete episodes nothing is known: no intervals, all tied."""

    rank: int  # from 1, by value; equal values share one
    rank_interval: tuple[int, int] | None  # 95 %
    interval: tuple[float, float] | None  # 95 %, of the mean
    tie_group: int  # from 1; who shares it with the group's first cannot be told from the first


def places(values: Sequence[float], blocks: Sequence[Floats], rng: np.random.Generator) -> list[Place]:
    """The places of R competitors.

    values: R means, which decide the order. They are equal where DIGITS digits are.
    blocks: for each policy the competitors' episodes (R, E_g), NaN where one is not a number. An episode
        counts where all competitors have a number.
    """
    if not values:
        return []
    rounded = np.round(np.asarray(values), DIGITS)
    order = np.argsort(-rounded, kind="stable")
    ranks = 1 + (rounded[None, :] > rounded[:, None]).sum(axis=1)
    complete = [block[:, ~np.isnan(block).any(axis=0)] for block in blocks]
    complete = [block for block in complete if block.shape[1]]
    if sum(block.shape[1] for block in complete) < 2:
        return [Place(int(rank), None, None, 1) for rank in ranks]
    samples = np.round(resampled(complete, rng), DIGITS)
    above = (samples[:, None, :] > samples[:, :, None]).sum(axis=2)  # [b, r]: so many are better than r
    low, high = np.quantile(above + 1, [0.025, 0.975], axis=0, method="closest_observation")
    groups = _tie_groups(samples, order)
    return [
        Place(int(ranks[r]), (int(low[r]), int(high[r])), percentiles(samples[:, r]), groups[r])
        for r in range(len(values))
    ]


def resampled(blocks: Sequence[Floats], rng: np.random.Generator, resamples: int = RESAMPLES) -> Floats:
    """(R, E_g) episodes without NaN for each policy -> (resamples, R) means over policies and episodes."""
    n_policies = len(blocks)
    total = np.zeros((resamples, len(blocks[0])))
    drawn = rng.integers(n_policies, size=(resamples, n_policies))
    drawn += n_policies * np.arange(resamples)[:, None]
    times = np.bincount(drawn.ravel(), minlength=resamples * n_policies).reshape(resamples, n_policies)
    for g, block in enumerate(blocks):
        n_episodes = block.shape[1]
        which = np.repeat(np.arange(resamples), times[:, g])
        by_episode = np.ascontiguousarray(block.T)
        step = max(1, CHUNK // block.size)
        for first in range(0, which.size, step):
            some = which[first : first + step]
            episodes = rng.integers(n_episodes, size=(some.size, n_episodes))
            np.add.at(total, some, _sums(by_episode, episodes) / n_episodes)
    return total / n_policies


def _sums(by_episode: Floats, drawn: NDArray[np.int64]) -> Floats:
    """(E, R), (n, k) episodes drawn -> (n, R): one episode after the other, for all at once.

    To gather all (n, k, R) numbers first would take five times as long, most of it waiting for memory.
    """
    first, *others = np.ascontiguousarray(drawn.T)
    total: Floats = np.take(by_episode, first, axis=0)
    taken = np.empty_like(total)
    for each in others:
        total += np.take(by_episode, each, axis=0, out=taken, mode="clip")  # "raise" would buffer `out`
    return total


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


def _tie_groups(samples: Floats, order: NDArray[np.intp]) -> dict[int, int]:
    """Competitor -> group, from 1: 0 lies in the interval of its difference to the group's first."""

    def tied(head: int, k: int) -> bool:
        low, high = percentiles(samples[:, order[head]] - samples[:, order[k]])
        return low <= 0.0 <= high

    groups = groups_by_head(len(order), tied)
    return {int(r): group + 1 for r, group in zip(order, groups, strict=True)}
