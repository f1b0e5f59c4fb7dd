"""What it takes that explanations of a policy are ranked, see `GATE`."""

from __future__ import annotations

from typing import NamedTuple

from xmarl_bench.board.columns import GATE
from xmarl_bench.entry.schema import Metrics


class Shut(NamedTuple):
    """What keeps the gate shut."""

    metric: str
    value: float | None  # None: not a number
    least: float


def shut_gate(metrics: Metrics) -> Shut | None:
    """The first metric of GATE that a policy does not reach; None where its explanations are ranked."""
    for name, least in GATE.items():
        value = getattr(metrics, name).value
        if value is None or value < least:
            return Shut(name, value, least)
    return None
