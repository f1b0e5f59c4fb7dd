"""One GATv2 layer as a policy's network, and the same computed over all pairs of agents.

GATv2 (Brody et al., ICLR 2022) with edge features: e_ij = a . LeakyReLU(W_l x_j + W_r x_i + W_e f_ij),
alpha_i = softmax_j e_ij over the senders of i; h_i = sum_j m_ij alpha_ij W_l x_j + b.
"""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor, nn
from torch_geometric.nn import GATv2Conv

Rewire = Callable[[Tensor, int], Tensor]  # edge_index, number of rows -> the edges that the layer receives


class OneLayer(nn.Module):
    """forward(x (n, 6), edge_index) -> (n, 4): a linear map of the agent itself, plus one head of GATv2."""

    def __init__(
        self, rewire: Rewire | None = None, *, relative: bool = False, seed: int = 0, **options: object
    ) -> None:
        super().__init__()
        self.rewire, self.relative = rewire, relative
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            settings = {"add_self_loops": False, **({"edge_dim": 2} if relative else {}), **options}
            self.layer = GATv2Conv(6, 4, **settings)
            self.own = nn.Linear(6, 4)
            with torch.no_grad():
                for parameter in self.parameters():
                    parameter.copy_(torch.randn(parameter.shape))

    def forward(self, x: Tensor, edge_index: Tensor) -> Tensor:
        if self.rewire is not None:
            edge_index = self.rewire(edge_index, len(x))
        features = None
        if self.relative:  # where the sender is, seen from the receiver
            features = x[edge_index[0], :2] - x[edge_index[1], :2]
        out: Tensor = self.layer(x, edge_index, features) + self.own(x)
        return out


def dense_attention(network: OneLayer, x: Tensor, there: Tensor) -> Tensor:
    """(N, 6), (N, N) bool [i, j] for j -> i -> (N, N)."""
    layer = network.layer
    pair = layer.lin_r(x)[:, None] + layer.lin_l(x)[None, :]
    if network.relative:
        pair = pair + (x[None, :, :2] - x[:, None, :2]) @ layer.lin_edge.weight.T
    score = torch.where(pair > 0, pair, 0.2 * pair) @ layer.att.view(-1)
    weight = score.exp() * there
    attention: Tensor = weight / weight.sum(dim=-1, keepdim=True).clamp_min(1e-30)
    return attention


def dense_location(network: OneLayer, x: Tensor, there: Tensor, mask: Tensor) -> Tensor:
    """(N, 6), (N, N) bool, (N, N) -> (N, 2): the location of each action under the mask."""
    heard = (mask * dense_attention(network, x, there)) @ network.layer.lin_l(x)
    out: Tensor = heard + network.layer.bias + network.own(x)
    return out[:, :2]
