"""Runs an unmodified torch_geometric.explain algorithm on a policy, one graph (timestep) at a time.

Isolates graphs from side effects of PyG 2.8.1: every graph gets its own deep copy of the policy (GraphMask
freezes the model, keeps hooks on it and changes its plain forward), its own algorithm object and its own
seed, drawn from the episode's generator. Afterwards torch's global random state, the only one that PyG uses,
and the settings that two algorithms keep on their class are restored.
"""

from __future__ import annotations

import copy
import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from typing import Any

import torch
from torch import Tensor, nn
from torch_geometric.explain import Explainer as PygExplainer
from torch_geometric.explain import ExplainerAlgorithm, ModelConfig, PGExplainer

from xmarl_bench.errors import InputError
from xmarl_bench.explain.effect import effect_direction
from xmarl_bench.explain.node_importance import mask_of_explanation
from xmarl_bench.policy import Policy
from xmarl_bench.reproducible import timestep_seeds


@dataclass(frozen=True)
class PygExplain:
    """An `Explain` callable (see xmarl_bench.explain.explainer) made of a PyG algorithm.

    Uses the policy's graph, with its edges in the order in which its layers receive them.

    algorithm: makes a new algorithm object.
    effect: explain the sum over agents of e_i (xmarl_bench.explain.effect), the single number that
        CaptumExplainer needs. Otherwise explain F, the deterministic actions or the probabilities of
        discrete ones of all agents, as a regression on nodes.
    per_agent: explain one agent at a time (PyG's `index`) and take row i from the explanation of agent i.
    to_unit: maps attributions (N, N) to [0, 1], for algorithms that do not return masks.

    An algorithm that masks no edges masks nodes instead, for one agent at a time: row i is the node mask of
    agent i. One that needs classes (PGMExplainer) explains the likeliest of discrete actions.

    A PGExplainer is first trained on all timesteps and agents of the episode (`fit_pg` uses other states),
    one object per episode. It explains agent by agent for any options, because PyG's supports nothing else.
    """

    algorithm: Callable[[], ExplainerAlgorithm]
    effect: bool = False
    per_agent: bool = False
    to_unit: Callable[[Tensor], Tensor] | None = None

    def __call__(self, policy: Policy, observations: Tensor, generator: torch.Generator) -> Tensor:
        """(S, N, D) -> (S, N, N)."""
        seeds = timestep_seeds(len(observations), generator)
        with class_settings_kept(), torch.random.fork_rng(devices=[]), torch.enable_grad():
            torch.manual_seed(seeds[0])
            if isinstance(self.algorithm(), PGExplainer):
                explain = fit_pg(self.algorithm, policy, observations, generator)
                return explain(policy, observations, generator)
            form = EDGES if self.effect else form_of(self.algorithm, policy)
            masks = [
                self._explain(policy, graph.clone(), seed, form)
                for graph, seed in zip(observations, seeds, strict=True)
            ]
        mask = torch.stack(masks).detach()
        return mask if self.to_unit is None else self.to_unit(mask)

    def _explain(self, policy: Policy, x: Tensor, seed: int, form: Form) -> Tensor:
        """(N, D) observations of one timestep -> (N, N)."""
        torch.manual_seed(seed)
        edge_index = policy.layer_edges(x)
        if edge_index.numel() == 0:  # several algorithms fail without edges
            return x.new_zeros(len(x), len(x))
        if not (self.per_agent or form.of_nodes):
            return self._explanation(policy, x, edge_index, None, form)
        return torch.stack([self._explanation(policy, x, edge_index, i, form)[i] for i in range(len(x))])

    def _explanation(
        self, policy: Policy, x: Tensor, edge_index: Tensor, index: int | None, form: Form
    ) -> Tensor:
        model, algorithm = _private(policy, differentiable=self.effect), self.algorithm()
        explained = _Effect(model, x) if self.effect else model
        explainer = _connect(explained, algorithm, "graph" if self.effect else "node", "model", form)
        return mask_of_explanation(type(algorithm).__name__, explainer(x, edge_index, index=index), len(x))


class _Effect(nn.Module):
    """The sum over agents of e_i, up to a constant: one number per graph, as Captum needs."""

    def __init__(self, policy: Policy, x: Tensor) -> None:
        super().__init__()
        self.policy = policy
        self.direction = effect_direction(policy, policy.prepare(x[None]))[0]

    def forward(self, x: Tensor, edge_index: Tensor) -> Tensor:
        action: Tensor = self.policy(x, edge_index)
        return (action * self.direction).sum().view(1)


def fit_pg(
    make: Callable[[], ExplainerAlgorithm], policy: Policy, observations: Tensor, generator: torch.Generator
) -> Callable[[Policy, Tensor, torch.Generator], Tensor]:
    """(S, N, D) -> an `Explain` for the policy (see explainer.py) of a PGExplainer, which PyG trains first.

    make: makes a new PGExplainer. It is trained on every timestep and agent, `epochs` times.
    """
    agents = range(observations.shape[1])
    with class_settings_kept(), torch.random.fork_rng(devices=[]), torch.enable_grad():
        torch.manual_seed(int(torch.randint(2**62, (), generator=generator)))
        algorithm, model = make(), _private(policy)
        assert isinstance(algorithm, PGExplainer)
        _connect(model, algorithm, "node", "phenomenon")
        graphs = [(x.clone(), policy.layer_edges(x)) for x in observations]
        targets = [model(x, edge_index).detach() for x, edge_index in graphs]
        for epoch in range(algorithm.epochs):
            for (x, edge_index), target in zip(graphs, targets, strict=True):
                for i in agents:
                    algorithm.train(epoch, model, x, edge_index, target=target, index=i)
    return partial(_explain_by_pg, algorithm)


