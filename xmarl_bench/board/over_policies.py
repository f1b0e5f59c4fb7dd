"""Rankings over policies, which are then the units.

Explainers are ranked by the mean of the order, which is normalised for each policy (0 a random ranking, 1 the
best one), unlike the paper's metrics. Cells weigh the same, however many policies they have, and policies
whose trainings share a start form a cluster. A policy in a team of another size than in training is ranked in
that cell, but not over all cells, where its training run would count twice.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, fields
from functools import partial

import numpy as np
from numpy.typing import ArrayLike

from xmarl_bench.board.columns import MOST, ORDER, PAPER
from xmarl_bench.board.entry_rows import Group, Json, newest, value_of, values_of
from xmarl_bench.board.ranking import DIGITS, Floats, Place, complete_part, places
from xmarl_bench.explain.control_names import NEAREST, RANDOM
from xmarl_bench.metrics.statistics import interquartile_mean, over_units
from xmarl_bench.metrics.student import Design, interval_of, mean_of

Scored = tuple[Json, Group]  # the scope of a table, and a policy in it
BEATEN = (RANDOM, NEAREST)  # controls that an explainer has to beat
TIERS = ("", "unverified", "recomputed", "spot-rerun", "re-executed")  # of verification, worst first


def rankings(listed: Sequence[tuple[Json, Sequence[Group]]]) -> list[Json]:
    """Rankings of each protocol and method of the oracle: over all tables, of each task, and of each cell.

    Those over several cells are over policies in teams of the size that they were trained for.
    """
    scoped: dict[tuple[str, str, str | None, int | None], list[Scored]] = {}
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


def _ranking(pairs: Sequence[Scored]) -> Json:
    """Explainers by their mean over the policies that they were all scored on."""
    by_name = _by_name(pairs)
    chosen, names = complete_part({k: sorted(rows) for k, rows in enumerate(by_name)})
    compared = [pairs[k] for k in chosen]
    design = _design(compared)
    rows = {name: [by_name[k][name] for k in chosen] for name in names}
    means = [_mean(values_of(rows[name]), design) for name in names]
    blocks = [
        np.stack([group.episodes[rows[name][g]["file"]] for name in names])
        for g, (_, group) in enumerate(compared)
    ]
    found = places(means, blocks, MOST, design)
    control_rows = [
        {row["explainer"]: row for row in group.rows if row["control"] and value_of(row) is not None}
        for _, group in compared
    ]
    ranked = [
        _ranking_row(name, rows[name], compared, place)
        | {"above": {c: _above(rows[name], [of.get(c) for of in control_rows], design) for c in BEATEN}}
        for name, place in zip(names, found, strict=True)
    ]
    missing = sorted({name for each in by_name for name in each} - set(names))
    unranked = [
        _row_where(name, by_name, pairs)
        | {"reason": f"scored on {sum(name in each for each in by_name)} of {len(by_name)} policies"}
        for name in missing
    ]
    _, controls = complete_part({k: list(each) for k, each in enumerate(control_rows)})
    ranked_controls = [_row_where(name, control_rows, compared) for name in controls]
    return {
        "policies": [
            {"name": group.policy["name"], "task": scope["task"], "n_agents": scope["n_agents"],
             "trained_n_agents": group.policy["trained_n_agents"]}
            for scope, group in compared
        ],
        "n_cells": len(set(design.cells)),
        "n_trainings": len(set(design.clusters)),
        "lead": _lead(found, names, blocks, design),
        "rows": sorted(
            ranked + unranked + ranked_controls, key=lambda row: (-row["value"], row["explainer"])
        ),
    }  # fmt: skip


def _by_name(pairs: Sequence[Scored]) -> list[dict[str, Json]]:
    """For each policy, the row of each name. Where entries of one name are of other code or hyperparameters,
    those of one explainer count: of the one scored on most policies, then of the newest."""
    scored: dict[str, dict[bytes, list[Json]]] = {}
    for _, group in pairs:
        for row in group.ranked:
            identity = group.explainers[row["file"]]
            scored.setdefault(row["explainer"], {}).setdefault(identity, []).append(row)
    counted = {name: max(each, key=partial(_weight, each)) for name, each in scored.items()}
    return [
        newest(row for row in group.ranked if group.explainers[row["file"]] == counted[row["explainer"]])
        for _, group in pairs
    ]


def _weight(rows: Mapping[bytes, Sequence[Json]], identity: bytes) -> tuple[int, str, bytes]:
    return len(rows[identity]), max(row["date"] for row in rows[identity]), identity


def _design(pairs: Sequence[Scored]) -> Design:
    return Design(
        clusters=tuple(group.policy["training"] for _, group in pairs),
        cells=tuple((scope["task"], scope["n_agents"]) for scope, _ in pairs),
    )


def _above(rows: Sequence[Json], controls: Sequence[Json | None], design: Design) -> Json | None:
    """How far an explainer is above a control: mean over policies of the difference, with its interval.

    Of a single policy, whose entry holds no episodes of controls, the interval is that of the difference of
    two independent means: wider than a paired one. None if a policy lacks the control.
    """
    known = [each for each in controls if each is not None]
    if not rows or len(known) < len(rows):
        return None
    difference = np.round(np.array(values_of(rows)) - np.array(values_of(known)), DIGITS)
    value = round(_mean(difference, design), DIGITS)
    if len(rows) > 1:
        return {"difference": value, "interval": interval_of(difference, design=design)}
    intervals = [each["metrics"][ORDER["by"]]["interval"] for each in (rows[0], known[0])]
    if None in intervals:
        return {"difference": value, "interval": None}
    half = math.hypot(*((high - low) / 2 for low, high in intervals))
    return {"difference": value, "interval": [value - half, value + half]}


def _lead(
    found: Sequence[Place], names: Sequence[str], blocks: Sequence[Floats], design: Design
) -> Json | None:
    """The first explainer's lead over the best one that differs from it significantly; None without one."""
    order = sorted(range(len(names)), key=lambda r: (found[r].rank, names[r]))
    beaten = [r for r in order if not found[r].ties_first]
    if not beaten:
        return None
    first, second = ([block[r] for block in blocks] for r in (order[0], beaten[0]))
    lead = over_units(first, second, design=design)
    return {"over": names[beaten[0]], "difference": lead.value, "interval": lead.interval}


