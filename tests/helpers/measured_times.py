"""A board without the seconds that were measured, which no two runs have in common."""

from __future__ import annotations

import re
from pathlib import Path


def board_without_times(folder: Path) -> bytes:
    """The board's JSON, apart from costs and dates."""
    data = (folder / "leaderboard.json").read_bytes()
    return re.sub(rb'"(cost|date)": [^,}]+', rb'"\1": null', data)
