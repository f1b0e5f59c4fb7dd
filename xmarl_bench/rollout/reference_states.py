"""States of a policy's own episodes that no score uses.

Explainers that learn are fitted on them, and their messages replace those that absence models remove. They
are FIT_TIMESTEPS evenly spaced steps of each of FIT_EPISODES episodes with environment seeds 2^30 + k.
Training draws such seeds; scoring seeds begin at 10^12. The states are the same for every explainer and run
whose episodes end after the same number of steps.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import torch
from torch import Tensor

from xmarl_bench.policy import GraphPolicy, Policy
from xmarl_bench.rollout.cell import Cell, spaced_timesteps
from xmarl_bench.rollout.episodes import Rollout

FIT_EPISODES: Final = 10
FIT_TIMESTEPS: Final = 20
FIRST_FIT_SEED: Final = 2**30


def fit_states(
    policy: Policy, cell: Cell, max_cycles: int | None = None, episodes: int = FIT_EPISODES
) -> Tensor:
    """(S, N, D) observations to fit an explainer on, of that many episodes.

    max_cycles: steps per episode, as in scoring; None: the task's default.
    """
    seeds = tuple(range(FIRST_FIT_SEED, FIRST_FIT_SEED + episodes))
    played = Rollout(policy, cell, seeds, max_cycles).play()
    return torch.tensor(
        np.concatenate([each.observations[spaced_timesteps(each.makespan, FIT_TIMESTEPS)] for each in played])
    )


def reference_states(policy: Policy, cell: Cell, max_cycles: int | None = None) -> Tensor | None:
    """(S, N, D) observations whose messages replace removed ones; None if the policy's are not known."""
    return fit_states(policy, cell, max_cycles) if isinstance(policy, GraphPolicy) else None
