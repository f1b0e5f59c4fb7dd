"""Every row of the board, as lists: the data of `scores.html` and `entry.html`."""

from __future__ import annotations

from collections.abc import Mapping, Set
from typing import Any

from xmarl_bench.board.columns import COLUMNS, ORDER, PAPER, POLICY_METRICS
from xmarl_bench.metrics.table import by_name

Json = dict[str, Any]


def board_rows(
    board: Json, scripts: Mapping[tuple[int, str, str], tuple[str, str]], animations: Set[str]
) -> Json:
    """scripts: (table, policy, weights) -> key and path of the policy's script."""
    policies: list[Json] = []
    rows: list[list[Any]] = []
    reasons = {None: {}, **board["not_measured"]}
    place = {key: k for k, key in enumerate(reasons)}
    for t, table in enumerate(board["tables"]):
        for policy in table["policies"]:
            key, script = scripts[t, policy["name"], policy["weights_sha256"]]
            policies.append(
                {
                    "table": t,
                    "key": key,
                    "script": script,
                    "name": policy["name"],
                    "lambda": policy["attention_entropy"],
                    "trained_n_agents": policy["trained_n_agents"],
                    "oracle_error": policy["oracle_error"],
                    "gate": policy["gate"],
                    "metrics": {name: _value(name, policy["metrics"].get(name)) for name in POLICY_METRICS},
                }
            )
            for row in policy["rows"]:
                identity = None if row["entry_id"] is None else row["entry_id"][:16]
                rows.append(
                    [len(policies) - 1, row["explainer"], int(row["control"]), row["rank"],
                     row["rank_interval"], row["tie_group"], row["submitter"], row["verification"], identity,
                     int(f"{identity}.avif" in animations), place[row["not_measured"]], row["file"],
                     [numbers(name, row["metrics"].get(name)) for name in COLUMNS], row["variants_tried"],
                     _fresh(row["fresh"]), row["cost"] and float(f"{1000 * row['cost']:.3g}")]
                )  # fmt: skip
    return {
        # A list, because keys of JSON have no order.
        "columns": [[name, heading, by_name()[name].digits] for name, heading in COLUMNS.items()],
        "paper": PAPER,
        "order": ORDER["by"],
        "protocols": {
            key: {name: protocol[name] for name in ("id", "episodes", "timesteps")}
            for key, protocol in board["protocols"].items()
        },
        "tables": [
            {key: table[key] for key in ("task", "n_agents", "max_cycles", "protocol", "oracle")}
            for table in board["tables"]
        ],
        "policies": policies,
        "rows": rows,
        "reasons": list(reasons.values()),
    }


def numbers(metric: str, summary: Any) -> list[float | None] | None:
    """[value, low, high] of a summary (a record or its dump), rounded to what is shown."""
    if summary is None:
        return None
    fields = summary if isinstance(summary, dict) else summary.model_dump()
    digits = by_name()[metric].digits
    three = (fields["value"], *(fields["interval"] or (None, None)))
    return [None if x is None else round(x, digits) for x in three]


def _value(metric: str, summary: Json | None) -> float | None:
    found = numbers(metric, summary)
    return None if found is None else found[0]


def _fresh(fresh: Json | None) -> Json | None:
    """What the pages show of fresh seeds: both means, and value, low and high of their difference."""
    if fresh is None or fresh["decides"] is None:
        return None
    metric = fresh["decides"]
    found = fresh["metrics"][metric]
    digits = by_name()[metric].digits
    return {
        **{name: fresh[name] for name in ("value", "decides", "worse")},
        "means": [round(found["public"], digits), round(found["fresh"], digits)],
        "difference": numbers(metric, {"value": found["difference"], "interval": found["interval"]}),
    }
