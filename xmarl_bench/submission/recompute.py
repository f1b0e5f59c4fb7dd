"""The first tier: recomputes every aggregate of an entry from its rows."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import NamedTuple

from xmarl_bench.entry.aggregation import metrics_of_cell
from xmarl_bench.entry.metric_records import Metrics, Summary
from xmarl_bench.entry.schema import Entry
from xmarl_bench.submission.rounding import close


class Difference(NamedTuple):
    """A number of an entry and its recomputed value."""

    where: str
    entry: float | None
    found: float | None

    @property
    def size(self) -> float:
        """Absolute difference; infinite if one of the two is null."""
        if self.entry is None or self.found is None:
            return 0.0 if self.entry is self.found else float("inf")
        return abs(self.entry - self.found)


def recomputed(entry: Entry) -> Iterator[Difference]:
    """Every aggregate of the entry with its value recomputed from the rows."""
    for k, cell in enumerate(entry.results):
        metrics = metrics_of_cell(cell, entry.explainer.seed)
        for name in Metrics.model_fields:
            yield from summaries(
                f"results.{k}.metrics.{name}", getattr(cell.metrics, name), getattr(metrics, name)
            )


def recompute_findings(differences: Iterable[Difference]) -> Iterator[str]:
    """A sentence for each of the `recomputed` aggregates that differs by more than rounding."""
    for where, stated, found in differences:
        same = stated is found or (stated is not None and found is not None and close(stated, found))
        if not same:
            yield f"{where} is {stated}, but the rows give {found}."


def summaries(where: str, entry: Summary | None, found: Summary | None) -> Iterator[Difference]:
    """The numbers of two summaries in pairs. They hold no NaN; null equals only null."""
    for part in ("value", "n", "n_nan"):
        yield Difference(f"{where}.{part}", _part(entry, part), _part(found, part))
    for part, end in (("low", 0), ("high", 1)):
        ends = [
            None if each is None or each.interval is None else each.interval[end] for each in (entry, found)
        ]
        yield Difference(f"{where}.{part}", *ends)


def _part(summary: Summary | None, part: str) -> float | None:
    value: float | None = None if summary is None else getattr(summary, part)
    return value
