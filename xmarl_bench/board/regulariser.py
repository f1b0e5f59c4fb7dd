"""Policies trained with and without the attention-entropy term, in pairs.

A pair is training runs of one task, team size, architecture and training seed, some without and some with the
term, scored in the team size that they were trained for. Policies that do not pass the gate have no pair.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np

from xmarl_bench.board.entry_rows import is_whole, newest, value_of
from xmarl_bench.board.ranking import DIGITS
from xmarl_bench.metrics.student import Design, interval_of, mean_of
from xmarl_bench.records.files import canonical_json

Json = dict[str, Any]
PAPER_KIND = "mlp-gatv2-mlp"
SIDES = ("without", "with")  # the term


def families_of(tables: Sequence[Json], *, gated: bool = False) -> list[Json]:
    """Policies of a cell and architecture that have pairs: {task, n_agents, kind, pairs}.

    gated: with policies that do not pass the gate. A pair is {"without": policies, "with": policies}. Pairs
    are in the order of their training seeds.
    """
    families: dict[tuple[str, int, bytes], Json] = {}
    for table in tables:
        for policy in table["policies"]:
            seed = policy["training_seed"]
            if seed is None or policy["trained_n_agents"] != table["n_agents"]:
                continue
            if not is_whole(policy) or (policy["gate"] and not gated):
                continue
            architecture = policy["architecture"]
            key = (table["task"], table["n_agents"], canonical_json(architecture))
            family = families.setdefault(
                key,
                {"task": table["task"], "n_agents": table["n_agents"], "kind": kind_of(architecture),
                 "pairs": {}},
            )  # fmt: skip
            pair = family["pairs"].setdefault(seed, {side: [] for side in SIDES})
            pair[SIDES[policy["attention_entropy"] > 0.0]].append(policy)
    for family in families.values():
        family["pairs"] = [pair for _, pair in sorted(family["pairs"].items()) if all(pair.values())]
    return [family for family in families.values() if family["pairs"]]


def regulariser_of(families: Sequence[Json]) -> dict[str, Json]:
    """Explainer -> what the term does to its value in the board's order, largest difference first."""
    policies = [p for family in families for pair in family["pairs"] for side in SIDES for p in pair[side]]
    names = sorted({row["explainer"] for policy in policies for row in policy["rows"] if not row["control"]})
    found = {name: compared(families, partial(score_of, explainer=name)) for name in names}
    known = {name: each for name, each in found.items() if each is not None}
    return dict(sorted(known.items(), key=lambda pair: (-pair[1]["difference"], pair[0])))


def compared(families: Sequence[Json], value: Callable[[Json], float | None]) -> Json | None:
    """{without, with, difference, interval, n} of a policy's value over pairs, which are the units.

    Cells weigh the same. One pair gives no interval; None without a pair.
    """
    found = values_of(families, value)
    if not found:
        return None
    pairs = np.array([ends for _, *ends in found])
    cells = tuple((family["task"], family["n_agents"]) for family, *_ in found)
    design = Design(clusters=tuple(range(len(pairs))), cells=cells)
    difference = np.round(pairs[:, 1] - pairs[:, 0], DIGITS)
    return {
        "without": float(mean_of(pairs[:, 0], design)),
        "with": float(mean_of(pairs[:, 1], design)),
        "difference": float(mean_of(difference, design)),
        "interval": interval_of(difference, design=design),
        "n": len(pairs),
    }


def values_of(
    families: Sequence[Json], value: Callable[[Json], float | None]
) -> list[tuple[Json, float, float]]:
    """Family, value without and value with the term, of each pair with both: means of its policies."""
    found = []
    for family in families:
        for pair in family["pairs"]:
            one, other = (_mean([value(policy) for policy in pair[side]]) for side in SIDES)
            if one is not None and other is not None:
                found.append((family, one, other))
    return found


def score_of(policy: Json, explainer: str) -> float | None:
    """An explainer's value in the board's order on a policy; None without one."""
    row = newest(policy["rows"]).get(explainer)
    return None if row is None or row["control"] else value_of(row)


def task_metric_of(policy: Json, metric: str) -> float | None:
    summary = policy["metrics"].get(metric)
    return None if summary is None else summary["value"]


def kind_of(architecture: Json) -> str:
    """The architecture in a word: the paper's network, the same with a residual, or its kind."""
    if architecture["kind"] != PAPER_KIND:
        return str(architecture["kind"])
    return "residual" if architecture.get("residual") else "paper"


def _mean(values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return float(np.mean(known)) if known else None
