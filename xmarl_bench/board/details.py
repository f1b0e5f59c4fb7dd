"""The details of an entry on the page, besides its means: episodes, budgets, provenance."""

from __future__ import annotations

from typing import Any

from xmarl_bench.board.budgets import curves_of
from xmarl_bench.board.columns import COLUMNS
from xmarl_bench.board.command import command_of
from xmarl_bench.entry.schema import CellResult, Entry
from xmarl_bench.explain.control_names import INVERTED
from xmarl_bench.metrics.table import Group, names_of

DIGITS = 4  # significant digits; `leaderboard.json` has all
# Metrics that the charts show by episode: those of explanations, not of policies.
EPISODE_METRICS = names_of(Group.BEHAVIOUR) + names_of(Group.BEHAVIOUR_UNDER) + names_of(Group.EXPLANATION)
Json = dict[str, Any]
Details = dict[tuple[str, int, int], Json]  # by task, team size and max cycles


def details_of(entry: Entry) -> Details:
    return {(c.task, c.n_agents, c.max_cycles): _detail(entry, c) for c in entry.results}


def _detail(entry: Entry, cell: CellResult) -> Json:
    inverted = cell.controls.get(INVERTED)
    return {
        "entry_id": entry.entry_id,
        "explainer": entry.explainer.model_dump(mode="json"),
        "policy": entry.policy.model_dump(mode="json"),
        "cost": entry.cost.model_dump(mode="json"),
        "provenance": entry.provenance.model_dump(mode="json"),
        "reported": entry.reported,
        "verification": entry.verification.model_dump(mode="json"),
        "command": command_of(entry),
        "first_seed": cell.episodes[0].seed,
        "n": {name: [s.n, s.n_nan] for name in COLUMNS if (s := getattr(cell.metrics, name)) is not None},
        "inverted": None
        if inverted is None
        else [numbers(getattr(inverted, name, None)) for name in COLUMNS],
        "episodes": {
            name: [short(getattr(row, name)) for row in cell.episodes]
            for name in EPISODE_METRICS
            if any(getattr(row, name) is not None for row in cell.episodes)
        },
        "budgets": curves_of(cell),
    }


def numbers(summary: Any) -> list[float | None] | None:
    """[value, low, high] of a summary (a record or its dump)."""
    if summary is None:
        return None
    fields = summary if isinstance(summary, dict) else summary.model_dump()
    interval = fields["interval"]
    return [short(fields["value"]), *([None, None] if interval is None else map(short, interval))]


def shown_value(summary: Json | None) -> float | None:
    return None if summary is None else short(summary["value"])


def short(value: float | None) -> float | None:
    return None if value is None else float(f"{value:.{DIGITS}g}")
