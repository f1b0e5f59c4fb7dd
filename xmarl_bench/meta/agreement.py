"""Do metrics order explainers alike, and do absence models? Spearman's correlations as a matrix.

Each policy orders its explainers by each metric; two metrics agree as far as their orders correlate, mean
over policies. Values are oriented, so 1 is the same verdict, whichever end of a metric is better.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from xmarl_bench.meta.planted_suite import PlantedScore
from xmarl_bench.meta.right_ranking import shapley_values
from xmarl_bench.metrics import rank_correlation
from xmarl_bench.metrics.absence import Absence
from xmarl_bench.metrics.table import Direction, by_name
from xmarl_bench.scoring.states import States

FEWEST: Final = 5  # explainers that have a value of both metrics: of fewer an order says little
Floats = NDArray[np.float64]
Scores = Mapping[str, Mapping[str, float | None]]  # explainer -> metric -> value, of one policy


def rank_agreement(policies: Iterable[Scores], metrics: Sequence[str]) -> Floats:
    """-> (M, M), NaN where no policy has FEWEST explainers with both."""
    found = [_of_policy(scores, metrics) for scores in policies]
    if not found:
        return np.full((len(metrics), len(metrics)), np.nan)
    stacked = np.stack(found)
    known = ~np.isnan(stacked)
    return np.where(known.any(axis=0), np.nansum(stacked, axis=0) / np.maximum(1, known.sum(axis=0)), np.nan)


def scores_of_board(board: Mapping[str, Any]) -> list[Scores]:
    """Of each policy of a leaderboard's JSON that passes the gate: explainers, without controls."""
    return [
        {
            row["explainer"]: {name: summary and summary["value"] for name, summary in row["metrics"].items()}
            for row in policy["rows"]
            if not row["control"]
        }
        for table in board["tables"]
        for policy in table["policies"]
        if policy["gate"] is None
    ]


def scores_of_planted(found: Sequence[PlantedScore]) -> list[Scores]:
    """Of each planted policy: budgeted fidelity under each absence model."""
    policies: dict[tuple[str, int], dict[str, Mapping[str, float | None]]] = {}
    for each in found:
        if each.error is None and not each.control:
            policies.setdefault((each.family, each.n_agents), {})[each.explainer] = each.under
    return list(policies.values())


def absences_agree(states: Iterable[States]) -> Floats:
    """(4, 4): rank correlation of who matters to a receiver, by Shapley values under two absence models.

    It is the mean over the states of episodes; those without one of the models are left out.
    """
    found = []
    for each in states:
        if set(each.tables) == set(Absence):
            values = [shapley_values(each.tables[absence].delta) for absence in Absence]
            found.append([[rank_correlation(one, other) for other in values] for one in values])
    return np.mean(found, axis=0) if found else np.full((len(Absence), len(Absence)), np.nan)


def _of_policy(scores: Scores, metrics: Sequence[str]) -> Floats:
    values = np.array([[_oriented(row.get(name), name) for row in scores.values()] for name in metrics])
    agreement = np.full((len(metrics), len(metrics)), np.nan)
    for a, one in enumerate(values):
        for b, other in enumerate(values):
            both = ~np.isnan(one) & ~np.isnan(other)
            if both.sum() >= FEWEST:
                agreement[a, b] = rank_correlation(one[both].round(6), other[both].round(6))
    return agreement


def _oriented(value: float | None, metric: str) -> float:
    if value is None:
        return np.nan
    return -value if by_name()[metric].direction is Direction.LOWER else value
