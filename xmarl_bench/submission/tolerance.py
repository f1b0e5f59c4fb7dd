"""Tolerances of a rerun: bit for bit on the same platform, within a published tolerance on another.

Rounding of matrix products depends on the processor's vector instructions. An episode then differs by
rounding, until agents touch and its trajectory branches. leaderboard/README.md gives measured differences
between instruction sets.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from xmarl_bench.entry.provenance import provenance
from xmarl_bench.entry.schema import Entry
from xmarl_bench.submission.recompute import Difference

# Relative to the larger of 1 and the number itself.
ROWS: Final = 1e-3
AGGREGATES: Final = 2e-2  # the oracle's ranking has many ties, which rounding may reorder
BRANCHED: Final = 0.1  # share of the episodes played again that may branch


# Fields of the provenance on which rounding depends. device None: the CPU.
PLATFORM: Final = ("packages", "python", "machine", "cpu", "cpu_capability", "device")


def is_same_platform(entry: Entry) -> bool:
    """Whether the entry was made on the same platform as this one, by its provenance."""
    here = provenance("", 1)
    return all(getattr(entry.provenance, name) == getattr(here, name) for name in PLATFORM)


def agrees(difference: Difference, tolerance: float | None) -> bool:
    """Whether a number agrees with its rerun within the tolerance; None: exactly."""
    if tolerance is None or difference.entry is None or difference.found is None:
        return difference.size == 0.0
    scale = max(1.0, abs(difference.entry), abs(difference.found))
    return difference.size <= tolerance * scale


def disagreeing(episodes: Sequence[Sequence[Difference]], *, bitwise: bool) -> list[Difference]:
    """The largest difference of each episode that disagrees; empty if at most a share BRANCHED does."""
    tolerance = None if bitwise else ROWS
    apart = [
        max(wrong, key=lambda each: each.size)
        for wrong in ([each for each in episode if not agrees(each, tolerance)] for episode in episodes)
        if wrong
    ]
    return apart if len(apart) > (0 if bitwise else round(BRANCHED * len(episodes))) else []
