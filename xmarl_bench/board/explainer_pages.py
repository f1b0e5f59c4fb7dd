"""The page of each explainer, and the page with and without attention-entropy regularisation."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np

from xmarl_bench.board.charts import axis_of, half_density
from xmarl_bench.board.columns import BY_EPISODE
from xmarl_bench.board.details import Details
from xmarl_bench.board.regulariser import SIDES, families_of, regulariser_of, score_of, values_of
from xmarl_bench.board.views import Scope, ranking_of, scopes_of

MISSED = 0.9  # AUROC under which planted truth counts as missed: 0.5 is chance, 1 all of it
Json = dict[str, Any]


def explainers_of(board: Json, details: Mapping[str, Details], cards: Json) -> dict[str, Json]:
    """Name -> what its page shows. Controls have none."""
    found: dict[str, Json] = {}
    scopes = [scope for view in scopes_of(board) for scope in view]
    for table in board["tables"]:
        for policy in table["policies"]:
            for row in policy["rows"]:
                if row["control"]:
                    continue
                scope = (table["task"], table["n_agents"], table["max_cycles"])
                of = found.setdefault(
                    row["explainer"],
                    {
                        "rows": [],
                        "record": details[row["file"]][scope]["explainer"],
                        "card": cards.get(row["explainer"]),
                    },
                )
                of["rows"].append({"table": table, "policy": policy, "row": row})
    terms = regulariser_of(families_of(_tables(board, scopes[0]))) if scopes else {}
    for name, each in found.items():
        each["rankings"] = [(s, r) for s in scopes if _ranks(r := ranking_of(board, s), name)]
        each["term"] = terms.get(name)
        planted = (each["card"] or {}).get("planted") or {}
        each["missed"] = sorted((value, family) for family, value in planted.items() if value < MISSED)
    return dict(sorted(found.items()))


def term_page(board: Json, scope: Scope, details: Mapping[str, Details]) -> Json:
    """What the term does to each explainer, and the densities of episodes by family, explainer and metric."""
    pages = []
    families = families_of(_tables(board, scope))
    term = regulariser_of(families)
    for family in families:
        names = [name for name in term if values_of([family], partial(score_of, explainer=name))]
        columns = []
        for metric in BY_EPISODE:
            samples = {
                (name, side): _episodes(family, name, side, metric, details)
                for name in names
                for side in SIDES
            }
            axis = axis_of([x for each in samples.values() for x in each], around=(0.0,))
            cells = {
                name: [_half(samples[name, side], axis, k) for k, side in enumerate(SIDES)] for name in names
            }
            columns.append({"metric": metric, "axis": axis, "cells": cells})
        pages.append({**family, "names": names, "columns": columns})
    return {"term": term, "families": pages}


def _half(values: list[float], axis: Any, side: int) -> Json | None:
    if not values:
        return None
    return {"points": half_density(values, axis, 1 - 2 * side), "middle": axis.at(float(np.median(values))),
            "mean": float(np.mean(values))}  # fmt: skip


def _episodes(family: Json, name: str, side: str, metric: str, details: Mapping[str, Details]) -> list[float]:
    """Of an explainer on the policies of a side, in all pairs that have scores of it on both."""
    values = []
    for pair in family["pairs"]:
        rows = {
            each: [row for policy in pair[each] for row in policy["rows"] if row["explainer"] == name]
            for each in SIDES
        }
        if not all(rows.values()):
            continue
        for row in rows[side]:
            for (task, n_agents, _), each in details[row["file"]].items():
                if (task, n_agents) == (family["task"], family["n_agents"]):
                    values += [x for x in each["episodes"].get(metric, ()) if x is not None]
    return values


def _ranks(ranking: Json, name: str) -> bool:
    return any(row["explainer"] == name for row in ranking["rows"])


def _tables(board: Json, scope: Scope) -> list[Json]:
    return [table for table in board["tables"] if scope.holds(table)]
