"""How near a rerun must come: to the bit on the same platform, within a published tolerance on another.

Matrix products round by the vector instructions of the processor; an episode then differs by rounding, until
agents touch and a trajectory branches. What that did between instruction sets is in leaderboard/README.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from xmarl_bench.entry.provenance import provenance
from xmarl_bench.entry.schema import Entry
from xmarl_bench.submission.recompute import Difference

# Relative to the larger of 1 and the number itself.
ROWS: Final = 1e-3
AGGREGATES: Final = 2e-2  # the oracle's own ranking is nothing but ties, which rounding turns over
BRANCHED: Final = 0.1  # of the episodes played again may branch off


@dataclass(frozen=True)
class Platform:
    """What decides how numbers round."""

    packages: dict[str, str]
    python: str
    machine: str
    cpu: str
    cpu_capability: str

    @classmethod
    def here(cls) -> Platform:
        here = provenance("", 1)
        return cls(here.packages, here.python, here.machine, here.cpu, here.cpu_capability)

    @classmethod
    def of(cls, entry: Entry) -> Platform:
        there = entry.provenance
        return cls(there.packages, there.python, there.machine, there.cpu, there.cpu_capability)


def is_same_platform(entry: Entry) -> bool:
    """Whether the entry says that it was made where numbers round as they do here."""
    return Platform.of(entry) == Platform.here()


def agrees(difference: Difference, tolerance: float | None) -> bool:
    """Whether a number and that of its rerun are near enough, or the same where the tolerance is None."""
    if tolerance is None or difference.entry is None or difference.found is None:
        return difference.size == 0.0
    scale = max(1.0, abs(difference.entry), abs(difference.found))
    return difference.size <= tolerance * scale


def disagreeing(episodes: Sequence[Sequence[Difference]], *, bitwise: bool) -> list[Difference]:
    """The worst number of each episode that does not agree; none where no more do than may branch off."""
    tolerance = None if bitwise else ROWS
    apart = [
        max(wrong, key=lambda each: each.size)
        for wrong in ([each for each in episode if not agrees(each, tolerance)] for episode in episodes)
        if wrong
    ]
    return apart if len(apart) > (0 if bitwise else round(BRANCHED * len(episodes))) else []
