"""Scores of rankings of senders: FidDelta@k of a mask, between a random ranking and the best one."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from xmarl_bench.entry.metric_records import BudgetRow
from xmarl_bench.metrics.absence import Absence

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Ranked:
    """FidDelta@k, k = 1 .. M - 1, of a mask, of a random ranking and of the best; None without an oracle."""

    explained: Floats
    random: Floats | None
    oracle: Floats | None
    budgeted: float
    random_error: Floats | None = None  # standard error of an estimate of random@k

    @property
    def mean(self) -> float:
        return float(self.explained.mean()) if self.explained.size else math.nan

    def record(self) -> BudgetRow:
        random, oracle, error = (
            None if curve is None else _numbers(curve)
            for curve in (self.random, self.oracle, self.random_error)
        )
        return BudgetRow(explained=_numbers(self.explained), random=random, oracle=oracle, random_error=error)


@dataclass(frozen=True)
class Rankings:
    """Scores of a mask's rankings: of all edges, and of messages under each absence model measured."""

    all_edges: Ranked
    messages: dict[Absence, Ranked]  # zero first

    def records(self) -> dict[str, BudgetRow]:
        """The budgets in the row of an episode."""
        under = {f"{absence.prefix}_budget": each.record() for absence, each in self.messages.items()}
        return {"budget": self.all_edges.record(), **under}


def number(value: float) -> float | None:
    """The value; None if it is not finite, because JSON has no NaN. Means count these as `n_nan`."""
    return float(value) if math.isfinite(value) else None


def _numbers(curve: Floats) -> tuple[float | None, ...]:
    return tuple(number(value) for value in curve)
