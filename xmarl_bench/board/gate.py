"""What it takes that explanations of a policy are ranked.

A team that fails has nothing worth explaining, and of a team whose messages are of no use no explanation of
them is worth anything, however much they change its actions: a policy was seen that did better without them.
"""

from __future__ import annotations

from typing import Final

from xmarl_bench.entry.schema import Metrics, Summary
from xmarl_bench.metrics.table import GAINS, SUCCESS, by_name

LEAST_SUCCESS: Final = 0.5


def shut_gate(metrics: Metrics) -> str | None:
    """Why explanations of a policy are not ranked, without a full stop; None where they are."""
    success = getattr(metrics, SUCCESS).value
    if success is None or success < LEAST_SUCCESS:
        return f"success rate {_number(success)}, under {LEAST_SUCCESS:g}"
    gains = {name: getattr(metrics, name) for name in GAINS}
    if any(gain.interval is not None and gain.interval[0] > 0.0 for gain in gains.values()):
        return None
    shown = ", ".join(f"{by_name()[name].title} {_gain(gain)}" for name, gain in gains.items())
    return f"messages are not shown to help: {shown}"


def _number(value: float | None) -> str:
    return "not a number" if value is None else f"{value:.3f}"


def _gain(gain: Summary) -> str:
    interval = "" if gain.interval is None else f" ({gain.interval[0]:.3f} to {gain.interval[1]:.3f})"
    return f"{_number(gain.value)}{interval}"
