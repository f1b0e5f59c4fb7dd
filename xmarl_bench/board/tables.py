"""From entries to the board: tables per cell and protocol, ranked within a policy; rankings over policies.

Entries share a table only if protocol, cell and the method of the oracle are identical: enumerated and
sampled oracles are never mixed. A policy in a team of another size than in training is ranked in that cell,
but not over all cells, where its training run would count twice. Within a policy, rows are ranked by paired
episodes. Over policies, which are then the units, explainers are ranked by the mean of the order, which is
normalised for each policy (0 a random ranking, 1 the best one), unlike the paper's metrics.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from xmarl_bench.board.columns import COLUMNS, ORDER, PAPER, POLICY_METRICS
from xmarl_bench.board.gate import gate_reason
from xmarl_bench.board.ranking import DIGITS, Floats, Place, complete_part, places
from xmarl_bench.entry.fresh import headline, worse_on_fresh
from xmarl_bench.entry.mask_digest import mask_digest
from xmarl_bench.entry.partial import partial_reason
from xmarl_bench.entry.protocol import PROTOCOL
from xmarl_bench.entry.schema import CellResult, ControlMetrics, Entry, Metrics
from xmarl_bench.explain.control_names import INVERTED, NEAREST, RANDOM
from xmarl_bench.metrics.statistics import (
    interquartile_mean,
    over_units,
    student_interval,
)
from xmarl_bench.metrics.table import by_name
from xmarl_bench.records.field_types import rounded
from xmarl_bench.records.files import canonical_json

SCHEMA_VERSION = 5
MOST = by_name()[ORDER["by"]].range.high or math.inf
BEATEN = (RANDOM, NEAREST)  # controls that an explainer has to beat
TIERS = ("", "unverified", "recomputed", "spot-rerun", "re-executed")  # of verification, worst first
Json = dict[str, Any]


@dataclass
class Group:
    """One policy in one table."""

    file: str  # the first by name, whose entry gives `policy`
    policy: Json
    rows: list[Json] = field(default_factory=list)
    controls: dict[str, Json] = field(default_factory=dict)
    episodes: dict[str, Floats] = field(default_factory=dict)  # file -> (E,) of the order; NaN where null

    @property
    def ranked(self) -> list[Json]:
        """The ranked rows: not controls, partial scores, rows of gated policies, and rows without a value."""
        if self.policy["gate"] is not None:
            return []
        whole = [row for row in self.rows if row["partial"] is None and not row["control"]]
        return [row for row in whole if value_of(row) is not None]


def board_of(entries: Iterable[tuple[str, Entry]]) -> Json:
    """(file, entry) pairs -> the board as JSON. Their order does not matter, and no entry stays in memory."""
    protocols: dict[str, Json] = {}
    reasons: dict[str, dict[str, str]] = {}
    scopes: dict[bytes, Json] = {}
    grouped: dict[bytes, dict[tuple[str, str], Group]] = {}
    for file, entry in entries:
        protocol = entry.protocol.model_dump(mode="json")
        key = _key(protocol)
        protocols[key] = protocol
        for k, cell in enumerate(entry.results):
            scope = {
                "task": cell.task,
                "n_agents": cell.n_agents,
                "max_cycles": cell.max_cycles,
                "protocol": key,
                "oracle": cell.oracle_kind,
            }
            groups = grouped.setdefault(canonical_json(scope), {})
            scopes[canonical_json(scope)] = scope
            group = groups.setdefault(
                (entry.policy.name, entry.policy.weights_sha256), Group(file, _policy(entry, cell))
            )
            if file < group.file:
                group.file, group.policy = file, _policy(entry, cell)
            group.rows.append(_row(file, entry, k))
            reasons[_key(cell.not_measured)] = cell.not_measured
            group.episodes[file] = np.array(
                [getattr(row, ORDER["by"]) for row in cell.episodes], dtype=np.float64
            )
            for name, metrics in cell.controls.items():
                known = group.controls.get(name)
                if name != INVERTED and (known is None or file < known["file"]):  # the explainer's own
                    group.controls[name] = _control_row(file, name, metrics, entry.protocol.episodes)
    listed = sorted(
        ((scopes[key], [group for _, group in sorted(groups.items())]) for key, groups in grouped.items()),
        key=lambda pair: _table_order(pair[0], protocols[pair[0]["protocol"]]),
    )
    for _, table in listed:
        for group in table:
            _finish(group)
    return {
        "schema_version": SCHEMA_VERSION,
        "protocol": PROTOCOL,
        "order": ORDER,
        "protocols": protocols,
        "not_measured": reasons,
        "rankings": rounded(_rankings(listed)),
        "tables": [
            {**scope, "policies": [{**group.policy, "rows": group.rows} for group in table]}
            for scope, table in listed
        ],
    }


def value_of(row: Json) -> float | None:
    """The value that rows are ordered by; None if the row has none."""
    summary = row["metrics"].get(ORDER["by"])
    return None if summary is None else summary["value"]


def _policy(entry: Entry, cell: CellResult) -> Json:
    """The policy's record. Its task metrics are the same in every row, because all play the same episodes."""
    return {
        "name": entry.policy.name,
        "weights_sha256": entry.policy.weights_sha256,
        "attention_entropy": entry.policy.attention_entropy,
        "architecture": entry.policy.architecture.model_dump(mode="json"),
        "training_seed": entry.policy.training_seed,
        "trained_n_agents": entry.policy.n_agents,
        "oracle_error": None if cell.oracle is None else cell.oracle.error,
        "metrics": _shown(cell.metrics, POLICY_METRICS, entry.protocol.episodes),
        "gate": gate_reason(cell.metrics),
    }


