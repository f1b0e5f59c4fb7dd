"""A digest of what an explainer's masks score, to find the same masks under another name."""

from __future__ import annotations

import hashlib

from xmarl_bench.entry.metric_records import ExplanationRow
from xmarl_bench.entry.schema import CellResult, Entry
from xmarl_bench.records.files import canonical_json

DIGITS = 6  # significant ones: rounding of another machine shall not hide a copy


def mask_digest(entry: Entry, cell: CellResult) -> str:
    """Equal for two entries whose masks score the same on every episode, to DIGITS digits; 16 digits."""
    rows = [
        [row.seed, *(_rounded(getattr(row, name)) for name in ExplanationRow.model_fields)]
        for row in cell.episodes
    ]
    content = [entry.policy.weights_sha256, cell.task, cell.n_agents, cell.max_cycles, rows]
    return hashlib.sha256(canonical_json(content)).hexdigest()[:16]


def _rounded(value: float | None) -> str | None:
    return None if value is None else f"{value + 0.0:.{DIGITS}g}"
