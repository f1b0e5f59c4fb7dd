"""Policies of any torch_geometric layers: several of them, several heads, GATConv, TransformerConv, ...

The generic way to F(m): all timesteps and masks become one block-diagonal graph, and PyG's own message
masking scales what passes along each edge, in every layer. Blocks share no edge, so a gradient with respect
to one timestep's mask is that timestep's alone.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn
from torch_geometric.explain.algorithm.utils import clear_masks, set_masks
from torch_geometric.nn import MessagePassing, TransformerConv

from xmarl_bench.errors import InputError
from xmarl_bench.policy.architecture import DistributionKind, ScaleKind
from xmarl_bench.policy.distribution import ActionDistribution, action_distribution, raw_width
from xmarl_bench.policy.graph import CompleteGraph, Graph, complete_graph, edge_index_of
from xmarl_bench.policy.interface import Policy

SAME = 1e-4  # largest difference between a graph alone and in a batch that rounding may explain


class PreparedGraphs(NamedTuple):
    """Nothing of a stack of layers is independent of the mask but what comes in."""

    observation: Tensor  # (S, N, D)
    adjacency: Tensor | None  # (S, N, N); None is the complete graph


class ModulePolicy(Policy):
    """A policy made of any module `network(x (n, D), edge_index (2, edges)) -> (n, 2A)`.

    The output holds the location of each action's Normal, then its scale before the biased softplus of
    `action_distribution`; of a deterministic policy the locations alone. Agents may mix in PyG
    message-passing layers only, called with the edges of `graph`, loops among them. Raises InputError where a
    layer adds loops of its own (PyG would read the mask in another order than the caller's, silently), where
    edges run backwards, where the output's width is another, and where graphs of a batch are not independent
    (a mean over all nodes, say).
    """

    def __init__(
        self,
        network: nn.Module,
        obs_dim: int,
        action_dim: int = 2,
        *,
        distribution: DistributionKind = "tanh_normal",
        scale: ScaleKind = "softplus",
        graph: Graph | None = None,
    ) -> None:
        super().__init__()
        self.network = network
        self.obs_dim, self.action_dim = obs_dim, action_dim
        self.distribution_kind: DistributionKind = distribution
        self.scale_kind: ScaleKind = scale
        self.graph = CompleteGraph() if graph is None else graph
        _check_layers(network)
        self.eval()
        self._check_output()

    @property
    def row_wise(self) -> bool:
        """True where exactly one message-passing layer runs, once, in a forward pass."""
        x, calls = self._probe(), []
        with ExitStack() as hooks, torch.no_grad():
            for layer in _layers(self.network):
                handle = layer.register_propagate_forward_hook(lambda *_: calls.append(1))
                hooks.callback(handle.remove)
            self.network(x[:3], complete_graph(3))
        return len(calls) == 1

    def forward(self, x: Tensor, edge_index: Tensor) -> Tensor:
        """(n, D), (2, edges) -> (n, A) deterministic actions."""
        return self._head(self.network(x, edge_index)).action

    def prepare(self, observation: Tensor) -> PreparedGraphs:
        """(S, N, D), kept as it is, and who hears whom in it."""
        return PreparedGraphs(observation, self.adjacency(observation))

    def decode(self, prepared: PreparedGraphs, mask: Tensor | None = None) -> ActionDistribution:
        """F(m); see `Policy.decode`."""
        observation, adjacency = prepared
        n_agents = observation.shape[-2]
        leading = observation.shape[:-2] if mask is None else mask.shape[:-2]
        shape = torch.broadcast_shapes(leading, observation.shape[:-2])
        x = observation.expand(*shape, n_agents, -1).reshape(math.prod(shape) * n_agents, -1)
        applied = None if mask is None else mask.expand(*shape, n_agents, n_agents)
        if adjacency is None:
            edge_index = block_diagonal(math.prod(shape), n_agents)
            applied = None if applied is None else applied.reshape(-1)
        else:
            there = adjacency.expand(*shape, n_agents, n_agents)
            edge_index = edge_index_of(there.reshape(-1, n_agents, n_agents))
            applied = None if applied is None else applied[there]
        with _masked(self.network, applied, edge_index):
            raw: Tensor = self.network(x, edge_index)
        return self._head(raw.view(*shape, n_agents, -1))

    def attention(self, observation: Tensor) -> Tensor:
        """(S, N, D) -> (S, N, N), rows sum to 1: the mean of the coefficients over heads and layers."""
        adjacency = self.adjacency(observation)
        there = torch.ones(*observation.shape[:-1], observation.shape[1], dtype=torch.bool)
        there = there if adjacency is None else adjacency
        found: list[Tensor] = []

        def keep(alpha: Tensor) -> None:
            spread = alpha.new_zeros(there.shape)
            spread[there] = alpha.reshape(len(alpha), -1).mean(dim=-1)
            found.append(spread)

        def read(layer: MessagePassing, inputs: tuple[dict[str, Any]], output: Tensor) -> None:
            alpha = inputs[0].get("alpha")
            if isinstance(alpha, Tensor):
                keep(alpha)

        def ask(layer: TransformerConv, args: Any, kwargs: dict[str, Any], output: Any) -> None:
            """Computes alpha inside its messages, so it is called once more, past this hook."""
            _, (_, alpha) = layer.forward(*args, **{**kwargs, "return_attention_weights": True})
            keep(alpha)

        with ExitStack() as hooks:
            for layer in _layers(self.network):
                if isinstance(layer, TransformerConv):
                    hooks.callback(layer.register_forward_hook(ask, with_kwargs=True).remove)
                else:
                    hooks.callback(layer.register_message_forward_hook(read).remove)
            self.decode(self.prepare(observation))
        if not found:
            raise InputError(
                f"{type(self.network).__name__} has no layer that attends: choose another explainer."
            )
        return torch.stack(found).mean(dim=0)

    def _head(self, raw: Tensor) -> ActionDistribution:
        return action_distribution(raw, self.distribution_kind, self.scale_kind)

    def _check_output(self) -> None:
        x = self._probe()
        with torch.no_grad():
            alone, beside = self.network(x[:3], complete_graph(3)), self.network(x, block_diagonal(2, 3))
        width = raw_width(self.distribution_kind, self.action_dim)
        if tuple(alone.shape) != (3, width):
            holds = "location" if width == self.action_dim else "location and raw scale"
            raise InputError(
                f"{type(self.network).__name__} returned shape {tuple(alone.shape)} for 3 agents: return "
                f"(3, {width}), {holds} of {self.action_dim} action entries."
            )
        if float((beside[:3] - alone).abs().max()) > SAME:
            raise InputError(
                f"{type(self.network).__name__} mixes the graphs of a batch: let agents meet in "
                f"message-passing layers only."
            )

    def _probe(self) -> Tensor:
        """(6, D) observations: two graphs of three agents."""
        like = next(self.network.parameters(), torch.empty(0))
        x = torch.randn(6, self.obs_dim, generator=torch.Generator().manual_seed(0))
        return x.to(like.dtype)


def block_diagonal(n_graphs: int, n_agents: int) -> Tensor:
    """(2, n_graphs * N * N) edges of that many complete graphs with loops, each in the order of our mask."""
    first = torch.arange(n_graphs)[:, None] * n_agents
    return (complete_graph(n_agents)[:, None] + first).reshape(2, -1)


def _layers(network: nn.Module) -> Iterator[MessagePassing]:
    return (module for module in network.modules() if isinstance(module, MessagePassing))


def _check_layers(network: nn.Module) -> None:
    for layer in _layers(network):
        name = type(layer).__name__
        if getattr(layer, "add_self_loops", False):
            raise InputError(f"{name} adds self loops to explicit ones: build it with add_self_loops=False.")
        if layer.flow != "source_to_target":
            raise InputError(f"{name} passes messages from target to source: build it the other way round.")


@contextmanager
def _masked(network: nn.Module, mask: Tensor | None, edge_index: Tensor) -> Iterator[None]:
    if mask is None:
        yield
        return
    set_masks(network, mask, edge_index, apply_sigmoid=False)
    try:
        yield
    finally:
        clear_masks(network)
