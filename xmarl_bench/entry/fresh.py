"""Compares scores on public and fresh seeds: how much an explainer gains from knowing the public episodes."""

from __future__ import annotations

from collections.abc import Mapping

from xmarl_bench.entry.schema import CellResult, FreshDifference
from xmarl_bench.metrics.statistics import over_samples
from xmarl_bench.metrics.table import HEADLINES, ON_FRESH, Direction, by_name
from xmarl_bench.records.field_types import rounded


def differences(public: CellResult, fresh: CellResult) -> dict[str, FreshDifference]:
    """Public less fresh, of the headline metrics and the paper's, over episodes."""
    return {name: _difference(public, fresh, name) for name in ON_FRESH}


def headline(compared: Mapping[str, FreshDifference]) -> tuple[str, FreshDifference] | None:
    """The deciding metric, with its difference; None if none was measured."""
    measured = (name for name in HEADLINES if name in compared and compared[name].difference is not None)
    name = next(measured, None)
    return None if name is None else (name, compared[name])


def worse_on_fresh(compared: Mapping[str, FreshDifference]) -> str | None:
    """A sentence if the explainer is worse on fresh episodes, by an interval that excludes 0; else None."""
    decides = headline(compared)
    if decides is None or decides[1].interval is None:
        return None
    name, found = decides
    assert found.interval is not None
    metric, (low, high) = by_name()[name], found.interval
    worse = low > 0.0 if metric.direction is Direction.HIGHER else high < 0.0
    if not worse:
        return None
    return (
        f"It does worse on fresh seeds: {metric.title} {found.fresh:.3f} there, {found.public:.3f} on the "
        f"public ones, difference {found.difference:.3f} [{low:.3f}, {high:.3f}]."
    )


def _difference(public: CellResult, fresh: CellResult, name: str) -> FreshDifference:
    values = [
        [value for row in cell.episodes if (value := getattr(row, name)) is not None]
        for cell in (public, fresh)
    ]
    means = [rounded(sum(each) / len(each)) if each else None for each in values]
    found = over_samples(*values)
    return FreshDifference(
        public=means[0], fresh=means[1], difference=rounded(found.value), interval=rounded(found.interval)
    )
