"""The leaderboard: derived from entries and from nothing else, never edited.

`leaderboard.json` and `index.html` are functions of the entries alone, so anyone can rebuild them, byte by
byte. Entries stand in one table only where protocol and cell are identical, and are ranked only against
others on the same policy: a FidDelta of one policy says nothing about another's.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from jinja2 import Environment, StrictUndefined

from xmarl_bench.entry import PROTOCOL, CellResult, Entry, read_entries
from xmarl_bench.files import canonical_json, write_atomically, write_json

ORDER = {
    "by": "fid_delta",
    "direction": "descending",
    "controls": "shown in place, not ranked",
    "note": "FidDelta alone can be gamed: the mask of ones, a control, attains nearly all of it. Read it "
    "beside fid_minus, gef and mask_mass. Communication-only budgeted fidelity will replace it as the order.",
}
EXPLANATION_METRICS = ("fid_plus", "fid_minus", "fid_delta", "gef", "median_kl", "mask_mass")
POLICY_METRICS = (
    "success_rate", "no_agent_collision", "no_object_collision", "makespan", "reward",
    "communication_dependence",
)  # fmt: skip
TEMPLATE = Path(__file__).with_name("board.html.jinja")


def build_board(folder: Path) -> Path:
    """Read FOLDER/entries/*.json, write FOLDER/leaderboard.json and FOLDER/index.html; returns the first.

    Raises InputError, before writing, where an entry is not valid.
    """
    entries = read_entries(folder / "entries")
    board = board_of([(f"entries/{path.name}", entry) for path, entry in entries])
    page = render(board)
    path = folder / "leaderboard.json"
    write_json(path, board)
    write_atomically(folder / "index.html", page.encode())
    return path


def board_of(entries: Sequence[tuple[str, Entry]]) -> dict[str, Any]:
    """(file, entry) pairs to the board as JSON; their order does not matter."""
    tables: dict[bytes, dict[str, Any]] = {}
    for file, entry in sorted(entries, key=lambda pair: pair[0]):
        for cell in entry.results:
            protocol = entry.protocol.model_dump(mode="json")
            scope = {
                "task": cell.task,
                "n_agents": cell.n_agents,
                "max_cycles": cell.max_cycles,
                "protocol": protocol,
            }
            table = tables.setdefault(canonical_json(scope), {**scope, "policies": {}})
            policies = table["policies"]
            group = policies.setdefault(entry.policy.weights_sha256 + entry.policy.name, _policy(entry, cell))
            group["rows"].append(_row(file, entry, cell))
    ordered = sorted(tables.values(), key=_table_order)
    for table in ordered:
        groups = sorted(
            table["policies"].values(), key=lambda group: (group["name"], group["weights_sha256"])
        )
        for group in groups:
            _rank(group["rows"])
        table["policies"] = groups
    return {"schema_version": 1, "protocol": PROTOCOL, "order": ORDER, "tables": ordered}


def render(board: dict[str, Any]) -> str:
    """The board as one HTML page that loads nothing."""
    environment = Environment(
        autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    return environment.from_string(TEMPLATE.read_text(encoding="utf-8")).render(
        board=board, columns=EXPLANATION_METRICS
    )


def _policy(entry: Entry, cell: CellResult) -> dict[str, Any]:
    """Task metrics are the policy's: the same in every row, for all play the same episodes."""
    return {
        "name": entry.policy.name,
        "weights_sha256": entry.policy.weights_sha256,
        "attention_entropy": entry.policy.attention_entropy,
        "training_seed": entry.policy.training_seed,
        "trained_n_agents": entry.policy.n_agents,
        "metrics": cell.metrics.model_dump(mode="json", include=set(POLICY_METRICS)),
        "rows": [],
    }


def _row(file: str, entry: Entry, cell: CellResult) -> dict[str, Any]:
    return {
        "rank": None,
        "explainer": entry.explainer.name,
        "hyperparameters": entry.explainer.hyperparameters,
        "seed": entry.explainer.seed,
        "control": entry.explainer.control,
        "submitter": entry.submitter,
        "verification": entry.verification.status,
        "metrics": cell.metrics.model_dump(mode="json", include=set(EXPLANATION_METRICS)),
        "file": file,
        "entry_id": entry.entry_id,
    }


def _rank(rows: list[dict[str, Any]]) -> None:
    """Sort best first and number all but controls; between equal values the file name decides."""

    def key(row: dict[str, Any]) -> tuple[bool, float, str]:
        value = row["metrics"]["fid_delta"]["value"]
        return value is None, 0.0 if value is None else -value, row["file"]

    rows.sort(key=key)
    rank = 0
    for row in rows:
        if not row["control"] and row["metrics"]["fid_delta"]["value"] is not None:
            rank += 1
            row["rank"] = rank


def _table_order(table: dict[str, Any]) -> tuple[str, int, int, int, bytes]:
    """By cell, then the tables of more episodes first."""
    protocol = table["protocol"]
    timesteps = protocol["timesteps"]
    scope = {key: value for key, value in table.items() if key != "policies"}
    return (
        table["task"],
        table["n_agents"],
        -protocol["episodes"],
        0 if timesteps is None else -timesteps,
        canonical_json(scope),
    )
