"""Controls: masks that explain nothing, to read every explainer by. Always available.

The mask of ones keeps everything, so Fid- and GEF are 0 and FidDelta is what removing all messages does:
an explainer that merely keeps more is not better. A uniform random mask is the floor of every ranking.
"""

from __future__ import annotations

import torch
from torch import Tensor

from xmarl_bench.explainer import Explainer
from xmarl_bench.policy import GraphPolicy


def ones_mask(policy: GraphPolicy, observations: Tensor, generator: torch.Generator) -> Tensor:
    """(S, N, D) -> (S, N, N): every edge kept."""
    n_steps, n_agents, _ = observations.shape
    return torch.ones(n_steps, n_agents, n_agents)


def random_mask(policy: GraphPolicy, observations: Tensor, generator: torch.Generator) -> Tensor:
    """(S, N, D) -> (S, N, N): every entry uniform in [0, 1), independent."""
    n_steps, n_agents, _ = observations.shape
    return torch.rand(n_steps, n_agents, n_agents, generator=generator)


CONTROLS: dict[str, Explainer] = {
    control.name: control
    for control in (
        Explainer(
            "all-ones",
            ones_mask,
            "keeps every edge: the ceiling FidDelta cannot tell from truth",
            control=True,
        ),
        Explainer("random", random_mask, "uniform random mask: the floor", stochastic=True, control=True),
    )
}
