"""Checks that the controls of an entry are there, and that their numbers follow from their masks."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Final, cast

from pydantic import TypeAdapter, ValidationError

from xmarl_bench.entry.aggregation import BEHAVIOUR, BEHAVIOUR_UNDER
from xmarl_bench.entry.metric_records import ControlMetrics, EpisodeRow, Summary
from xmarl_bench.entry.schema import CellResult
from xmarl_bench.explain.control_names import (
    BY_ZERO,
    INITIAL_ATTENTION,
    INVERTED,
    NEAREST,
    ORACLE,
    RANDOM,
    SUMMARIES,
)
from xmarl_bench.metrics.table import UNDER_ABSENCES
from xmarl_bench.records.strict_json import shown
from xmarl_bench.submission.rounding import ALIKE, close

IF_ORACLE: Final = set(BY_ZERO)
ALWAYS_PRESENT: Final = SUMMARIES.keys() - IF_ORACLE | {INVERTED, NEAREST}
IF_INITIAL_SEED: Final = {INITIAL_ATTENTION}  # present if the card has the seed of the initial weights
# The range of a mean is that of its rows.
RANGES: dict[str, TypeAdapter[float | None]] = {
    name: TypeAdapter(cast(Any, EpisodeRow.model_fields[name].annotation))
    for name in ControlMetrics.model_fields
}


# (control, metric, its value): 0, 1, or a metric of the explainer. Each follows from the mask.
IDENTITIES: tuple[tuple[str, str, float | str], ...] = (
    # These rank nothing.
    *((name, metric, 0.0) for name in ("all-ones", "zeros", "self") for metric in UNDER_ABSENCES),
    ("all-ones", "budgeted_fidelity", 0.0),
    ("zeros", "budgeted_fidelity", 0.0),
    ("all-ones", "fid_minus", 0.0),
    ("all-ones", "gef", 0.0),
    ("all-ones", "comm_fid_minus", 0.0),
    ("all-ones", "mask_mass", 1.0),
    ("all-ones", "comm_fid_plus", "communication_dependence"),
    ("zeros", "fid_plus", 0.0),
    ("zeros", "comm_fid_plus", 0.0),
    ("zeros", "mask_mass", 0.0),
    ("zeros", "comm_fid_minus", "communication_dependence"),
    ("self", "fid_minus", "communication_dependence"),
    ("self", "comm_fid_plus", 0.0),
    ("self", "comm_fid_minus", "communication_dependence"),
    (INVERTED, "fid_plus", "fid_minus"),
    (INVERTED, "fid_minus", "fid_plus"),
    (INVERTED, "comm_fid_plus", "comm_fid_minus"),
    (INVERTED, "comm_fid_minus", "comm_fid_plus"),
)


def control_findings(cell: CellResult) -> Iterator[str]:
    """A sentence per finding on the controls of a cell; none if they are consistent."""
    expected = ALWAYS_PRESENT
    if set(cell.controls) - IF_INITIAL_SEED not in (expected, expected | IF_ORACLE):
        yield f"controls are {shown(', '.join(sorted(cell.controls)), 200)}, expected {sorted(expected)}."
        return
    for name, control in cell.controls.items():
        for finding in _summaries_findings(cell, name, control):
            yield f"controls.{name}: {finding}"
    for name, metric, given in IDENTITIES:
        value = _mean(getattr(cell.controls[name], metric))
        other = _mean(getattr(cell.metrics, given)) if isinstance(given, str) else given
        if value is not None and other is not None and abs(value - other) > ALIKE:
            yield f"controls.{name}: {metric} is {value}, but must be {other} for that mask."
    best = _mean(cell.controls[ORACLE].fid_delta) if ORACLE in cell.controls else None
    binary = {"all-ones", "zeros", "bernoulli", "self"} if cell.oracle_kind == "enumerated" else {"all-ones"}
    for name in sorted(binary & set(cell.controls)):
        value = _mean(cell.controls[name].fid_delta)
        if best is not None and value is not None and value > best + ALIKE:
            yield f"controls.{name}: fid_delta {value} is more than the oracle's, {best}."


def _summaries_findings(cell: CellResult, name: str, control: ControlMetrics) -> Iterator[str]:
    acted = {
        **dict.fromkeys(BEHAVIOUR, cell.behaviour_episodes),
        **dict.fromkeys(BEHAVIOUR_UNDER, cell.absence_behaviour_episodes or 0),
    }
    absent = {each for each, n in acted.items() if name != RANDOM or n == 0} | set(cell.not_measured)
    summaries: dict[str, Summary | None] = {
        metric: getattr(control, metric) for metric in ControlMetrics.model_fields
    }
    wrong = [metric for metric, summary in summaries.items() if (summary is None) != (metric in absent)]
    if wrong:
        yield f"{wrong[0]} contradicts what was measured."
    for metric, summary in summaries.items():
        if summary is not None and metric not in absent:
            n = acted.get(metric, len(cell.episodes))
            if summary.n + summary.n_nan != n:
                yield f"{metric} has {summary.n + summary.n_nan} episodes, expected {n}."
            yield from _summary_findings(metric, summary)
    for prefix in ("", "comm_"):
        names = (f"{prefix}fid_delta", f"{prefix}fid_plus", f"{prefix}fid_minus")
        delta, plus, minus = (_mean(getattr(control, each)) for each in names)
        if delta is not None and plus is not None and minus is not None and not close(delta, plus - minus):
            yield f"{prefix}fid_delta {delta} is not {prefix}fid_plus - {prefix}fid_minus."


def _summary_findings(metric: str, summary: Summary) -> Iterator[str]:
    """Findings if numbers are outside the range of the metric's rows, or the mean outside its interval."""
    if (summary.value is None) != (summary.n == 0) or (summary.interval is None) != (summary.n < 2):
        yield f"{metric} has a value or an interval that {summary.n} episodes cannot give."
        return
    for value in (summary.value, *(summary.interval or ())):
        try:
            RANGES[metric].validate_python(value, strict=True)
        except ValidationError:
            yield f"{metric} is {value}, outside its range."
            return
    if summary.interval is not None and summary.value is not None:
        low, value, high = summary.interval[0], summary.value, summary.interval[1]
        if not (low <= value or close(low, value)) or not (value <= high or close(value, high)):
            yield f"{metric} {value} is not in its interval."


def _mean(summary: Summary | None) -> float | None:
    """The mean; None if it skips an episode, because then means do not add up as rows do."""
    return None if summary is None or summary.n_nan else summary.value