def _row_where(name: str, by_name: Sequence[Mapping[str, Json]], pairs: Sequence[Scored]) -> Json:
    """The row of an explainer over the policies that have it."""
    having = [k for k, each in enumerate(by_name) if name in each]
    return _ranking_row(name, [by_name[k][name] for k in having], [pairs[k] for k in having])


def _ranking_row(
    name: str, rows: Sequence[Json], pairs: Sequence[Scored], place: Place | None = None
) -> Json:
    values, design = np.round(values_of(rows), DIGITS), _design(pairs)
    return {
        "explainer": name,
        "control": rows[0]["control"],
        **(dict.fromkeys(each.name for each in fields(Place)) if place is None else asdict(place)),
        "value": round(_mean(values_of(rows), design), DIGITS),
        "iqm": round(interquartile_mean(values), DIGITS),
        "values": values.tolist(),
        "n_policies": len(rows),
        "cost": None if None in (costs := [row["cost"] for row in rows]) else float(np.mean(costs)),
        "submitters": sorted({row["submitter"] or "" for row in rows}),
        "verification": min((row["verification"] for row in rows), key=TIERS.index),
        "means": {metric: _metric_mean(rows, metric, design) for metric in PAPER},
    }


def _metric_mean(rows: Sequence[Json], metric: str, design: Design) -> float | None:
    """Mean over rows; None if one has no number."""
    summaries = [row["metrics"].get(metric) for row in rows]
    values = [s["value"] for s in summaries if s is not None and s["value"] is not None]
    return _mean(values, design) if len(values) == len(rows) else None


def _mean(values: ArrayLike, design: Design) -> float:
    return float(mean_of(np.asarray(values, dtype=np.float64), design))
