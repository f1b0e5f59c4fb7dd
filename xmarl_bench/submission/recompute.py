"""The first tier: recomputes every aggregate of an entry from its rows."""

from __future__ import annotations

from collections.abc import Container, Iterator
from itertools import zip_longest
from typing import Any, NamedTuple

from xmarl_bench.entry.aggregation import metrics_of_cell
from xmarl_bench.entry.record import Record
from xmarl_bench.entry.schema import Entry


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

    def sentence(self, source: str) -> str:
        """That the numbers differ. source: of the second, such as "rows give"."""
        return f"{self.where} is {self.entry}, but the {source} {self.found}."


def recomputed(entry: Entry) -> Iterator[Difference]:
    """Every aggregate of the entry with its value recomputed from the rows."""
    for k, cell in enumerate(entry.results):
        found = metrics_of_cell(cell, entry.explainer.seed)
        yield from differences(f"results.{k}.metrics", cell.metrics, found)


def differences(where: str, entry: Any, found: Any, skipped: Container[str] = ()) -> Iterator[Difference]:
    """The numbers of two records of one class in pairs, at any depth, without the fields to skip."""
    either = found if entry is None else entry
    if isinstance(either, Record):
        for name in type(either).model_fields:
            if name not in skipped:
                one, other = (getattr(each, name, None) for each in (entry, found))
                yield from differences(f"{where}.{name}", one, other, skipped)
    elif isinstance(either, tuple):
        for k, pair in enumerate(zip_longest(entry or (), found or ())):
            yield Difference(f"{where}.{k}", *pair)
    else:
        yield Difference(where, entry, found)
