"""GNNExplainer of torch_geometric 2.8.1 with its defaults, for many timesteps at once.

Paper: Ying et al., "GNNExplainer: Generating Explanations for Graph Neural Networks" (NeurIPS 2019).
Formula, for one timestep: m = sigmoid(w) with a logit per edge, at first w ~ Normal(0, 2 / N), and 100 steps
of Adam on

    mean over agents and action entries of (F(1) - F(m))^2
        + edge_size * sum over edges in H of m + edge_ent * mean over edges in H of the entropy of m,

where H holds the edges whose first gradient is not zero. The first step is without the second line, and the
mask is 0 outside H.

Departures: none from PyG. Its loop is restated with an independent objective and random stream for each
timestep, and computes the mask-independent part of the policy once. On the same random numbers the masks
equal PyG's own, one graph at a time, to 1e-5 (tested on trained policies). A block-diagonal batch through
PyG's class gives other masks: there one objective averages over all timesteps.

With these defaults the random start dominates the result: their correlation is 0.72-0.86, and 0.09 between
seeds. `gnn_explainer-tuned` is the same method with other settings.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass

import torch
from torch import Tensor

from xmarl_baselines.explainers.batching import by_chunks
from xmarl_baselines.explainers.closed_form import actions_of
from xmarl_baselines.explainers.frozen_policy import frozen
from xmarl_bench.explain.explainer import Explainer
from xmarl_bench.explain.messages_only import messages_only
from xmarl_bench.metrics.absence import Absence
from xmarl_bench.policy import Policy
from xmarl_bench.reproducible import timestep_seeds


@dataclass(frozen=True)
class GNNExplainerSettings:
    """PyG's names and defaults."""

    epochs: int = 100
    lr: float = 0.01
    edge_size: float = 0.005  # weight of the sum of the mask
    edge_ent: float = 1.0  # weight of the mean entropy of its entries


def random_logits(n_agents: int, seeds: list[int]) -> Tensor:
    """(S, N, N): what PyG draws for a graph of N nodes and N * N edges after `torch.manual_seed(seed)`."""
    scale = torch.nn.init.calculate_gain("relu") * math.sqrt(2.0 / (2 * n_agents))
    draws = [torch.randn(n_agents**2, generator=torch.Generator().manual_seed(seed)) for seed in seeds]
    return (torch.stack(draws) * scale).view(len(seeds), n_agents, n_agents)


def optimise_mask(
    policy: Policy, observations: Tensor, logits: Tensor, settings: GNNExplainerSettings
) -> Tensor:
    """One chunk: (S, N, D) observations, (S, N, N) first logits -> masks (S, N, N).

    Leaves `policy` unchanged. Its parameters should not require gradients, which would be computed in vain.
    """
    with torch.no_grad():
        prepared = policy.prepare(observations)
        target = policy.decode(prepared).action
    actions, w = actions_of(policy, prepared), logits.clone()
    optimizer = torch.optim.Adam([w], lr=settings.lr, fused=True)
    for epoch in range(settings.epochs):
        m = w.sigmoid()
        difference = actions.of(m) - target
        gradient = actions.gradient(2 * difference * (1 / target[0].numel()))  # of the mean of squares
        slope = m * (1 - m)  # dm / dw
        if epoch == 0:
            counted = (gradient * slope != 0).to(w.dtype)  # H
            entropy_weight = settings.edge_ent / counted.sum(dim=(-2, -1), keepdim=True).clamp_min(1)
        else:  # d entropy / dm is log(1 - m) - log(m), which is -w
            gradient = gradient + counted * (settings.edge_size - entropy_weight * w)
        w.grad = gradient * slope
        optimizer.step()
    return w.sigmoid() * counted


def gnn_explainer_mask(policy: Policy, observations: Tensor, generator: torch.Generator) -> Tensor:
    """(S, N, D) -> (S, N, N)."""
    n_steps, n_agents, _ = observations.shape
    policy, seeds = frozen(policy), timestep_seeds(n_steps, generator)

    def explain(steps: slice) -> Tensor:
        start = random_logits(n_agents, seeds[steps]).to(observations.device)
        return optimise_mask(policy, observations[steps], start, SETTINGS)

    return by_chunks(observations, explain)


SETTINGS = GNNExplainerSettings()

gnn_explainer = Explainer(
    "gnn_explainer",
    gnn_explainer_mask,
    "PyG's GNNExplainer with its defaults, batched over timesteps",
    stochastic=True,
    hyperparameters=asdict(SETTINGS),
    absence=Absence.ZERO,
    any_device=True,
)

gnn_explainer_messages = messages_only(gnn_explainer)
