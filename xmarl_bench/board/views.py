"""The pages of rankings: one for every set of scores measured alike, for each of its tasks, and each cell.

A view is a protocol with a method of the oracle: only scores of one view are compared. The first view's page
over all tasks is `index.html`; all others are in `pages/`, under names that do not change.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from xmarl_bench.board.agreement import rank_agreement, scores_of_board
from xmarl_bench.board.answer import gamed_by, number
from xmarl_bench.board.charts import axis_of, line, steps
from xmarl_bench.board.columns import COMPARED, GAMED, ORDER, title_of
from xmarl_bench.board.details import Details
from xmarl_bench.board.regulariser import families_of, regulariser_of
from xmarl_bench.board.robustness import answer_by
from xmarl_bench.board.scores import Scores
from xmarl_bench.explain.control_names import MESSAGES_ONLY, NEAREST, RANDOM
from xmarl_bench.metrics.performance_profile import performance_profile

TEAM_SHOWN_FIRST = 5
Json = dict[str, Any]


@dataclass(frozen=True)
class Scope:
    """What a page of rankings covers: a view, or a task of it, or a cell."""

    view: int  # its place on the board
    protocol: str
    oracle: str
    task: str | None = None
    n_agents: int | None = None

    @property
    def path(self) -> str:
        if (self.view, self.task) == (0, None):
            return "index.html"
        parts = ["ranking", *([f"{self.protocol}-{self.oracle}"] if self.view else [])]
        parts += [self.task] if self.task else []
        return f"pages/{'-'.join([*parts, *([f'n{self.n_agents}'] if self.n_agents else [])])}.html"

    @property
    def title(self) -> str:
        if self.task is None:
            return "all tasks"
        return short_task(self.task) + (f", {self.n_agents} agents" if self.n_agents else "")

    def holds(self, table: Json) -> bool:
        """Whether a table, or a ranking of one cell, belongs to this scope."""
        return (
            (table["protocol"], table["oracle"]) == (self.protocol, self.oracle)
            and self.task in (None, table["task"])
            and self.n_agents in (None, table["n_agents"])
        )


def scopes_of(board: Json) -> list[list[Scope]]:
    """The scopes of each view: all tasks, then each task, then each cell."""
    views = dict.fromkeys((table["protocol"], table["oracle"]) for table in board["tables"])
    scopes = []
    for v, (protocol, oracle) in enumerate(views):
        whole = Scope(v, protocol, oracle)
        cells = sorted({(t["task"], t["n_agents"]) for t in board["tables"] if whole.holds(t)})
        tasks = dict.fromkeys(task for task, _ in cells)
        scopes.append(
            [whole, *(Scope(v, protocol, oracle, task) for task in tasks),
             *(Scope(v, protocol, oracle, *cell) for cell in cells)]
        )  # fmt: skip
    return scopes


def ranking_of(board: Json, scope: Scope) -> Json:
    """The ranking of a scope; an empty one if nothing is ranked there."""
    wanted = (scope.protocol, scope.oracle, scope.task, scope.n_agents)
    keys = ("protocol", "oracle", "task", "n_agents")
    scope_of: Json = dict(zip(keys, wanted, strict=True))
    nothing: Json = {**scope_of, "rows": [], "policies": [], "n_cells": 0, "n_trainings": 0, "lead": None}
    return next((r for r in board["rankings"] if tuple(r[key] for key in keys) == wanted), nothing)


def context_of(
    board: Json, scope: Scope, scopes: Sequence[Scope], details: Mapping[str, Details], cards: Json
) -> Json:
    """What the page of a scope shows. scopes: all of its view."""
    ranking = ranking_of(board, scope)
    tables = [table for table in board["tables"] if scope.holds(table)]
    rows = ranking["rows"]
    ranked = [row for row in rows if row["rank"] is not None]
    return {
        "scope": scope,
        "answer": answer_by(Scores.of(board, ranking)),
        "n_policies": len(ranking["policies"]),
        "n_cells": ranking["n_cells"],
        "n_trainings": ranking["n_trainings"],
        "groups": [
            ("", ranked),
            ("not ranked", [row for row in rows if row["rank"] is None and not row["control"]]),
            ("controls", [row for row in rows if row["control"]]),
        ],
        "gated": [
            {"name": policy["name"], "gate": policy["gate"]}
            for table in tables
            for policy in table["policies"]
            if policy["gate"] is not None
        ],
        "forest": forest_of(rows),
        "heatmap": None if scope.n_agents else heatmap_of(board, scope, scopes, rows),
        "gamed": gamed_by(rows),
        "scatter": scatter_of(rows) if ranked else None,
        "profile": profile_of(ranked) if ranked else None,
        "budgets": budgets_of(tables, scope, details),
        "questions": questions_of(rows, cards),
        "agreement": None if scope.task else agreement_of(tables),
        "term": regulariser_of(families_of(tables)),
    }


def forest_of(rows: Sequence[Json]) -> Json | None:
    """The axis on which the page draws the rows' values: 0 is random, 1 the best ranking."""
    if not rows:
        return None
    ends = [end for row in rows for end in (row["interval"] or ())]
    axis = axis_of([*(row["value"] for row in rows), *ends], around=(0.0, 1.0))
    nearest = next((row["value"] for row in rows if row["explainer"] == NEAREST), None)
    return {"axis": axis, "nearest": None if nearest is None else axis.at(nearest)}


