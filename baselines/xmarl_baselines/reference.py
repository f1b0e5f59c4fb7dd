"""The reference policies: every run that is trained for the benchmark, by name.

`xmarl-train --reproduce NAME` trains one of them again, `--reproduce all` those that a folder of runs lacks.
"""

from __future__ import annotations

from xmarl_baselines.recipes import RECIPES
from xmarl_baselines.trainer import Run
from xmarl_bench.errors import InputError

SIZES = (3, 4, 5)
SEEDS = (0, 1, 2)
# lambda of the attention-entropy term: see baselines/README.md for what other values do.
LAMBDAS = {"blind_navigation_v0": 0.2, "blind_passage_v0": 0.05, "blind_discovery_v0": 0.05}


def reference_runs() -> dict[str, Run]:
    """Name -> run; the first seed of every cell comes first."""
    runs = [
        Run(recipe, n_agents, attention_entropy, seed)
        for seed in SEEDS
        for attention_entropy_of in ({}, LAMBDAS)
        for n_agents in SIZES
        for task, recipe in RECIPES.items()
        for attention_entropy in [attention_entropy_of.get(task, 0.0)]
    ]
    return {run.name: run for run in runs}


def reference_run(name: str) -> Run:
    """Raises InputError for a name that is none of them."""
    runs = reference_runs()
    if name not in runs:
        raise InputError(f"no reference policy is called {name!r}: choose one of {', '.join(runs)}.")
    return runs[name]
