"""From entries to the board: tables per cell and protocol, ranked within a policy; rankings over policies.

Entries share a table only if protocol, cell and the method of the oracle are identical: enumerated and
sampled oracles are never mixed. Within a policy, rows are ranked by paired episodes.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from xmarl_bench.board.columns import MOST, ORDER
from xmarl_bench.board.entry_rows import (
    Group,
    Json,
    control_row,
    entry_row,
    identity_of,
    key_of,
    policy_record,
    value_of,
    values_of,
)
from xmarl_bench.board.over_policies import rankings
from xmarl_bench.board.ranking import DIGITS, places
from xmarl_bench.entry.protocol import PROTOCOL
from xmarl_bench.entry.schema import Entry
from xmarl_bench.explain.control_names import INVERTED
from xmarl_bench.records.field_types import rounded
from xmarl_bench.records.files import canonical_json

SCHEMA_VERSION = 6


def board_of(entries: Iterable[tuple[str, Entry]]) -> Json:
    """(file, entry) pairs -> the board as JSON. Their order does not matter, and no entry stays in memory."""
    protocols: dict[str, Json] = {}
    reasons: dict[str, dict[str, str]] = {}
    scopes: dict[bytes, Json] = {}
    grouped: dict[bytes, dict[tuple[str, str], Group]] = {}
    for file, entry in entries:
        protocol = entry.protocol.model_dump(mode="json")
        key = key_of(protocol)
        protocols[key] = protocol
        for k, cell in enumerate(entry.results):
            scope = {
                "task": cell.task,
                "n_agents": cell.n_agents,
                "max_cycles": cell.max_cycles,
                "protocol": key,
                "oracle": cell.oracle_kind,
            }
            place = canonical_json(scope)
            groups, scopes[place] = grouped.setdefault(place, {}), scope
            name = entry.policy.name, entry.policy.weights_sha256
            if name not in groups:
                groups[name] = Group(file, policy_record(entry, cell))
            group = groups[name]
            if file < group.file:
                group.file, group.policy = file, policy_record(entry, cell)
            group.rows.append(entry_row(file, entry, k))
            group.explainers[file] = identity_of(entry.explainer)
            reasons[key_of(cell.not_measured)] = cell.not_measured
            group.episodes[file] = np.array(
                [getattr(row, ORDER["by"]) for row in cell.episodes], dtype=np.float64
            )
            for control, metrics in cell.controls.items():
                known = group.controls.get(control)
                if control != INVERTED and (known is None or file < known["file"]):  # the explainer's own
                    group.controls[control] = control_row(file, control, metrics, entry.protocol.episodes)
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
        "rankings": rounded(rankings(listed)),
        "tables": [
            {**scope, "policies": [{**group.policy, "rows": group.rows} for group in table]}
            for scope, table in listed
        ],
    }


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
    for row, place in zip(rows, places(values_of(rows), [episodes], MOST), strict=True):
        row |= {"rank": place.rank, "rank_interval": place.rank_interval, "tie_group": place.tie_group}


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
