"""The details of an entry on the page, besides its means: episodes, budgets, provenance."""

from __future__ import annotations

from typing import Any

from xmarl_bench.board.budgets import curves_of
from xmarl_bench.board.columns import BY_EPISODE, COLUMNS
from xmarl_bench.board.command import command_of
from xmarl_bench.board.rows import numbers
from xmarl_bench.entry.schema import CellResult, Entry
from xmarl_bench.explain.control_names import INVERTED

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
        else [numbers(name, getattr(inverted, name, None)) for name in COLUMNS],
        "episodes": {name: [getattr(row, name) for row in cell.episodes] for name in BY_EPISODE},
        "budgets": curves_of(cell),
    }
