"""Policies with their own code: any torch module that passes messages along `edge_index`.

Scoring one runs its author's code, so the command line requires `--trust-code`, and entries record it. Prefer
a bundle, which holds no code, where the architecture allows it: see xmarl_bench.policy.bundle.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from torch import nn

from xmarl_bench.policy.architecture import DistributionKind
from xmarl_bench.policy.graph import CompleteGraph, Graph
from xmarl_bench.policy.wrapped import unwrapped


@dataclass(frozen=True)
class PolicyModule:
    """A trained network, and what it was trained for: the return value of a `module:factory`.

    network: forward(x (n, D), edge_index (2, edges)) -> (n, 2A), for each agent the location of its action's
        Normal and the scale before the biased softplus; (n, A) if `distribution` is "deterministic"; a logit
        for each of the task's actions if it is "categorical". The rows are agents of one
        team or of many at once; they may interact in torch_geometric's message-passing layers only, which
        pass one message for each edge. A network with memory has `initial_state` and `step` instead of
        forward, see xmarl_bench.policy.recurrent. One that torch.compile, DataParallel or AveragedModel
        wraps is taken out.
    task: its name, or the task itself: a subclass of xmarl_envs.Task, or a function of a team size that
        returns a PettingZoo ParallelEnv.
    distribution: "tanh_normal", "normal", "deterministic" or "categorical", see ActionDistribution.
    graph: which agents hear which.
    attention_entropy: weight of the attention-entropy term in training, 0 without it.
    """

    name: str
    network: nn.Module
    task: str | Callable[..., Any]
    n_agents: int
    distribution: DistributionKind = "tanh_normal"
    graph: Graph = field(default_factory=CompleteGraph)
    attention_entropy: float = 0.0
    training_seed: int | None = None

    def __post_init__(self) -> None:
        if isinstance(self.network, nn.Module):  # else it is refused when it is opened
            object.__setattr__(self, "network", unwrapped(self.network))
