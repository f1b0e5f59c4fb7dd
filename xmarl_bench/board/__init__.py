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

from xmarl_bench.controls import INVERTED
from xmarl_bench.entry import CellResult, ControlMetrics, Entry, Metrics, read_entries
from xmarl_bench.files import canonical_json, write_atomically, write_json
from xmarl_bench.protocol import PROTOCOL

ORDER = {
    "by": "comm_budgeted_fidelity",
    "direction": "descending",
    "controls": "shown in place, not ranked",
    "note": "Communication-only budgeted fidelity: 0 is a random ranking of the messages, 1 the best one. "
    "FidDelta alone can be gamed: the mask of ones, a control, attains most of it.",
}
# A team that fails has nothing worth explaining, and one that hardly listens makes every explanation of its
# messages trivially faithful. The dependence is 1 % of the range of an action, [-1, 1].
GATE = {"success_rate": 0.5, "communication_dependence": 0.02}
COLUMNS = {
    "comm_budgeted_fidelity": "comm. budgeted fidelity \u2191",
    "budgeted_fidelity": "budgeted fidelity \u2191",
    "fid_plus": "Fid+ \u2191",
    "fid_minus": "Fid\u2212 \u2193",
    "fid_delta": "FidDelta \u2191",
    "gef": "GEF \u2193",
    "median_kl": "median KL \u2193",
    "mask_mass": "mask mass",
    "comm_fid_delta": "comm. FidDelta \u2191",
    "comm_gef": "comm. GEF \u2193",
    "renorm_budgeted_fidelity": "renorm. budgeted fidelity \u2191",
    "success_on_explanation": "success on explanation \u2191",
    "success_on_complement": "on complement \u2193",
    "seed_stability": "seed stability \u2191",
    "weight_randomisation": "shuffled weights \u2193",
}
UNSHOWN = ("reward_on_explanation", "reward_on_complement", "behavioural_fidelity", "topk_fid_delta",
           "comm_fid_plus", "comm_fid_minus", "comm_topk_fid_delta", "renorm_topk_fid_delta")  # fmt: skip
POLICY_METRICS = (
    "success_rate", "no_agent_collision", "no_object_collision", "makespan", "reward",
    "communication_dependence", "attention_entropy", "attention_distance",
)  # fmt: skip
TEMPLATE = Path(__file__).with_name("templates") / "index.html.jinja"


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
            for name, metrics in cell.controls.items():
                if name != INVERTED:  # of this explainer alone: read it in the entry
                    group["controls"].setdefault(name, _control_row(file, name, metrics))
    ordered = sorted(tables.values(), key=_table_order)
    for table in ordered:
        groups = sorted(
            table["policies"].values(), key=lambda group: (group["name"], group["weights_sha256"])
        )
        for group in groups:
            scored = {row["explainer"] for row in group["rows"]}
            controls = group.pop("controls")
            group["rows"] += [row for name, row in controls.items() if name not in scored]
            _rank(group["rows"], ranked=group["gate"] is None)
        table["policies"] = groups
    return {"schema_version": 2, "protocol": PROTOCOL, "order": ORDER, "gate": GATE, "tables": ordered}


def render(board: dict[str, Any]) -> str:
    """The board as one HTML page that loads nothing."""
    environment = Environment(
        autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    return environment.from_string(TEMPLATE.read_text(encoding="utf-8")).render(board=board, columns=COLUMNS)


def _policy(entry: Entry, cell: CellResult) -> dict[str, Any]:
    """Task metrics are the policy's: the same in every row, for all play the same episodes."""
    return {
        "name": entry.policy.name,
        "weights_sha256": entry.policy.weights_sha256,
        "attention_entropy": entry.policy.attention_entropy,
        "training_seed": entry.policy.training_seed,
        "trained_n_agents": entry.policy.n_agents,
        "metrics": cell.metrics.model_dump(mode="json", include=set(POLICY_METRICS)),
        "gate": _gate(cell.metrics),
        "rows": [],
        "controls": {},
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
        "metrics": _shown(cell.metrics),
        "not_measured": cell.not_measured,
        "file": file,
        "entry_id": entry.entry_id,
    }


def _control_row(file: str, name: str, metrics: ControlMetrics) -> dict[str, Any]:
    """A control that an entry carries; every entry of the policy carries the same."""
    return {
        "rank": None,
        "explainer": name,
        "hyperparameters": {},
        "seed": None,
        "control": True,
        "submitter": None,
        "verification": "",
        "metrics": _shown(metrics),
        "not_measured": {},
        "file": file,
        "entry_id": None,
    }


def _shown(metrics: Metrics | ControlMetrics) -> dict[str, Any]:
    dumped = metrics.model_dump(mode="json")
    return {name: dumped.get(name) for name in (*COLUMNS, *UNSHOWN)}


def _gate(metrics: Metrics) -> str | None:
    """Why the policy's rows are not ranked; None where they are."""
    for name, least in GATE.items():
        value = getattr(metrics, name).value
        if value is None or value < least:
            shown = "not a number" if value is None else f"{value:.3f}"
            return f"{name.replace('_', ' ')} {shown}, under {least:g}"
    return None


def _rank(rows: list[dict[str, Any]], *, ranked: bool) -> None:
    """Sort best first and number all but controls; between equal values file and name decide."""

    def value(row: dict[str, Any]) -> float | None:
        summary = row["metrics"][ORDER["by"]]
        return None if summary is None else summary["value"]

    def key(row: dict[str, Any]) -> tuple[bool, float, str, str]:
        by = value(row)
        return by is None, 0.0 if by is None else -by, row["file"], row["explainer"]

    rows.sort(key=key)
    rank = 0
    for row in rows:
        if ranked and not row["control"] and value(row) is not None:
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
