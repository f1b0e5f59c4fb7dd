"""Schedules of weights over a run."""

from __future__ import annotations


def ramp(done: float, start: float, length: float) -> float:
    """0 up to `start`, then linear to 1 over `length`; all arguments are fractions of the run."""
    since = done - start
    if since < 0:
        return 0.0
    return min(1.0, since / length) if length else 1.0
