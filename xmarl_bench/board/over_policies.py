"""Rankings over policies, which are then the units.

Explainers are ranked by the mean of the order, which is normalised for each policy (0 a random ranking, 1 the
best one), unlike the paper's metrics. Policies whose trainings share a start form a cluster. A policy in a
team of another size than in training is ranked in that cell, but not over all cells, where its training run
would count twice.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from xmarl_bench.board.columns import MOST, ORDER, PAPER
from xmarl_bench.board.entry_rows import Group, Json, value_of, values_of
from xmarl_bench.board.ranking import DIGITS, Floats, Place, complete_part, places
from xmarl_bench.explain.control_names import NEAREST, RANDOM
from xmarl_bench.metrics.statistics import interquartile_mean, over_runs, over_units

BEATEN = (RANDOM, NEAREST)  # controls that an explainer has to beat
TIERS = ("", "unverified", "recomputed", "spot-rerun", "re-executed")  # of verification, worst first


def rankings(listed: Sequence[tuple[Json, Sequence[Group]]]) -> list[Json]:
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
    means = [float(np.mean(values_of(rows[name]))) for name in names]
    blocks = [
        np.stack([group.episodes[rows[name][g]["file"]] for name in names]) for g, group in enumerate(groups)
    ]
    trainings = [group.policy["training"] for group in groups]
    found = places(means, blocks, MOST, trainings)
    control_rows = [
        {row["explainer"]: row for row in group.rows if row["control"] and value_of(row) is not None}
        for group in groups
    ]
    ranked = [
        _ranking_row(name, rows[name], False, place)
        | {
            "above": {
                each: _above(rows[name], [c.get(each) for c in control_rows], trainings) for each in BEATEN
            }
        }
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
        "n_trainings": len(set(trainings)),
        "lead": _lead(found, names, blocks, trainings),
        "rows": sorted(
            ranked + unranked + ranked_controls, key=lambda row: (-row["value"], row["explainer"])
        ),
    }  # fmt: skip


def _above(rows: Sequence[Json], controls: Sequence[Json | None], trainings: Sequence[str]) -> Json | None:
    """How far an explainer is above a control: mean over policies of the difference, with its interval.

    Of a single policy, whose entry holds no episodes of controls, the interval is that of the difference of
    two independent means: wider than a paired one. None if a policy lacks the control.
    """
    known = [each for each in controls if each is not None]
    if not rows or len(known) < len(rows):
        return None
    difference = np.array(values_of(rows)) - np.array(values_of(known))
    value = round(float(difference.mean()), DIGITS)
    if len(rows) > 1:
        units = np.round(difference, DIGITS)[:, None]
        found = over_runs(list(units), list(np.zeros_like(units)), clusters=trainings)
        return {"difference": value, "interval": None if found.interval is None else list(found.interval)}
    intervals = [each["metrics"][ORDER["by"]]["interval"] for each in (rows[0], known[0])]
    if None in intervals:
        return {"difference": value, "interval": None}
    half = math.hypot(*((high - low) / 2 for low, high in intervals))
    return {"difference": value, "interval": [value - half, value + half]}


def _lead(
    found: Sequence[Place], names: Sequence[str], blocks: Sequence[Floats], trainings: Sequence[str]
) -> Json | None:
    """The first explainer's lead over the best one that differs from it significantly; None without one."""
    order = sorted(range(len(names)), key=lambda r: (found[r].rank, names[r]))
    beaten = [r for r in order if found[r].tie_group != 1]
    if not beaten:
        return None
    first, second = ([block[r] for block in blocks] for r in (order[0], beaten[0]))
    lead = over_units(first, second, clusters=trainings)
    return {"over": names[beaten[0]], "difference": lead.value, "interval": lead.interval}


def _ranking_row(name: str, rows: Sequence[Json], control: bool, place: Place | None = None) -> Json:
    values = np.round(values_of(rows), DIGITS)
    return {
        "explainer": name,
        "control": control,
        "rank": None if place is None else place.rank,
        "rank_interval": None if place is None else place.rank_interval,
        "tie_group": None if place is None else place.tie_group,
        "value": round(float(np.mean(values_of(rows))), DIGITS),
        "iqm": round(interquartile_mean(values), DIGITS),
        "values": values.tolist(),
        "interval": None if place is None else place.interval,
        "n_policies": len(rows),
        "cost": None if None in (costs := [row["cost"] for row in rows]) else float(np.mean(costs)),
        "submitters": sorted({row["submitter"] or "" for row in rows}),
        "verification": min((row["verification"] for row in rows), key=TIERS.index),
        "means": {metric: _mean(rows, metric) for metric in PAPER},
    }


def _mean(rows: Sequence[Json], metric: str) -> float | None:
    """Mean over rows; None if one has no number."""
    summaries = [row["metrics"].get(metric) for row in rows]
    values = [s["value"] for s in summaries if s is not None and s["value"] is not None]
    return float(np.mean(values)) if len(values) == len(rows) else None
