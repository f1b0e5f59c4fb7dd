"""The paper's training tables (Kailas et al., ICML 2025, appendix), on the tasks' own rewards.

The paper does not say how many teams share the frames of an iteration: `n_envs` is our choice.
"""

from __future__ import annotations

from dataclasses import replace

from xmarl_baselines.training.recipes import Recipe
from xmarl_baselines.training.trainer import Run

_PAPERS = Recipe(
    task="blind_navigation_v0",
    family="paper",
    critic=(32, 32),
    frames=150 * 18_000,
    n_envs=120,
    n_steps=150,
    n_epochs=30,
    batch_size=800,
    learning_rate=3e-4,
    final_learning_rate=1.0,  # the paper mentions no decay
    gamma=0.99999,
    gae_lambda=0.9,
    normalize_advantage=False,
    attention_start=0.0,
    attention_ramp=0.0,  # and no warm-up of lambda
    variant="schedule",
)

PAPER_SCHEDULE: dict[str, Recipe] = {
    "blind_navigation_v0": _PAPERS,
    "blind_passage_v0": replace(
        _PAPERS, task="blind_passage_v0", frames=100 * 60_000, n_envs=400, learning_rate=5e-5
    ),
    "blind_discovery_v0": replace(
        _PAPERS,
        task="blind_discovery_v0",
        critic=(128, 128),
        frames=1000 * 10_000,
        n_envs=100,
        n_steps=100,
        n_epochs=5,
        batch_size=10_000,
        learning_rate=7e-4,
        gamma=0.9999,
        gae_lambda=0.95,
        clip_range=0.05,
        normalize_advantage=True,
        max_grad_norm=10.0,
    ),
}
PAPER_LAMBDAS = {"blind_navigation_v0": 10.0, "blind_passage_v0": 50.0, "blind_discovery_v0": 50.0}


def schedule_runs() -> dict[str, Run]:
    """Name -> run of the paper's schedule, N = 3: its lambda or 0, advantages as in its table or not."""
    runs = []
    for task, paper in PAPER_SCHEDULE.items():
        other = "raw" if paper.normalize_advantage else "normalised"
        changed = replace(
            paper, normalize_advantage=not paper.normalize_advantage, variant=f"{paper.variant}-{other}"
        )
        for weight in (PAPER_LAMBDAS[task], 0.0):
            runs += [Run(recipe, attention_entropy=weight) for recipe in (paper, changed)]
    return {run.name: run for run in runs}
