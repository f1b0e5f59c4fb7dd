"""Fits explainers that learn, on states of the policy's own episodes that no score uses.

The states: FIT_TIMESTEPS evenly spaced steps of each of FIT_EPISODES episodes with environment seeds 2^30 +
k. Training draws such seeds; scoring seeds begin at 10^12. The states are the same for every explainer, run
and sampling. An explainer is fitted once per policy and team size.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np
import torch
from torch import Tensor

from xmarl_bench.explain.explainer import Explainer, fit_explainer
from xmarl_bench.policy import Policy
from xmarl_bench.reproducible import derived_seed, one_thread
from xmarl_bench.rollout.cell import Cell, spaced_timesteps
from xmarl_bench.rollout.episodes import Rollout

FIT_EPISODES: Final = 10
FIT_TIMESTEPS: Final = 20
FIRST_FIT_SEED: Final = 2**30


def fit_states(policy: Policy, task: str, n_agents: int, episodes: int = FIT_EPISODES) -> Tensor:
    """(S, N, D) observations to fit an explainer on, of that many episodes."""
    seeds = tuple(range(FIRST_FIT_SEED, FIRST_FIT_SEED + episodes))
    played = Rollout(policy, Cell(task, n_agents), seeds, None).play()
    return torch.tensor(
        np.concatenate([each.observations[spaced_timesteps(each.makespan, FIT_TIMESTEPS)] for each in played])
    )


def fitted(explainer: Explainer, policy: Policy, states: Callable[[], Tensor], seed: int) -> Explainer:
    """The explainer, fitted to the policy if it needs fitting. seed: of the run. Raises InputError.

    states: gives the policy's `fit_states`, which take seconds to play.
    """
    if explainer.fit is None:
        return explainer
    with one_thread():
        return fit_explainer(explainer, policy, states(), derived_seed("fit", seed, explainer.name))
