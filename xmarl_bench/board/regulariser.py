"""Policies trained with and without the attention-entropy term, side by side.

A family is the policies of one cell and architecture, scored in the team size that they were trained for.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from xmarl_bench.board.columns import ORDER
from xmarl_bench.board.ranking import DIGITS
from xmarl_bench.metrics.statistics import student_interval
from xmarl_bench.records.files import canonical_json

Json = dict[str, Any]
PAPER_KIND = "mlp-gatv2-mlp"
SIDES = ("without", "with")  # the term


def families_of(tables: Sequence[Json]) -> list[Json]:
    """Families that have both sides: {title, task, n_agents, without, with}, each side {explainer: rows}."""
    families: dict[tuple[str, int, bytes], Json] = {}
    for table in tables:
        for policy in table["policies"]:
            if policy["trained_n_agents"] != table["n_agents"]:
                continue
            architecture = policy["architecture"]
            key = (table["task"], table["n_agents"], canonical_json(architecture))
            family = families.setdefault(
                key,
                {"task": table["task"], "n_agents": table["n_agents"], "kind": kind_of(architecture),
                 **{side: {} for side in SIDES}, "policies": {side: [] for side in SIDES}},
            )  # fmt: skip
            side = SIDES[policy["attention_entropy"] > 0.0]
            family["policies"][side].append(policy)
            for row in policy["rows"]:
                if not row["control"]:
                    family[side].setdefault(row["explainer"], []).append(row)
    return [family for family in families.values() if all(family["policies"].values())]


def regulariser_of(families: Sequence[Json], metric: str = ORDER["by"]) -> dict[str, Json]:
    """Explainer -> {without, with, difference, interval, n} over families, largest difference first.

    The unit is the family, whose policies are averaged; one family gives no interval.
    """
    pairs: dict[str, list[tuple[float, float]]] = {}
    for family in families:
        for name in sorted(set(family["without"]) & set(family["with"])):
            one, other = (mean_of(family[side][name], metric) for side in SIDES)
            if one is not None and other is not None:
                pairs.setdefault(name, []).append((one, other))
    found: dict[str, Json] = {}
    for name, each in pairs.items():
        values = np.array(each)
        difference = np.round(values[:, 1] - values[:, 0], DIGITS)
        interval = None if len(each) < 2 else [float(x) for x in student_interval(difference)]
        found[name] = {
            "without": float(values[:, 0].mean()),
            "with": float(values[:, 1].mean()),
            "difference": float(difference.mean()),
            "interval": interval,
            "n": len(each),
        }
    return dict(sorted(found.items(), key=lambda pair: (-pair[1]["difference"], pair[0])))


def kind_of(architecture: Json) -> str:
    """The architecture in a word: the paper's network, the same with a residual, or its kind."""
    if architecture["kind"] != PAPER_KIND:
        return str(architecture["kind"])
    return "residual" if architecture.get("residual") else "paper"


def mean_of(rows: Sequence[Json], metric: str) -> float | None:
    """Mean over rows with a value; None without one."""
    values = [
        s["value"] for row in rows if (s := row["metrics"][metric]) is not None and s["value"] is not None
    ]
    return float(np.mean(values)) if values else None
