"""The page: static files that load nothing from elsewhere, from a disk or a server.

`index.html` and `entry.html` are small. Their data is in scripts in `pages/`, because browsers let a page
opened from a disk load scripts but not JSON:

- one script with every row of the board (values and intervals, four digits), loaded by both pages;
- one script per policy and table with the episodes, budgets and provenance of its entries, loaded when a
  chart or an entry needs it. `entry.html` shows every entry, so that this data is not repeated.

Each name under `pages/` ends in a hash of its bytes, so a page never loads a file of another build.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping, Set
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined

from xmarl_bench.board.columns import COLUMNS, PAPER, POLICY_METRICS
from xmarl_bench.board.details import EPISODE_METRICS, Details, numbers, short, shown_value
from xmarl_bench.records.files import canonical_json

HERE = Path(__file__).parent
PAGES = "pages"
Json = dict[str, Any]


def page_files(board: Json, details: Mapping[str, Details], animations: Set[str]) -> dict[str, bytes]:
    """Every file of the page by its path.

    board: the result of `board_of`; details: by file; animations: names of the files in `animations/`.
    """
    files: dict[str, bytes] = {}

    def add(name: str, data: bytes) -> str:
        stem, dot, ending = name.rpartition(".")
        path = f"{PAGES}/{stem}-{_hash(data)}{dot}{ending}"
        files[path] = data
        return path

    assets = {path.name: add(path.name, path.read_bytes()) for path in sorted((HERE / "assets").iterdir())}
    data = add("board.js", _script("BOARD", _compact(board, details, animations, add)))
    environment = Environment(
        loader=FileSystemLoader(HERE / "templates"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    for name in ("entry.html", "index.html"):
        template = environment.get_template(f"{name}.jinja")
        files[name] = template.render(board=board, columns=COLUMNS, assets=assets, data=data).encode()
    return files


def _compact(
    board: Json, details: Mapping[str, Details], animations: Set[str], add: Callable[[str, bytes], str]
) -> Json:
    """The whole board as lists. add: stores the script of a policy and returns its path."""
    policies: list[Json] = []
    rows: list[list[Any]] = []
    reasons: list[Json] = [{}]  # values of `not_measured`, which most rows share
    for t, table in enumerate(board["tables"]):
        for policy in table["policies"]:
            key = _hash(canonical_json([t, policy["name"], policy["weights_sha256"]]))
            scope = (table["task"], table["n_agents"], table["max_cycles"])
            shown = {
                row["entry_id"][:16]: details[row["file"]][scope] for row in policy["rows"] if row["entry_id"]
            }
            script = add(f"{policy['name']}.js", _script(f"XMARL_{key}", shown))
            policies.append(
                {
                    "table": t,
                    "key": key,
                    "script": script,
                    "name": policy["name"],
                    "lambda": policy["attention_entropy"],
                    "training_seed": policy["training_seed"],
                    "trained_n_agents": policy["trained_n_agents"],
                    "oracle_error": short(policy["oracle_error"]),
                    "gate": policy["gate"],
                    "metrics": {name: shown_value(policy["metrics"][name]) for name in POLICY_METRICS},
                }
            )
            for row in policy["rows"]:
                why = row["not_measured"]
                if why not in reasons:
                    reasons.append(why)
                identity = None if row["entry_id"] is None else row["entry_id"][:16]
                rows.append(
                    [len(policies) - 1, row["explainer"], int(row["control"]), row["rank"],
                     row["rank_interval"], row["tie_group"], row["submitter"], row["verification"], identity,
                     int(f"{identity}.avif" in animations), reasons.index(why), row["file"],
                     [numbers(row["metrics"][name]) for name in COLUMNS], row["variants_tried"],
                     _fresh(row["fresh"])]
                )  # fmt: skip
    return {
        "columns": list(COLUMNS.items()),  # a list, because keys of JSON have no order
        "paper": PAPER,
        "order": board["order"],
        "protocols": {
            key: {name: protocol[name] for name in ("id", "episodes", "timesteps", "definitions")}
            for key, protocol in board["protocols"].items()
        },
        "tables": [
            {key: table[key] for key in ("task", "n_agents", "max_cycles", "protocol", "oracle")}
            for table in board["tables"]
        ],
        "policies": policies,
        "rows": rows,
        "reasons": reasons,
        "rankings": [
            {
                **{key: ranking[key] for key in ("protocol", "oracle", "task", "n_agents")},
                "n_policies": len(ranking["policies"]),
                "improvement": ranking["improvement"],
                "rows": [
                    {
                        **row,
                        "value": short(row["value"]),
                        "profile": _profile(row["profile"]),
                        "interval": row["interval"] and [short(x) for x in row["interval"]],
                        "means": {name: short(mean) for name, mean in row["means"].items()},
                    }
                    for row in ranking["rows"]
                ],
            }
            for ranking in board["rankings"]
        ],
        "episode_metrics": EPISODE_METRICS,
    }


def _profile(profile: Json) -> list[list[float | None]]:
    """[tau, share above it, low, high] of every step of a performance profile; the first tau is None."""
    return [
        [None if tau is None else short(tau), short(share), short(low), short(high)]
        for tau, share, (low, high) in zip(
            (None, *profile["taus"]), profile["shares"], profile["band"], strict=True
        )
    ]


def _fresh(fresh: Json | None) -> Json | None:
    """What the pages show of fresh seeds: both means, and value, low and high of their difference."""
    if fresh is None or fresh["decides"] is None:
        return None
    found = fresh["metrics"][fresh["decides"]]
    difference = numbers({"value": found["difference"], "interval": found["interval"]})
    return {
        **{name: fresh[name] for name in ("value", "decides", "worse")},
        "means": [short(found["public"]), short(found["fresh"])],
        "difference": difference,
    }


def _script(name: str, value: Any) -> bytes:
    return b"globalThis.%s=%s;\n" % (name.encode(), canonical_json(value))


def _hash(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()[:10]
