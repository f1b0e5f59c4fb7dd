"""The network of a `LayeredArchitecture`, which `ModulePolicy` runs."""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch_geometric.nn import GATConv, GATv2Conv, MessagePassing, TransformerConv

from xmarl_bench.policy.architecture import GraphLayer, LayeredArchitecture, raw_width
from xmarl_bench.policy.edge_features import edge_features
from xmarl_bench.policy.memory import recurrent_cell, remember
from xmarl_bench.policy.network import ACTIVATIONS, mlp


class LayeredNetwork(nn.Module):
    """(n, D), (2, edges) -> (n, raw_width): MLP encoder, attention layers, a memory among them, MLP decoder.

    Tensors are named `encoder.<k>.*`, `layers.<k>.*` with torch_geometric's names, `memory.*` with torch's
    names, and `decoder.<k>.*`. k counts modules, including activations, so the encoder's linear layers are
    0, 2, 4. Its steps are those of xmarl_bench.policy.recurrent; without a memory its state has no entries.
    """

    def __init__(self, architecture: LayeredArchitecture) -> None:
        super().__init__()
        a = architecture
        self.encoder = mlp((a.obs_dim, *a.encoder), a.encoder_activation)
        widths = [(a.obs_dim, *a.encoder)[-1], *(layer.out_width for layer in a.layers)]
        self.architecture = a
        self.memory = None if a.memory is None else recurrent_cell(a.memory, widths)
        self.layers = nn.ModuleList(_layer(n_in, each) for n_in, each in zip(widths, a.layers, strict=False))
        self.activations = nn.ModuleList(ACTIVATIONS[each.activation]() for each in a.layers)
        n_out = raw_width(a.distribution, a.action_dim)
        self.decoder = mlp((widths[-1], *a.decoder), a.decoder_activation, n_out)

    def initial_state(self, n: int) -> Tensor:
        """(n, H)"""
        return torch.zeros(n, self.architecture.memory_dim)

    def step(self, x: Tensor, edge_index: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
        """(n, D), (2, edges), (n, H) -> (n, raw_width), (n, H)."""
        record = self.architecture.memory
        hidden, state = remember(record, self.memory, 0, self.encoder(x), state)
        for k, (layer, activation) in enumerate(zip(self.layers, self.activations, strict=True), start=1):
            edges = self.architecture.layers[k - 1].edges
            features = None if edges is None else edge_features(edges, x, edge_index)
            heard = activation(layer(hidden, edge_index, features))
            hidden, state = remember(record, self.memory, k, heard, state)
        return self.decoder(hidden), state

    def forward(self, x: Tensor, edge_index: Tensor) -> Tensor:
        """The first step of an episode."""
        return self.step(x, edge_index, self.initial_state(len(x)))[0]


def _layer(n_in: int, layer: GraphLayer) -> MessagePassing:
    """Loops are explicit edges of the graph, so no layer adds its own."""
    edge_dim = None if layer.edges is None else layer.edges.width
    settings = {"heads": layer.heads, "concat": layer.concat, "edge_dim": edge_dim}
    if layer.conv == "TransformerConv":
        return TransformerConv(n_in, layer.width, root_weight=layer.residual, **settings)
    convolution = GATConv if layer.conv == "GATConv" else GATv2Conv
    return convolution(n_in, layer.width, residual=layer.residual, add_self_loops=False, **settings)
