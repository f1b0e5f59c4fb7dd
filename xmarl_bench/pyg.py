"""Runs an unmodified torch_geometric.explain algorithm on a policy, one graph (timestep) at a time.

What PyG 2.8.1 leaves behind is kept from the policy and from the next graph: every graph gets its own deep
copy of the policy (GraphMask freezes the model, keeps hooks on it and changes its plain forward), its own
algorithm object and its own seed, drawn from the episode's generator; torch's global random state, the only
one PyG knows, is put back, and so are the settings that two algorithms keep on their class.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor, nn
from torch_geometric.explain import Explainer as PygExplainer
from torch_geometric.explain import ExplainerAlgorithm, Explanation, ModelConfig, PGExplainer

from xmarl_bench.effect import effect_direction
from xmarl_bench.policy import Policy, complete_graph


@dataclass(frozen=True)
class PygExplain:
    """An `Explain` callable (see xmarl_bench.explainer) made of a PyG algorithm.

    The complete graph has its edges in the order of our mask.

    algorithm: makes a fresh algorithm object.
    effect: explain the sum over agents of e_i (xmarl_bench.effect), the single number that CaptumExplainer
        needs. Otherwise the deterministic action of all agents is explained, a regression on nodes.
    per_agent: explain one agent at a time (PyG's `index`) and take row i from the explanation of agent i.
    to_unit: brings the attributions (N, N) of algorithms that return no mask into [0, 1].

    A PGExplainer is trained on all timesteps and agents of the episode first, one object for the episode, and
    explains agent by agent whatever the options say: PyG's does nothing else.
    """

    algorithm: Callable[[], ExplainerAlgorithm]
    effect: bool = False
    per_agent: bool = False
    to_unit: Callable[[Tensor], Tensor] | None = None

    def __call__(self, policy: Policy, observations: Tensor, generator: torch.Generator) -> Tensor:
        """(S, N, D) -> (S, N, N)."""
        n_steps, n_agents, _ = observations.shape
        seeds = torch.randint(2**62, (n_steps,), generator=generator).tolist()
        edge_index = complete_graph(n_agents)
        with class_settings_kept(), torch.random.fork_rng(devices=[]), torch.enable_grad():
            torch.manual_seed(seeds[0])
            algorithm = self.algorithm()
            if isinstance(algorithm, PGExplainer):
                masks = _by_trained(algorithm, policy, observations, edge_index)
            else:
                masks = [
                    self._explain(policy, graph.clone(), edge_index, seed)
                    for graph, seed in zip(observations, seeds, strict=True)
                ]
        mask = torch.stack(masks).detach()
        return mask if self.to_unit is None else self.to_unit(mask)

    def _explain(self, policy: Policy, x: Tensor, edge_index: Tensor, seed: int) -> Tensor:
        """(N, D) observations of one timestep -> (N, N)."""
        torch.manual_seed(seed)
        if not self.per_agent:
            return self._explanation(policy, x, edge_index, None)
        return torch.stack([self._explanation(policy, x, edge_index, i)[i] for i in range(len(x))])

    def _explanation(self, policy: Policy, x: Tensor, edge_index: Tensor, index: int | None) -> Tensor:
        model = _private(policy, differentiable=self.effect)
        explained = _Effect(model, x) if self.effect else model
        explainer = _connect(explained, self.algorithm(), "graph" if self.effect else "node", "model")
        return _matrix(explainer(x, edge_index, index=index))


class _Effect(nn.Module):
    """The sum over agents of e_i, up to a constant: one number per graph, as Captum takes it."""

    def __init__(self, policy: Policy, x: Tensor) -> None:
        super().__init__()
        self.policy = policy
        self.direction = effect_direction(policy, policy.prepare(x[None]), 1, len(x))[0]

    def forward(self, x: Tensor, edge_index: Tensor) -> Tensor:
        action: Tensor = self.policy(x, edge_index)
        return (action * self.direction).sum().view(1)


def _by_trained(
    algorithm: PGExplainer, policy: Policy, observations: Tensor, edge_index: Tensor
) -> list[Tensor]:
    """(S, N, D) -> S times (N, N), by an algorithm that learns from all graphs before it explains one."""
    model, agents = _private(policy), range(observations.shape[1])
    explainer = _connect(model, algorithm, "node", "phenomenon")
    with torch.no_grad():
        graphs = [(x.clone(), model(x, edge_index)) for x in observations]
    for epoch in range(algorithm.epochs):
        for x, target in graphs:
            for i in agents:
                algorithm.train(epoch, model, x, edge_index, target=target, index=i)
    return [
        torch.stack([_matrix(explainer(x, edge_index, target=target, index=i))[i] for i in agents])
        for x, target in graphs
    ]


def _matrix(explanation: Explanation) -> Tensor:
    mask: Tensor = explanation.edge_mask.detach()
    return mask.reshape(len(explanation.x), len(explanation.x)).clone()


def _private(policy: Policy, *, differentiable: bool = False) -> Policy:
    """A copy. No algorithm trains the model: PyG's own would compute gradients of the weights for nothing.

    Captum's Deconvolution and GuidedBackprop need them, for they hook every ReLU, also before the mask.
    """
    model = copy.deepcopy(policy)
    model.requires_grad_(differentiable)
    return model


def _connect(
    model: nn.Module, algorithm: ExplainerAlgorithm, task_level: str, explanation_type: str
) -> PygExplainer:
    return PygExplainer(
        model=model,
        algorithm=algorithm,
        explanation_type=explanation_type,
        edge_mask_type="object",
        model_config=ModelConfig(mode="regression", task_level=task_level),
    )


@contextmanager
def class_settings_kept() -> Iterator[None]:
    """Put back what PyG's algorithms keep on their class: `coeffs`, which every instance made updates."""
    before = {owner: copy.deepcopy(owner.coeffs) for owner in _owners(ExplainerAlgorithm)}
    try:
        yield
    finally:
        for owner, coeffs in before.items():
            owner.coeffs = coeffs


def _owners(algorithm: type[Any]) -> Iterator[type[Any]]:
    """Subclasses, at any depth, with a `coeffs` of their own."""
    for subclass in algorithm.__subclasses__():
        if "coeffs" in vars(subclass):
            yield subclass
        yield from _owners(subclass)