def _row(file: str, entry: Entry, k: int) -> Json:
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
        "not_measured": _key(cell.not_measured),
        "file": file,
        "entry_id": entry.entry_id,
    }


def _control_row(file: str, name: str, metrics: ControlMetrics, episodes: int) -> Json:
    """A row for a control in an entry; all entries of a policy contain the same controls."""
    return {
        **_UNRANKED,
        "explainer": name,
        "hyperparameters": {},
        "seed": None,
        "control": True,
        "submitter": None,
        "variants_tried": None,
        "verification": "",
        **dict.fromkeys(("verified_by", "wall", "date", "paper", "code", "partial", "masks")),
        "same_masks_as": [],
        "fresh": None,
        "cost": None,
        "metrics": _shown(metrics, COLUMNS, episodes),
        "not_measured": None,
        "file": file,
        "entry_id": None,
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


_UNRANKED: Json = {"rank": None, "rank_interval": None, "tie_group": None}


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


def _key(value: Json) -> str:
    """Names a part of the board that many rows share."""
    return hashlib.sha256(canonical_json(value)).hexdigest()[:8]


def _finish(group: Group) -> None:
    """Add the controls without an entry of their own, sort best first, and rank."""
    scored = {row["explainer"] for row in group.rows}
    group.rows += [row for name, row in group.controls.items() if name not in scored]

    def key(row: Json) -> tuple[bool, float, str, str]:
        by = value_of(row)
        return by is None, 0.0 if by is None else -round(by, DIGITS), row["file"], row["explainer"]

    group.rows.sort(key=key)
    for row in group.rows:
        row["same_masks_as"] = [
            {"explainer": other["explainer"], "submitter": other["submitter"]}
            for other in group.rows
            if row["masks"] is not None
            and row["masks"] == other["masks"]
            and row["submitter"] != other["submitter"]
        ]
    rows = group.ranked
    if not rows:
        return
    episodes = np.stack([group.episodes[row["file"]] for row in rows])
    for row, place in zip(rows, places(_values(rows), [episodes], MOST), strict=True):
        row |= {"rank": place.rank, "rank_interval": place.rank_interval, "tie_group": place.tie_group}


def _rankings(listed: Sequence[tuple[Json, Sequence[Group]]]) -> list[Json]:
    """Rankings of each protocol and method of the oracle: over all tables, of each task, and of each cell.

    Those over several cells are over policies in teams of the size that they were trained for.
    """
    scoped: dict[tuple[str, str, str | None, int | None], list[tuple[Json, Group]]] = {}
    for scope, groups in listed:
        table, cell = (scope["protocol"], scope["oracle"]), (scope["task"], scope["n_agents"])
        for group in groups:
            if not group.ranked:
                continue
            if group.policy["trained_n_agents"] == scope["n_agents"]:
                scoped.setdefault((*table, None, None), []).append((scope, group))
                scoped.setdefault((*table, scope["task"], None), []).append((scope, group))
            scoped.setdefault((*table, *cell), []).append((scope, group))
    return [
        {"protocol": protocol, "oracle": oracle, "task": task, "n_agents": n_agents, **_ranking(pairs)}
        for (protocol, oracle, task, n_agents), pairs in scoped.items()
    ]


def _ranking(pairs: Sequence[tuple[Json, Group]]) -> Json:
    """Explainers by their mean over the policies that they were all scored on."""
    by_name = [{row["explainer"]: row for row in reversed(group.ranked)} for _, group in pairs]
    chosen, names = complete_part({k: sorted(rows) for k, rows in enumerate(by_name)})
    groups = [pairs[k][1] for k in chosen]
    rows = {name: [by_name[k][name] for k in chosen] for name in names}
    means = [float(np.mean(_values(rows[name]))) for name in names]
    blocks = [
        np.stack([group.episodes[rows[name][g]["file"]] for name in names]) for g, group in enumerate(groups)
    ]
    found = places(means, blocks, MOST)
    control_rows = [
        {row["explainer"]: row for row in group.rows if row["control"] and value_of(row) is not None}
        for group in groups
    ]
    ranked = [
        _ranking_row(name, rows[name], False, place)
        | {"above": {each: _above(rows[name], [c.get(each) for c in control_rows]) for each in BEATEN}}
        for name, place in zip(names, found, strict=True)
    ]
    partial = sorted({name for each in by_name for name in each} - set(names))
    unranked = [
        _ranking_row(name, [each[name] for each in by_name if name in each], False)
        | {"reason": f"scored on {sum(name in each for each in by_name)} of {len(by_name)} policies"}
        for name in partial
    ]
    _, controls = complete_part({k: list(each) for k, each in enumerate(control_rows)})
    ranked_controls = [
        _ranking_row(name, [each[name] for each in control_rows if name in each], True) for name in controls
    ]
    return {
        "policies": [
            {"name": pairs[k][1].policy["name"], "task": pairs[k][0]["task"],
             "n_agents": pairs[k][0]["n_agents"], "trained_n_agents": pairs[k][1].policy["trained_n_agents"]}
            for k in chosen
        ],
        "lead": _lead(found, names, blocks),
        "rows": sorted(
            ranked + unranked + ranked_controls, key=lambda row: (-row["value"], row["explainer"])
        ),
    }  # fmt: skip


def _above(rows: Sequence[Json], controls: Sequence[Json | None]) -> Json | None:
    """How far an explainer is above a control: mean over policies of the difference, with its interval.

    Of a single policy, whose entry holds no episodes of controls, the interval is that of the difference of
    two independent means: wider than a paired one. None if a policy lacks the control.
    """
    known = [each for each in controls if each is not None]
    if not rows or len(known) < len(rows):
        return None
    difference = np.array(_values(rows)) - np.array(_values(known))
    value = round(float(difference.mean()), DIGITS)
    if len(rows) > 1:
        low, high = student_interval(np.round(difference, DIGITS))
        return {"difference": value, "interval": [float(low), float(high)]}
    intervals = [each["metrics"][ORDER["by"]]["interval"] for each in (rows[0], known[0])]
    if None in intervals:
        return {"difference": value, "interval": None}
    half = math.hypot(*((high - low) / 2 for low, high in intervals))
    return {"difference": value, "interval": [value - half, value + half]}


def _lead(found: Sequence[Place], names: Sequence[str], blocks: Sequence[Floats]) -> Json | None:
    """The first explainer's lead over the best one that differs from it significantly; None without one."""
    order = sorted(range(len(names)), key=lambda r: (found[r].rank, names[r]))
    beaten = [r for r in order if found[r].tie_group != 1]
    if not beaten:
        return None
    first, second = ([block[r] for block in blocks] for r in (order[0], beaten[0]))
    lead = over_units(first, second)
    return {"over": names[beaten[0]], "difference": lead.value, "interval": lead.interval}


def _ranking_row(name: str, rows: Sequence[Json], control: bool, place: Place | None = None) -> Json:
    values = np.round(_values(rows), DIGITS)
    return {
        "explainer": name,
        "control": control,
        "rank": None if place is None else place.rank,
        "rank_interval": None if place is None else place.rank_interval,
        "tie_group": None if place is None else place.tie_group,
        "value": round(float(np.mean(_values(rows))), DIGITS),
        "iqm": round(interquartile_mean(values), DIGITS),
        "values": values.tolist(),
        "interval": None if place is None else place.interval,
        "n_policies": len(rows),
        "cost": None if None in (costs := [row["cost"] for row in rows]) else float(np.mean(costs)),
        "submitters": sorted({row["submitter"] or "" for row in rows}),
        "verification": min((row["verification"] for row in rows), key=TIERS.index),
        "means": {metric: _mean(rows, metric) for metric in PAPER},
    }


def _values(rows: Sequence[Json]) -> list[float]:
    return [value for row in rows if (value := value_of(row)) is not None]


def _mean(rows: Sequence[Json], metric: str) -> float | None:
    """Mean over rows; None if one has no number."""
    summaries = [row["metrics"].get(metric) for row in rows]
    values = [s["value"] for s in summaries if s is not None and s["value"] is not None]
    return float(np.mean(values)) if len(values) == len(rows) else None


def _table_order(scope: Json, protocol: Json) -> tuple[bool, str, int, int, int, bytes]:
    """Order tables: enumerated oracles first, then by cell, then more episodes first."""
    timesteps = protocol["timesteps"]
    return (
        scope["oracle"] == "sampled",
        scope["task"],
        scope["n_agents"],
        -protocol["episodes"],
        0 if timesteps is None else -timesteps,
        canonical_json(scope),
    )
