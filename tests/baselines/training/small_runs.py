"""Recipes that run in a second."""

from __future__ import annotations

from typing import Any

from xmarl_baselines.training.recipes import Recipe, recipe_for


def small(task: str = "blind_navigation_v0", n_agents: int = 3, **changes: Any) -> Recipe:
    """The task's recipe with 4 iterations of 160 frames."""
    short = {"frames": 640, "n_envs": 8, "n_steps": 20, "batch_size": 80, "n_epochs": 2}
    return recipe_for(task, n_agents, **{**short, **changes})
