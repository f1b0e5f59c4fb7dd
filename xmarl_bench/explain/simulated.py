"""Explanations by simulation: the explainer plays on from the states that it explains.

S is the number of timesteps, N agents, D observation entries.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import torch
from torch import Tensor

from xmarl_bench.policy import Policy
from xmarl_bench.rollout.simulator import Simulator

SIMULATOR: Final = "simulator"  # name of the parameter, and of this access in entries


@dataclass(frozen=True)
class Simulated:
    """A callable that explains with the simulator of the explained episode.

    function: policy, observations (S, N, D) of that episode, generator, simulator -> mask (S, N, N).
    """

    function: Callable[[Policy, Tensor, torch.Generator, Simulator], Tensor]
