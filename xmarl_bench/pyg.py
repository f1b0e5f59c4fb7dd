"""Runs an unmodified torch_geometric.explain algorithm on a policy, one graph (timestep) at a time.

What PyG 2.8.1 leaves behind is kept from the policy and from the next graph: every graph gets its own deep
copy of the policy (GraphMask freezes the model, keeps hooks on it and changes its plain forward), its own
algorithm object and its own seed, drawn from the episode's generator; torch's global random state, the only
one PyG knows, is put back.
"""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor
from torch_geometric.explain import Explainer as PygExplainer
from torch_geometric.explain import ExplainerAlgorithm, ModelConfig

from xmarl_bench.policy import GraphPolicy, complete_graph


@dataclass(frozen=True)
class PygExplain:
    """An `Explain` callable (see xmarl_bench.explainer) made of a PyG algorithm.

    `algorithm` makes a fresh algorithm object. The prediction explained is the deterministic action of all
    agents at once, a regression on the nodes. The complete graph has its edges in the order of our mask.
    """

    algorithm: Callable[[], ExplainerAlgorithm]

    def __call__(self, policy: GraphPolicy, observations: Tensor, generator: torch.Generator) -> Tensor:
        """(S, N, D) -> (S, N, N)."""
        n_steps, n_agents, _ = observations.shape
        seeds = torch.randint(2**62, (n_steps,), generator=generator).tolist()
        edge_index = complete_graph(n_agents)
        masks = [
            self.explain_graph(policy, graph.clone(), edge_index, seed)
            for graph, seed in zip(observations, seeds, strict=True)
        ]
        return torch.stack(masks)

    def explain_graph(self, policy: GraphPolicy, x: Tensor, edge_index: Tensor, seed: int) -> Tensor:
        """(N, D) observations of one timestep -> (N, N) mask."""
        model = copy.deepcopy(policy)
        # No PyG algorithm trains the model; without this each backward pass computes gradients for it.
        model.requires_grad_(False)
        with torch.random.fork_rng(devices=[]), torch.enable_grad():
            torch.manual_seed(seed)
            explainer = PygExplainer(
                model=model,
                algorithm=self.algorithm(),
                explanation_type="model",
                edge_mask_type="object",
                model_config=ModelConfig(mode="regression", task_level="node"),
            )
            mask: Tensor = explainer(x, edge_index).edge_mask
        return mask.detach().reshape(len(x), len(x)).clone()