def heatmap_of(board: Json, scope: Scope, scopes: Sequence[Scope], rows: Sequence[Json]) -> Json:
    """Values of each explainer in every cell of the scope. A cell without a ranking is None."""
    cells = [s for s in scopes if s.n_agents and scope.task in (None, s.task)]
    tasks = [s for s in scopes if s.task and not s.n_agents and scope.task in (None, s.task)]
    found = {c.path: {row["explainer"]: row for row in ranking_of(board, c)["rows"]} for c in cells}
    shown = [row for row in rows if not row["control"] or row["explainer"] in (NEAREST, RANDOM)]
    names = [row["explainer"] for row in shown]
    names += sorted(
        {name for each in found.values() for name, row in each.items() if not row["control"]} - set(names)
    )
    return {
        "tasks": [(task, [c for c in cells if c.task == task.task]) for task in tasks],
        "rows": [(name, [(c, found[c.path].get(name)) for c in cells]) for name in names],
    }


def scatter_of(rows: Sequence[Json]) -> Json:
    """GAMED against the order: a dot for each explainer, numbered by place, and each control."""
    points = [row for row in rows if row["means"][GAMED] is not None]
    x = axis_of([row["means"][GAMED] for row in points], around=(0.0,))
    y = axis_of([row["value"] for row in points], around=(0.0, 1.0))
    dots: list[Json] = []
    number_of = iter(range(1, len(points) + 1))
    for row in sorted(points, key=lambda row: row["control"]):  # explainers keep their order
        dot = {"name": row["explainer"], "control": row["control"], "x": x.at(row["means"][GAMED]),
               "y": y.at(row["value"]), "numbers": (row["means"][GAMED], row["value"]),
               "key": "" if row["control"] else next(number_of)}  # fmt: skip
        dot["label"] = row["control"] and not any(
            other["label"] and abs(other["y"] - dot["y"]) < 6 and abs(other["x"] - dot["x"]) < 22
            for other in dots
        )
        dots.append(dot)
    return {"x": x, "y": y, "dots": dots, "x_title": title_of(GAMED), "y_title": title_of(ORDER["by"])}


def profile_of(ranked: Sequence[Json]) -> Json:
    """Performance profiles: for every score, the share of policies above it."""
    x = axis_of([value for row in ranked for value in row["values"]], around=(0.0, 1.0))
    y = axis_of([], around=(0.0, 1.0))
    lines = []
    for k, row in enumerate(ranked):
        profile = performance_profile(row["values"])
        ends = list(zip((x.low, *profile.taus), profile.shares, strict=True))
        corners = steps([*ends, (x.high, ends[-1][1])])
        band = [list(zip((x.low, *profile.taus, x.high), (*each, each[-1]), strict=True))
                for each in zip(*profile.band, strict=True)]  # fmt: skip
        polygon = [*steps(band[0]), *reversed(steps(band[1]))]
        lines.append(_line(k, row["explainer"], line(corners, x, y), line(polygon, x, y), on=k == 0))
    return {"x": x, "y": y, "lines": lines, "x_title": title_of(ORDER["by"]),
            "y_title": "share of policies above", "label": "Share of policies above a score",
            "numbers": None}  # fmt: skip


