"""Policies outside the fast path: other or several layers, several heads; random weights."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor, nn
from torch_geometric.nn import GATConv, GATv2Conv, MessagePassing, TransformerConv

from tests.helpers.policies import random_observations
from xmarl_bench.policy import GraphPolicy, ModulePolicy, RadiusGraph

Layer = Callable[..., MessagePassing]


class Stack(nn.Module):
    """Message-passing layers one after the other, then a linear decoder to location and scale."""

    def __init__(self, layer: Layer, obs_dim: int, n_layers: int, heads: int, **options: bool) -> None:
        super().__init__()
        widths = [obs_dim, *[8 * heads] * n_layers]
        self.layers = nn.ModuleList(layer(widths[k], 8, heads=heads, **options) for k in range(n_layers))
        self.decoder = nn.Linear(8 * heads, 4)

    def forward(self, x: Tensor, edge_index: Tensor) -> Tensor:
        for layer in self.layers:
            x = torch.tanh(layer(x, edge_index))
        out: Tensor = self.decoder(x)
        return out


class Opened(nn.Module):
    """A GraphPolicy's modules, run by PyG's message passing."""

    def __init__(self, policy: GraphPolicy) -> None:
        super().__init__()
        self.policy = policy

    def forward(self, x: Tensor, edge_index: Tensor) -> Tensor:
        hidden = self.policy.gat(self.policy.encoder(x), edge_index)
        out: Tensor = self.policy.decoder(self.policy.gat_activation(hidden))
        return out


def stack(
    layer: Layer, obs_dim: int, n_layers: int, heads: int, seed: int = 0, **options: bool
) -> ModulePolicy:
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        network = Stack(layer, obs_dim, n_layers, heads, **options)
        with torch.no_grad():
            for parameter in network.parameters():
                parameter.copy_(torch.randn(parameter.shape) * 0.5)
    return ModulePolicy(network, obs_dim)


def one_layer(obs_dim: int) -> ModulePolicy:
    """GATv2 with two heads."""
    return stack(GATv2Conv, obs_dim, 1, 2, add_self_loops=False)


def two_layers(obs_dim: int) -> ModulePolicy:
    """Two GAT layers of two heads."""
    return stack(GATConv, obs_dim, 2, 2, add_self_loops=False)


def transformers(obs_dim: int) -> ModulePolicy:
    """Two TransformerConv layers of three heads."""
    return stack(TransformerConv, obs_dim, 2, 3)


def with_a_lonely_timestep() -> tuple[ModulePolicy, Tensor, Tensor]:
    """`one_layer` on a graph without loops; observations (4, 3, 6); edges (4, 3, 3), none at the second."""
    policy, graph = one_layer(6), RadiusGraph(radius=1.5, loops=False)
    policy.graph = graph
    observations = random_observations(4, 3, 6)
    observations[1] += 100.0 * torch.arange(3)[:, None]  # agents far from one another
    return policy, observations, graph.adjacency(observations)
