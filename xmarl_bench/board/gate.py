"""The gate: which policies' explanations are ranked.

Explanations are ranked only for teams that succeed and whose messages help. Messages may change actions much
without helping: there are policies that do better without them.
"""

from __future__ import annotations

from typing import Final

from xmarl_bench.entry.metric_records import Metrics, Summary
from xmarl_bench.metrics.table import GAINS, SUCCESS, by_name

MIN_SUCCESS: Final = 0.5


def gate_reason(metrics: Metrics) -> str | None:
    """Why explanations of a policy are not ranked, without a full stop; None if they are ranked.

    On a task that tells no success, reward alone decides.
    """
    success = getattr(metrics, SUCCESS)
    if success is not None and (success.value is None or success.value < MIN_SUCCESS):
        return f"success rate {_number(success.value)}, under {MIN_SUCCESS:g}"
    gains = {name: gain for name in GAINS if (gain := getattr(metrics, name)) is not None}
    if any(gain.interval is not None and gain.interval[0] > 0.0 for gain in gains.values()):
        return None
    shown = ", ".join(f"{by_name()[name].title} {_gain(gain)}" for name, gain in gains.items())
    return f"messages are not shown to help: {shown or 'no gain is measured'}"


def _number(value: float | None) -> str:
    return "not a number" if value is None else f"{value:.3f}"


def _gain(gain: Summary) -> str:
    interval = "" if gain.interval is None else f" ({gain.interval[0]:.3f} to {gain.interval[1]:.3f})"
    return f"{_number(gain.value)}{interval}"
