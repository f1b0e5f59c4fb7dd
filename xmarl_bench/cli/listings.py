"""Rows of `xmarl-bench list`. Reads cards and sources; runs no explainer and builds no network.

Each list imports what it needs.
"""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

from xmarl_bench.cli.tables import Row
from xmarl_bench.errors import InputError

_OF_CARD = ("task", "n_agents", "attention_entropy", "training_seed")


def tasks() -> list[Row]:
    """`code` is the entry point of another package's task. It is not run to be listed: the rest is None."""
    from xmarl_envs import TASKS

    from xmarl_bench.tasks.sources import task_plugins

    ours = [
        {
            "name": name,
            "max_agents": task.max_agents,
            "obs_dim": len(task.observation_names),
            "max_cycles": task.default_max_cycles,
            "code": None,
        }
        for name, task in TASKS.items()
    ]
    others = [
        {**dict.fromkeys(ours[0]), "name": name, "code": each.value} for name, each in task_plugins().items()
    ]
    return ours + others


def policies() -> tuple[list[Row], list[InputError]]:
    """Policies of the plugins that load, and the errors of the others.

    `success` is the success rate in the card, None without one. `code` is the entry point of a policy with
    its own code. Listing does not run the code, so its other columns are None.
    """
    from xmarl_bench.metrics.table import SUCCESS
    from xmarl_bench.plugins.names import registered_policies
    from xmarl_bench.policy.card import load_card

    found, failures = registered_policies()
    rows: list[Row] = []
    for name, place in found.items():
        if not isinstance(place, Path):
            rows.append({"name": name, **dict.fromkeys((*_OF_CARD, "success")), "code": place.value})
            continue
        try:
            card = load_card(place)
        except InputError as error:
            failures.append(error)
            continue
        measured = card.performance.get("with_messages", {})
        success = measured.get(SUCCESS) if isinstance(measured, dict) else None
        declared = {column: getattr(card, column) for column in _OF_CARD}
        rows.append({"name": name, **declared, "success": success, "code": None})
    return rows, failures


def explainers() -> list[Row]:
    """What explainers declare in their source, which is not run: None where only running it would tell."""
    from xmarl_bench.plugins.declarations import declared_explainers

    return [asdict(each) for each in declared_explainers()]