def budgets_of(tables: Sequence[Json], scope: Scope, details: Mapping[str, Details]) -> list[Json]:
    """FidDelta against the budget: of all policies of a cell, else of one, in a team of 5 if there is one."""
    pairs = [(table, policy) for table in tables for policy in table["policies"]]
    pairs.sort(
        key=lambda p: (p[1]["gate"] is not None, abs(p[0]["n_agents"] - TEAM_SHOWN_FIRST), p[1]["name"])
    )
    found = []
    for table, policy in pairs:
        chart = budget_chart(table, policy, details, "comm_budget")
        if chart is not None:
            found.append(chart)
        if found and not scope.n_agents:
            break
    return found


def budget_chart(table: Json, policy: Json, details: Mapping[str, Details], kind: str) -> Json | None:
    """The curves of a policy's explainers between those of a random ranking and of the best one."""
    key = (table["task"], table["n_agents"], table["max_cycles"])
    rows = [row for row in policy["rows"] if row["entry_id"] and not row["control"]]
    curves = [(row, details[row["file"]][key]["budgets"][kind]) for row in rows]
    explained = [(row, each["explained"]) for row, each in curves if "explained" in each]
    best = next((each for _, each in curves if "oracle" in each), None)
    if not explained or best is None:
        return None
    bounds = [(name, best[name]) for name in ("oracle", "random")]
    listed = [*((row["explainer"], each) for row, each in explained), *bounds]
    most = max(len(each) for _, each in listed)
    x = replace(axis_of([], around=(1.0, float(most))), least_step=1.0)
    y = axis_of([value for _, each in listed for point in each for value in point], around=(0.0,))

    def curve(each: list[list[float]], part: int = 0) -> list[tuple[float, float]]:
        return [(k + 1.0, point[part]) for k, point in enumerate(each)]

    def band(each: list[list[float]]) -> str:
        return line([*curve(each, 1), *reversed(curve(each, 2))], x, y) if len(each[0]) == 3 else ""

    lines = [
        _line(k, row["explainer"], line(curve(each), x, y), band(each), on=k == 0, entry=row["entry_id"])
        for k, (row, each) in enumerate(explained)
    ]
    lines += [_line(0, name, line(curve(each), x, y), "", bound=True) for name, each in bounds]
    body = [
        [name, *(number(p[0]) + (f" [{number(p[1])}, {number(p[2])}]" if len(p) == 3 else "") for p in each)]
        for name, each in listed
    ]
    edges = "messages between agents" if kind.startswith("comm") else "all edges"
    return {
        "x": x,
        "y": y,
        "lines": lines if most > 1 else [],  # one budget does not make a curve: its numbers are shown
        "x_title": "edges kept in each row, k",
        "y_title": f"{title_of(GAMED)}@k",
        "label": f"{policy['name']}: {title_of(GAMED)} against the budget, {edges}",
        "numbers": {"head": ["curve", *(f"k = {k + 1}" for k in range(most))], "rows": body},
    }


def questions_of(rows: Sequence[Json], cards: Json) -> list[Json]:
    """Which absence each explainer assumes, and its communication-only form beside it."""
    known = {row["explainer"]: row for row in rows if not row["control"]}
    bases = dict.fromkeys(name.removesuffix(MESSAGES_ONLY) for name in known)
    return [
        {"name": base, "all": known.get(base), "messages": known.get(base + MESSAGES_ONLY),
         "absence": absence_of(cards, base if base in known else base + MESSAGES_ONLY)}
        for base in bases
    ]  # fmt: skip


def absence_of(cards: Json, name: str) -> str | None:
    """ "none" for a registered explainer that removes nothing; None for one that is not registered here."""
    card = cards.get(name)
    return None if card is None else card["absence"] or "none"


def agreement_of(tables: Sequence[Json]) -> Json | None:
    """Rank correlations of the orders of explainers by two metrics."""
    matrix = rank_agreement(scores_of_board(tables), COMPARED)
    if np.isnan(matrix).all():
        return None
    return {"names": COMPARED, "rows": [[None if np.isnan(x) else float(x) for x in row] for row in matrix]}


def short_task(task: str) -> str:
    return task.removeprefix("blind_").rsplit("_v", 1)[0]


def _line(
    k: int, name: str, points: str, band: str, *, on: bool = False, bound: bool = False, entry: str = ""
) -> Json:
    return {"name": name, "points": points, "band": band, "on": on, "bound": bound, "colour": k % 10,
            "dash": k // 10 % 3, "entry": entry[:16]}  # fmt: skip
