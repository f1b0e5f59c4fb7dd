"""The reference policies shipped with the benchmark: one bundle of `xmarl-train` per folder."""

from __future__ import annotations

from pathlib import Path

HERE = Path(__file__).parent


def shipped_policies() -> dict[str, Path]:
    """Names and bundle folders, as the entry-point group `xmarl_bench.policies` requires."""
    return {card.parent.name: card.parent for card in sorted(HERE.glob("*/policy.json"))}
