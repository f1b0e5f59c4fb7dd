"""The reference policies: every run that is trained for the benchmark, by name.

`xmarl-train --reproduce NAME` trains one of them again, `--reproduce all` those that a folder of runs lacks.
The paper's own schedules are runs with names too, but no references: see paper_lambda.py.
"""

from __future__ import annotations

from dataclasses import replace

from xmarl_baselines.policies import shipped_policies
from xmarl_baselines.recipes import PAPER_NAVIGATION, PAPER_SCHEDULE, RECIPES, Recipe
from xmarl_baselines.trainer import Run
from xmarl_bench.errors import InputError
from xmarl_bench.policy.bundle import load_card

SIZES = (3, 4, 5)
SEEDS = (0, 1, 2)
EPISODES = 200  # that policies are measured on: the first 50 are the ones that scoring plays
# lambda of the attention-entropy term, by team size: what halves the entropy and leaves the team talking.
LAMBDAS = {
    "blind_navigation_v0": dict.fromkeys(SIZES, 0.05),
    "blind_passage_v0": {3: 0.03, 4: 0.02, 5: 0.01},  # with 0.01, N = 3 and 4 keep 0.58 and 0.70 of it
    "blind_discovery_v0": dict.fromkeys(SIZES, 0.05),
}
# Times the recipe's imitation. One of passage's five slots is empty at N = 4, each as often as the others:
# seeds 0, 1, 2 reached 0.92, 0.90, 0.78 success with the usual 150 rounds.
PROLONGED = {("blind_passage_v0", 4): 2}
# A run that ends with a team that its messages do not help is no reference: another seed takes its place.
REPLACED_SEEDS = {("blind_passage_v0", 5, 0.01): {2: 4}}
# The paper's (Kailas et al., ICML 2025, appendix).
PAPER_LAMBDAS = {"blind_navigation_v0": 10.0, "blind_passage_v0": 50.0, "blind_discovery_v0": 50.0}


def reference_runs() -> dict[str, Run]:
    """Name -> run; the first seed of every cell comes first."""
    runs = [
        Run(
            recipe.shortened(recipe.played * PROLONGED.get((task, n_agents), 1)),
            n_agents,
            weight,
            REPLACED_SEEDS.get((task, n_agents, weight), {}).get(seed, seed),
        )
        for seed in SEEDS
        for regularised in (False, True)
        for n_agents in SIZES
        for task, recipe in RECIPES.items()
        for weight in [LAMBDAS[task][n_agents] if regularised else 0.0]
    ]
    runs += [Run(PAPER_NAVIGATION, n_agents) for n_agents in SIZES]  # navigation-paper-n3-lambda0-seed0, ...
    return {run.name: run for run in runs}


def schedule_runs() -> dict[str, Run]:
    """Name -> run of the paper's schedule, N = 3: its lambda or none, advantages as in its table or not."""
    runs = []
    for task, paper in PAPER_SCHEDULE.items():
        other = "raw" if paper.normalize_advantage else "normalised"
        changed = replace(
            paper, normalize_advantage=not paper.normalize_advantage, variant=f"{paper.variant}-{other}"
        )
        for regularised in (True, False):
            weight = PAPER_LAMBDAS[task] if regularised else 0.0
            runs += [Run(recipe, attention_entropy=weight) for recipe in (paper, changed)]
    return {run.name: run for run in runs}


def run_named(name: str) -> Run:
    """The run that made the shipped policy `name`, as its card records it, or the one to be made.

    Raises InputError for a name that is neither.
    """
    runs, shipped = reference_runs() | schedule_runs(), shipped_policies()
    if name in shipped:
        training = load_card(shipped[name]).training
        fields = ("n_agents", "attention_entropy", "seed", "caution", "start_from")
        run = Run(Recipe.from_dict(training["recipe"]), **{field: training[field] for field in fields})
        if run.name == name and run.start_from is None:
            return run
        raise InputError(f"{name} cannot be made by one run: its card says what it was made of.")
    if name not in runs:
        raise InputError(f"no reference policy is called {name!r}: choose one of {', '.join(runs)}.")
    return runs[name]
