"""What entries say of one policy, as the rows of its table: plain JSON, not yet ranked."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any

from xmarl_bench.board.columns import COLUMNS, ORDER, POLICY_METRICS
from xmarl_bench.board.gate import gate_reason
from xmarl_bench.board.ranking import Floats
from xmarl_bench.entry.fresh import headline, worse_on_fresh
from xmarl_bench.entry.mask_digest import mask_digest
from xmarl_bench.entry.metric_records import ControlMetrics, Metrics
from xmarl_bench.entry.partial import partial_reason
from xmarl_bench.entry.schema import CellResult, Entry, ExplainerRecord
from xmarl_bench.entry.training import training_of
from xmarl_bench.records.files import canonical_json

Json = dict[str, Any]
_UNRANKED: Json = {"rank": None, "rank_interval": None, "tie_group": None}
_OF_ENTRIES = (  # None in the rows of controls
    "seed", "submitter", "variants_tried", "verified_by", "wall", "date", "paper", "code", "partial", "masks",
    "fresh", "cost", "not_measured", "entry_id",
)  # fmt: skip


@dataclass
class Group:
    """One policy in one table."""

    file: str  # the first by name, whose entry gives `policy`
    policy: Json
    rows: list[Json] = field(default_factory=list)
    controls: dict[str, Json] = field(default_factory=dict)
    episodes: dict[str, Floats] = field(default_factory=dict)  # file -> (E,) of the order; NaN where null
    explainers: dict[str, bytes] = field(default_factory=dict)  # file -> see `identity_of`

    @property
    def ranked(self) -> list[Json]:
        """The ranked rows: not controls, partial scores, rows of gated policies, and rows without a value."""
        if self.policy["gate"] is not None:
            return []
        return [row for row in self.rows if _is_whole_score(row) and value_of(row) is not None]


def is_whole(policy: Json) -> bool:
    """Whether a table's scores of a policy are whole: a table's are all, or all partial."""
    return any(map(_is_whole_score, policy["rows"]))


def _is_whole_score(row: Json) -> bool:
    return row["partial"] is None and not row["control"]


def value_of(row: Json) -> float | None:
    """The value that rows are ordered by; None if the row has none."""
    summary = row["metrics"].get(ORDER["by"])
    return None if summary is None else summary["value"]


def values_of(rows: Sequence[Json]) -> list[float]:
    """The values of those rows that have one."""
    return [value for row in rows if (value := value_of(row)) is not None]


def newest(rows: Iterable[Json]) -> dict[str, Json]:
    """Explainer or control -> its row. Of several entries of an explainer the newest counts."""
    return {row["explainer"]: row for row in sorted(rows, key=lambda row: (row["date"] or "", row["file"]))}


def policy_record(entry: Entry, cell: CellResult) -> Json:
    """The policy's record. Its task metrics are the same in every row, because all play the same episodes."""
    return {
        "name": entry.policy.name,
        "weights_sha256": entry.policy.weights_sha256,
        "attention_entropy": entry.policy.attention_entropy,
        "architecture": entry.policy.architecture.model_dump(mode="json"),
        "training_seed": entry.policy.training_seed,
        "training": training_of(entry.policy),
        "trained_n_agents": entry.policy.n_agents,
        "oracle_error": None if cell.oracle is None else cell.oracle.error,
        "metrics": _shown(cell.metrics, POLICY_METRICS, entry.protocol.episodes),
        "gate": gate_reason(cell.metrics),
    }


def identity_of(explainer: ExplainerRecord) -> bytes:
    """Equal for one explainer: of an installed package in any version, or of the same file; and for the same
    hyperparameters."""
    installed = explainer.distribution is not None
    code = None if installed else [explainer.entry_point, explainer.code_sha256]
    return canonical_json([explainer.distribution, code, explainer.hyperparameters])


def entry_row(file: str, entry: Entry, k: int) -> Json:
    """Of the k-th cell."""
    cell = entry.results[k]
    return {
        **_UNRANKED,
        "explainer": entry.explainer.name,
        "hyperparameters": entry.explainer.hyperparameters,
        "seed": entry.explainer.seed,
        "control": entry.explainer.control,
        "submitter": entry.submitter,
        "variants_tried": entry.variants_tried,
        "verification": entry.verification.status,
        "verified_by": entry.verification.by,
        "wall": entry.verification.wall,
        "date": entry.provenance.finished[:10],
        "paper": entry.explainer.paper,
        "code": entry.explainer.code,
        "partial": partial_reason(entry.protocol, cell),
        "masks": mask_digest(entry, cell),
        "same_masks_as": [],
        "fresh": _fresh(entry, k),
        "cost": entry.cost.explain_seconds_per_timestep,
        "metrics": _shown(cell.metrics, COLUMNS, entry.protocol.episodes),
        "not_measured": key_of(cell.not_measured),
        "file": file,
        "entry_id": entry.entry_id,
    }


def control_row(file: str, name: str, metrics: ControlMetrics, episodes: int) -> Json:
    """A row for a control in an entry; all entries of a policy contain the same controls."""
    return {
        **_UNRANKED,
        **dict.fromkeys(_OF_ENTRIES),
        "explainer": name,
        "hyperparameters": {},
        "control": True,
        "verification": "",
        "same_masks_as": [],
        "metrics": _shown(metrics, COLUMNS, episodes),
        "file": file,
    }


def _fresh(entry: Entry, k: int) -> Json | None:
    """Public less fresh in the k-th cell; `decides` is the metric that says who does worse."""
    fresh = entry.verification.fresh
    if fresh is None or k >= len(fresh.cells):
        return None
    compared = fresh.cells[k]
    decides = headline(compared)
    return {
        "value": fresh.value,
        "episodes": fresh.episodes,
        "decides": None if decides is None else decides[0],
        "worse": worse_on_fresh(compared),
        "metrics": {name: each.model_dump(mode="json") for name, each in compared.items()},
    }


def _shown(metrics: Metrics | ControlMetrics, names: Iterable[str], episodes: int) -> Json:
    """Metric -> value and interval; also the numbers of values and of NaN, unless every episode has a value.

    Leaves out metrics that were not measured.
    """
    shown = {}
    for name in names:
        summary = getattr(metrics, name, None)
        if summary is not None:
            shown[name] = {"value": summary.value, "interval": summary.interval}
            if (summary.n, summary.n_nan) != (episodes, 0):
                shown[name] |= {"n": summary.n, "n_nan": summary.n_nan}
    return shown


def key_of(value: Json) -> str:
    """Names a part of the board that many rows share."""
    return hashlib.sha256(canonical_json(value)).hexdigest()[:8]
