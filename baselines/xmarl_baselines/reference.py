"""The reference policies: every run that is trained for the benchmark, by name.

`xmarl-train --reproduce NAME` trains one of them, `--reproduce all` those missing in a folder of runs, and
`--reproduce dose` those of docs/dose.md.
"""

from __future__ import annotations

from pathlib import Path

from xmarl_baselines.paper_schedule import schedule_runs
from xmarl_baselines.policies import shipped_policies
from xmarl_baselines.training.families import FAMILIES, Family
from xmarl_baselines.training.recipes import RECIPES, recipe_for, up_to
from xmarl_baselines.training.trainer import Run
from xmarl_bench.errors import InputError, unknown
from xmarl_bench.policy.card import load_card
from xmarl_bench.policy.untrusted import CARD

SIZES = (3, 4, 5)
SEEDS = (0, 1, 2)
EPISODES = 200  # to measure policies; scoring plays the first 50 of them
# lambda of the attention-entropy term for teams of at least this size, in ascending order. Chosen to halve
# the entropy while messages still help.
LAMBDAS: dict[Family, dict[str, dict[int, float]]] = {
    "residual": {
        "blind_navigation_v0": {1: 0.1},
        "blind_passage_v0": {1: 0.04},
        "blind_discovery_v0": {1: 0.03},
    },
    "paper": {
        "blind_navigation_v0": {1: 0.1, 4: 0.03},
        "blind_passage_v0": {1: 0.04},
        "blind_discovery_v0": {1: 0.08, 4: 0.06},
    },
}
# Success that family `residual` aims at, of the best seed and of the median; with the term 0.03 less.
AIMS = {
    ("blind_navigation_v0", 3): (0.97, 0.95),
    ("blind_navigation_v0", 4): (0.95, 0.90),
    ("blind_navigation_v0", 5): (0.90, 0.82),
    ("blind_passage_v0", 3): (0.97, 0.93),
    ("blind_passage_v0", 4): (0.95, 0.88),
    ("blind_passage_v0", 5): (0.95, 0.88),
    **{("blind_discovery_v0", n): (0.93, 0.90) for n in SIZES},
}
# What a larger weight does to attention is asked of these runs (docs/dose.md), which are not shipped.
DOSES, DOSE_SEEDS = (0.0, 0.03, 0.1, 0.3), (0, 1, 2, 3, 4)


def reference_runs() -> dict[str, Run]:
    """Name -> run; the first seeds of the first family come first."""
    runs = [
        Run(recipe_for(task, n_agents, family=family), n_agents, weight, seed)
        for family in FAMILIES
        for seed in SEEDS
        for n_agents in SIZES
        for task in RECIPES
        for weight in (0.0, up_to(n_agents, LAMBDAS[family][task])[-1])
    ]
    return {run.name: run for run in runs}


def dose_runs() -> dict[str, Run]:
    """Name -> run of navigation with three agents: each weight of `DOSES` with each of `DOSE_SEEDS`."""
    recipe = recipe_for("blind_navigation_v0")
    runs = [Run(recipe, 3, weight, seed) for seed in DOSE_SEEDS for weight in DOSES]
    return {run.name: run for run in runs}


GROUPS = {"all": reference_runs, "dose": dose_runs}  # for --reproduce


def planned_runs() -> dict[str, Run]:
    """Every run that has a name."""
    return reference_runs() | dose_runs() | schedule_runs()


def run_named(name: str) -> Run:
    """The run of a reference policy: as recorded in the card if it is shipped, otherwise as planned here.

    Raises InputError if the name is unknown, or if the card records more than one run.
    """
    runs, shipped = planned_runs(), shipped_policies()
    if name in shipped:
        run = Run.from_settings(load_card(shipped[name]).training)
        if run.name == name and run.start_from is None:
            return run
        raise InputError(f"{name} cannot be made by one run: `training` in its card says how to make it.")
    if name not in runs:
        raise unknown("reference policy", name, runs)
    return runs[name]


def finished_bundle(run: Run, runs: Path) -> Path | None:
    """The policy of a run in the folder `runs`; None if it is not finished.

    Raises InputError if it is the policy of another run of this name: a name does not tell every setting.
    """
    bundle = runs / run.name / "policy"
    if not (bundle / CARD).exists():
        return None
    if Run.from_settings(load_card(bundle).training) != run:
        raise InputError(f"{bundle} was trained with other settings: give another folder, or remove it.")
    return bundle
