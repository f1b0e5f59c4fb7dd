"""The network of a `LayeredArchitecture`: what `ModulePolicy` runs."""

from __future__ import annotations

from torch import Tensor, nn
from torch_geometric.nn import GATConv, GATv2Conv, MessagePassing, TransformerConv

from xmarl_bench.policy.architecture import GraphLayer, LayeredArchitecture, raw_width
from xmarl_bench.policy.network import ACTIVATIONS, mlp


class LayeredNetwork(nn.Module):
    """(n, D), (2, edges) -> (n, raw_width): MLP encoder, attention layers, MLP decoder.

    Tensors are named `encoder.<k>.*`, `layers.<k>.*` as torch_geometric's, and `decoder.<k>.*`; k counts
    modules, activations too, so the encoder's linear layers are 0, 2, 4.
    """

    def __init__(self, architecture: LayeredArchitecture) -> None:
        super().__init__()
        a = architecture
        self.encoder = mlp((a.obs_dim, *a.encoder), a.encoder_activation)
        widths = [
            a.encoder[-1] if a.encoder else a.obs_dim,
            *(layer.out_width for layer in a.layers),
        ]
        self.layers = nn.ModuleList(_layer(n_in, each) for n_in, each in zip(widths, a.layers, strict=False))
        self.activations = nn.ModuleList(ACTIVATIONS[each.activation]() for each in a.layers)
        decoded = a.decoder[-1] if a.decoder else widths[-1]
        self.decoder = nn.Sequential(
            *mlp((widths[-1], *a.decoder), a.decoder_activation),
            nn.Linear(decoded, raw_width(a.distribution, a.action_dim)),
        )

    def forward(self, x: Tensor, edge_index: Tensor) -> Tensor:
        hidden: Tensor = self.encoder(x)
        for layer, activation in zip(self.layers, self.activations, strict=True):
            hidden = activation(layer(hidden, edge_index))
        out: Tensor = self.decoder(hidden)
        return out


def _layer(n_in: int, layer: GraphLayer) -> MessagePassing:
    """Loops are explicit edges of the graph, so no layer adds its own."""
    if layer.conv == "TransformerConv":
        return TransformerConv(
            n_in, layer.width, heads=layer.heads, concat=layer.concat, root_weight=layer.residual
        )
    convolution = GATConv if layer.conv == "GATConv" else GATv2Conv
    return convolution(
        n_in,
        layer.width,
        heads=layer.heads,
        concat=layer.concat,
        residual=layer.residual,
        add_self_loops=False,
    )
