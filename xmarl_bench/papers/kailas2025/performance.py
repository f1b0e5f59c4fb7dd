"""Task performance in the layout of the paper's tables: mean and standard deviation, ours and the paper's."""

from __future__ import annotations

from itertools import product
from typing import Any

from xmarl_bench.metrics.table import Group, names_of
from xmarl_bench.papers.kailas2025.claims import ATTENTION, Cell, Term
from xmarl_bench.papers.kailas2025.paper import MAIN, TRAINING, ZERO_SHOT, Performance
from xmarl_bench.papers.kailas2025.samples import Samples, pooled


def reported(cell: Cell) -> Performance | None:
    """The paper's numbers for a cell; None if it has none."""
    if cell.percent is not None:
        return TRAINING.get(cell.percent)
    if cell.more:
        return ZERO_SHOT.get((cell.n_trained, cell.n_trained + cell.more))
    return MAIN.get((cell.task, cell.n_trained))


def performance(samples: Samples, cells: tuple[Cell, ...]) -> list[dict[str, Any]]:
    """Records over the episodes of all training runs: per cell and measure, without and with the term."""
    records: list[dict[str, Any]] = []
    for cell, measure, regularised in product(cells, names_of(Group.TASK), (False, True)):
        runs = samples.runs(cell, Term(ATTENTION), regularised)
        x = pooled(runs, measure)
        pair = (reported(cell) or {}).get(measure)
        if pair is not None or x.size:
            records.append(
                {
                    "cell": cell.label,
                    "measure": measure,
                    "regularised": regularised,
                    "mean": float(x.mean()) if x.size else None,
                    "std": float(x.std()) if x.size else None,
                    "n_policies": len(runs),
                    "n_episodes": x.size,
                    "paper": None if pair is None else pair[regularised]._asdict(),
                }
            )
    return records
