"""How far absence models agree: on planted policies, and about who matters to a receiver."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from xmarl_bench.board.agreement import Floats, Scores
from xmarl_bench.meta.planted_suite import PlantedScore
from xmarl_bench.meta.right_ranking import shapley_values
from xmarl_bench.metrics import rank_correlation
from xmarl_bench.metrics.absence import Absence
from xmarl_bench.metrics.rank_correlation import DECIMALS
from xmarl_bench.scoring.states import States


def scores_of_planted(found: Sequence[PlantedScore]) -> list[Scores]:
    """Scores of each planted policy: budgeted fidelity under each absence model."""
    policies: dict[tuple[str, int], dict[str, Mapping[str, float | None]]] = {}
    for each in found:
        if each.error is None and not each.control:
            policies.setdefault((each.family, each.n_agents), {})[each.explainer] = each.under
    return list(policies.values())


def absences_agree(states: Iterable[States]) -> Floats:
    """(4, 4): rank correlation of the Shapley values of a receiver's messages under two absence models.

    Mean over episodes. Values that are equal to DECIMALS decimals are ties. Skips episodes without one of
    the models.
    """
    found = []
    for each in states:
        if set(each.tables) == set(Absence):
            deltas = [each.tables[absence].delta for absence in Absence]
            values = [np.round(shapley_values(delta), DECIMALS) for delta in deltas]
            found.append([[rank_correlation(one, other) for other in values] for one in values])
    return np.mean(found, axis=0) if found else np.full((len(Absence), len(Absence)), np.nan)