def _explain_by_pg(
    trained: PGExplainer, policy: Policy, observations: Tensor, generator: torch.Generator
) -> Tensor:
    """(S, N, D) -> (S, N, N): row i is from the explanation of agent i."""
    model = _private(policy)
    explainer = _connect(model, copy.deepcopy(trained), "node", "phenomenon")
    masks = []
    for x in observations:
        edge_index = policy.layer_edges(x)
        with torch.no_grad():
            target = model(x, edge_index)
        explained = [explainer(x, edge_index, target=target, index=i) for i in range(len(x))]
        rows = [mask_of_explanation("PGExplainer", each, len(x))[i] for i, each in enumerate(explained)]
        masks.append(torch.stack(rows))
    return torch.stack(masks).detach()


@dataclass(frozen=True)
class Copies:
    """Makes copies of a configured algorithm, with its settings at the time of `of`."""

    algorithm: ExplainerAlgorithm
    coeffs: dict[str, Any]

    @classmethod
    def of(cls, algorithm: ExplainerAlgorithm) -> Copies:
        return cls(algorithm, copy.deepcopy(getattr(algorithm, "coeffs", {})))

    def __call__(self) -> ExplainerAlgorithm:
        fresh = copy.deepcopy(self.algorithm)
        if self.coeffs:
            fresh.coeffs = copy.deepcopy(self.coeffs)  # PyG keeps them on the class
        if isinstance(fresh, PGExplainer):
            # Its weights were drawn when the original was made, and its optimiser refers to the original's.
            fresh.reset_parameters()
            fresh.optimizer = torch.optim.Adam(fresh.mlp.parameters(), lr=fresh.lr)
        return fresh


@dataclass(frozen=True)
class Form:
    """What an algorithm explains, and how.

    of_nodes: it masks nodes and not edges: row i of our mask is what explains agent i.
    of_classes: F is read as probabilities of classes, and the likeliest one is explained.
    """

    of_nodes: bool = False
    of_classes: bool = False


EDGES = Form()


def form_of(algorithm: Callable[[], ExplainerAlgorithm], policy: Policy) -> Form:
    """How the algorithm explains the policy: by masks of edges if it can, else of nodes.

    Only discrete actions have classes. Raises InputError if the algorithm supports none of these.
    """
    forms = [EDGES, Form(of_nodes=True)]
    if not policy.continuous_actions:
        forms += [Form(of_classes=True), Form(of_nodes=True, of_classes=True)]
    root = logging.getLogger()
    root.addFilter(_nothing)  # algorithms log what they do not support
    try:
        for form in forms:
            with suppress(ValueError):
                _connect(policy, algorithm(), "node", "model", form)
                return form
    finally:
        root.removeFilter(_nothing)
    actions = "discrete" if not policy.continuous_actions else "continuous"
    raise InputError(
        f"{type(algorithm()).__name__} explains neither edges nor nodes of a policy with {actions} actions: "
        f"choose another algorithm"
        + (", or a policy with discrete actions." if policy.continuous_actions else ".")
    )


def _nothing(record: logging.LogRecord) -> bool:
    return False


def _private(policy: Policy, *, differentiable: bool = False) -> Policy:
    """A copy of the policy, without gradients of its weights unless `differentiable`: no algorithm trains it.

    Captum's Deconvolution and GuidedBackprop need them, because they hook every ReLU, also before the mask.
    """
    model = copy.deepcopy(policy)
    model.requires_grad_(differentiable)
    return model


def _connect(
    model: nn.Module,
    algorithm: ExplainerAlgorithm,
    task_level: str,
    explanation_type: str,
    form: Form = EDGES,
) -> PygExplainer:
    read_as = {"mode": "multiclass_classification", "return_type": "probs"}
    return PygExplainer(
        model=model,
        algorithm=algorithm,
        explanation_type=explanation_type,
        **{"node_mask_type" if form.of_nodes else "edge_mask_type": "object"},
        model_config=ModelConfig(
            task_level=task_level, **(read_as if form.of_classes else {"mode": "regression"})
        ),
    )


@contextmanager
def class_settings_kept() -> Iterator[None]:
    """Restore `coeffs` of PyG's algorithms, which they keep on their class and every instance updates."""
    before = {owner: copy.deepcopy(owner.coeffs) for owner in _owners(ExplainerAlgorithm)}
    try:
        yield
    finally:
        for owner, coeffs in before.items():
            owner.coeffs = coeffs


def _owners(algorithm: type[Any]) -> Iterator[type[Any]]:
    """Subclasses, at any depth, with their own `coeffs`."""
    for subclass in algorithm.__subclasses__():
        if "coeffs" in vars(subclass):
            yield subclass
        yield from _owners(subclass)
