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

SIMULATOR: Final = "simulator"  # the parameter that is given one, and what entries call this access


@dataclass(frozen=True)
class Simulated:
    """What explains with the simulator of the episode at hand.

    function: policy, observations (S, N, D) of that episode, generator, simulator -> mask (S, N, N).
    """

    function: Callable[[Policy, Tensor, torch.Generator, Simulator], Tensor]
