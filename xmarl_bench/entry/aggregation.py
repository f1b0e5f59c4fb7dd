"""Aggregates episodes to the numbers of a cell. The unit is the episode: timesteps are autocorrelated."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from xmarl_bench.entry.metric_records import (
    BehaviourRow,
    BudgetRow,
    ControlMetrics,
    EpisodeRow,
    ExplanationRow,
    Metrics,
    Summary,
)
from xmarl_bench.entry.protocol import SANITY_EPISODES
from xmarl_bench.entry.schema import CellResult
from xmarl_bench.metrics.budgeted_fidelity import SMALLEST
from xmarl_bench.metrics.statistics import percentile_interval
from xmarl_bench.metrics.table import Group, names_of
from xmarl_bench.records.field_types import rounded
from xmarl_bench.reproducible import derived_seed

BEHAVIOUR = names_of(Group.BEHAVIOUR)
BEHAVIOUR_UNDER = names_of(Group.BEHAVIOUR_UNDER)
SANITY = names_of(Group.SANITY)
# By absence model.
MESSAGE_BUDGETS = tuple(name for name in EpisodeRow.model_fields if name.endswith("_budget"))


class Acted(NamedTuple):
    """How many of the first episodes were acted out on an explanation."""

    zero: int  # under the absence model zero
    others: int  # of these under the others too


def summarise(values: Sequence[float | None], rng: np.random.Generator) -> Summary:
    """One value per episode, None if it is not a number -> mean and percentile bootstrap interval.

    Values that are not numbers are skipped and counted in `n_nan`, never replaced by 0. The interval is None
    for fewer than two episodes; constant values give an interval of width 0.
    """
    x = np.array([value for value in values if value is not None], dtype=np.float64)
    n_nan = len(values) - x.size
    if x.size == 0:
        return Summary(value=None, interval=None, n=0, n_nan=n_nan)
    interval = None
    if x.size > 1:
        interval = rounded(percentile_interval(x, rng))
    return Summary(value=rounded(float(x.mean())), interval=interval, n=int(x.size), n_nan=n_nan)


def metrics_of_cell(cell: CellResult, seed: int) -> Metrics:
    """A cell's metrics, computed from its rows."""
    acted = Acted(cell.behaviour_episodes, cell.absence_behaviour_episodes or 0)
    return cell_metrics(cell.episodes, seed, cell.not_measured, acted)


def cell_metrics(
    rows: Sequence[EpisodeRow], seed: int, not_measured: Mapping[str, str], acted: Acted
) -> Metrics:
    """Aggregate rows. The resampling of a metric's interval depends on its name and the run's seed only."""
    values = {name: [getattr(row, name) for row in rows] for name in Metrics.model_fields}
    return Metrics.model_validate(_summaries(values, seed, not_measured, acted))


def control_metrics(
    rows: Sequence[ExplanationRow],
    played: Sequence[BehaviourRow],
    seed: int,
    not_measured: Mapping[str, str],
    absences: int = 0,
) -> ControlMetrics:
    """Aggregate a control's episodes.

    played: rows of the first episodes, in which the team was rolled out.
    absences: how many of these were also played under the other absence models.
    Metrics without such episodes are not measured.
    """
    values = {name: [getattr(row, name) for row in rows] for name in ExplanationRow.model_fields}
    values |= {name: [getattr(row, name) for row in played] for name in BehaviourRow.model_fields}
    return ControlMetrics.model_validate(_summaries(values, seed, not_measured, Acted(len(played), absences)))


def sampling_error(rows: Sequence[EpisodeRow]) -> float | None:
    """The standard error that estimating random@k gives a message fidelity of 0, over episodes.

    An upper bound: assumes that errors of all budgets add up, and uses the absence model with the largest
    error. None if random@k was not estimated, or if there is nothing to rank.
    """
    found = []
    for name in MESSAGE_BUDGETS:
        squares = [e * e for row in rows if (e := _budget_error(getattr(row, name))) is not None]
        if squares:
            found.append(math.sqrt(sum(squares)) / len(squares))
    return rounded(max(found, default=None))  # type: ignore[no-any-return]


def _budget_error(budget: BudgetRow | None) -> float | None:
    """Of one episode: errors of random@k in units of oracle@k - random@k, mean over k."""
    if budget is None or budget.random is None or budget.oracle is None or budget.random_error is None:
        return None
    curves = (budget.random, budget.oracle, budget.random_error)
    random, oracle, error = (np.array(each, dtype=np.float64) for each in curves)
    counted = oracle - random >= SMALLEST
    return float((error[counted] / (oracle - random)[counted]).mean()) if counted.any() else None


def _summaries(
    values: Mapping[str, list[float | None]],
    seed: int,
    not_measured: Mapping[str, str],
    acted: Acted,
) -> dict[str, Summary | None]:
    first = {
        **dict.fromkeys(SANITY, SANITY_EPISODES),
        **dict.fromkeys(BEHAVIOUR, acted.zero),
        **dict.fromkeys(BEHAVIOUR_UNDER, acted.others),
    }
    counted = {name: series[: first.get(name)] for name, series in values.items()}
    return {
        name: summarise(series, np.random.default_rng(derived_seed("bootstrap", seed, name)))
        if series and name not in not_measured
        else None
        for name, series in counted.items()
    }
