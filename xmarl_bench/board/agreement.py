"""How far metrics agree on the order of explainers: matrices of Spearman's correlations.

Each policy orders its explainers by each metric; the agreement of two metrics is the correlation of their
orders, mean over policies. Values are oriented so that higher is better, so 1 means the same order.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from xmarl_bench.board.entry_rows import is_whole
from xmarl_bench.metrics import rank_correlation
from xmarl_bench.metrics.rank_correlation import DECIMALS
from xmarl_bench.metrics.table import Direction, by_name

MIN_EXPLAINERS: Final = 5  # with values of both metrics: an order of fewer means little
Floats = NDArray[np.float64]
Scores = Mapping[str, Mapping[str, float | None]]  # explainer -> metric -> value, of one policy


def rank_agreement(policies: Iterable[Scores], metrics: Sequence[str]) -> Floats:
    """(M, M) agreement of metrics; NaN if no policy has MIN_EXPLAINERS explainers with both."""
    found = [_of_policy(scores, metrics) for scores in policies]
    if not found:
        return np.full((len(metrics), len(metrics)), np.nan)
    stacked = np.stack(found)
    known = ~np.isnan(stacked)
    return np.where(known.any(axis=0), np.nansum(stacked, axis=0) / np.maximum(1, known.sum(axis=0)), np.nan)


def scores_of_board(tables: Iterable[Mapping[str, Any]]) -> list[Scores]:
    """Scores of each policy of a leaderboard's tables that passes the gate, without controls."""
    return [
        {
            row["explainer"]: {name: summary and summary["value"] for name, summary in row["metrics"].items()}
            for row in policy["rows"]
            if not row["control"]
        }
        for table in tables
        for policy in table["policies"]
        if policy["gate"] is None and is_whole(policy)
    ]


def _of_policy(scores: Scores, metrics: Sequence[str]) -> Floats:
    oriented = [[_oriented(row.get(name), name) for row in scores.values()] for name in metrics]
    values = np.round(np.array(oriented), DECIMALS)
    agreement = np.full((len(metrics), len(metrics)), np.nan)
    for a, one in enumerate(values):
        for b, other in enumerate(values):
            both = ~np.isnan(one) & ~np.isnan(other)
            if both.sum() >= MIN_EXPLAINERS:
                agreement[a, b] = rank_correlation(one[both], other[both])
    return agreement


def _oriented(value: float | None, metric: str) -> float:
    if value is None:
        return np.nan
    return -value if by_name()[metric].direction is Direction.LOWER else value
