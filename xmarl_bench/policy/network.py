"""The graph-attention policy and its masked forward F(m).

S is the number of timesteps (or any batch), N agents, D observation entries, W the layer's width,
A action entries. `mask[s, i, j]` scales the message on edge j -> i (sender j, receiver i).
"""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional as F
from torch_geometric.nn import GATv2Conv

from xmarl_bench.policy.architecture import Architecture, raw_width
from xmarl_bench.policy.distribution import ActionDistribution, action_distribution
from xmarl_bench.policy.interface import Policy
from xmarl_bench.policy.memory import recurrent_cell, remember
from xmarl_bench.policy.messages import followed, row_major

ACTIVATIONS: dict[str, type[nn.Module]] = {
    "tanh": nn.Tanh,
    "relu": nn.ReLU,
    "elu": nn.ELU,
    "leaky_relu": nn.LeakyReLU,
    "silu": nn.SiLU,
    "identity": nn.Identity,
}


class Prepared(NamedTuple):
    """The part of a forward pass that does not depend on the mask: computed once, used for every mask."""

    attention: Tensor  # (S, N, N), rows sum to 1: attention[s, i, j] of receiver i to sender j
    message: Tensor  # (S, N, W): W x_j of sender j
    own: Tensor  # (S, N, W): b + R x_i, added to the messages of receiver i
    # (S, N, H): the next memory if the recurrent cell is before the layer, the previous one if after it
    memory: Tensor


class GraphPolicy(Policy):
    """One graph-attention policy, shared by all agents of a team of any size.

    The layer is torch_geometric's GATv2Conv, so that PyG's explainers run on `forward`; the batched path
    `prepare` / `decode` computes the same numbers from the same parameters on the complete graph with
    self loops, for many timesteps and masks at once. A memory before the layer does not depend on the
    mask; one after it is part of decoding.
    """

    row_wise = True  # one layer: F_i depends on row i of the mask alone

    def __init__(self, architecture: Architecture) -> None:
        super().__init__()
        self.architecture = a = architecture
        self.continuous_actions = a.distribution != "categorical"
        self.encoder = mlp((a.obs_dim, *a.encoder), a.encoder_activation)
        self.memory_dim = a.memory_dim
        widths = [(a.obs_dim, *a.encoder)[-1], a.gat_width]
        self.memory = None if a.memory is None else recurrent_cell(a.memory, widths)
        # Loops are explicit edges of the graph: with add_self_loops=True, PyG silently re-orders them and so
        # reads an explainer's mask in the wrong order.
        self.gat = GATv2Conv(widths[0], a.gat_width, heads=1, add_self_loops=False, residual=a.residual)
        self.gat_activation = ACTIVATIONS[a.gat_activation]()
        n_out = raw_width(a.distribution, a.action_dim)
        self.decoder = mlp((widths[1], *a.decoder), a.decoder_activation, n_out)

    def act(self, x: Tensor, edge_index: Tensor, weight: Tensor | None = None) -> Tensor:
        """(n, D), (2, edges) -> (n, A): F(m), by PyG's message passing on any graph."""
        encoded, memory = self.encode(x)
        if weight is None:  # in the order given: PyG's explainers identify edges by position
            return self.head(self.gat(encoded, edge_index), memory)[0].action
        edge_index, weight = row_major(edge_index, len(x), weight)
        with followed(self.gat, edge_index, len(x), weight):
            return self.head(self.gat(encoded, edge_index), memory)[0].action

    def prepare(self, observation: Tensor) -> Prepared:
        """(S, N, D) -> attention and messages on the complete graph with self loops."""
        x, memory = self.encode(observation)
        message = self.gat.lin_l(x)
        receiver = self.gat.lin_r(x)
        pair = F.leaky_relu(receiver[:, :, None] + message[:, None, :], self.gat.negative_slope)
        attention = torch.softmax(pair @ self.gat.att.view(-1), dim=-1)
        own = self.gat.bias.expand_as(message) if self.gat.res is None else self.gat.res(x) + self.gat.bias
        return Prepared(attention, message, own, memory)

    def decode(
        self, prepared: Prepared, mask: Tensor | None = None, stand_in: Tensor | None = None
    ) -> ActionDistribution:
        """F(m): h_i = sum_j m_ij alpha_ij W x_j + R x_i + b, nothing renormalised, then the decoder.

        The residual R x_i is not a message, so masks do not scale it; without a residual it is 0.

        mask: (..., S, N, N) in [0, 1], any leading axes; None: the mask of ones.
        stand_in: (S, N, W) or (N, W), added as sum_j (1 - m_ij) alpha_ij stand_in_j; None: 0.
        """
        return self.decode_step(prepared, mask, stand_in)[0]

    def step(self, observation: Tensor, mask: Tensor | None = None) -> tuple[ActionDistribution, Tensor]:
        """(S, N, D) -> F(m), and (S, N, H): what agents remember at the next timestep."""
        return self.decode_step(self.prepare(observation), mask)

    def decode_step(
        self, prepared: Prepared, mask: Tensor | None = None, stand_in: Tensor | None = None
    ) -> tuple[ActionDistribution, Tensor]:
        """As `decode`, and (..., S, N, H): what agents remember at the next timestep."""
        weight = prepared.attention if mask is None else prepared.attention * mask
        hidden = weight @ prepared.message + prepared.own
        if stand_in is not None:
            hidden = hidden + (prepared.attention - weight) @ stand_in
        return self.head(hidden, prepared.memory)

    def attention(self, observation: Tensor) -> Tensor:
        """(S, N, D) -> (S, N, N): the layer's coefficients."""
        return self.prepare(observation).attention

    def encode(self, observation: Tensor) -> tuple[Tensor, Tensor]:
        """(..., D + H) -> (..., E) what the layer gets, and the memory as in `Prepared`."""
        if self.memory_dim == 0:
            return self.encoder(observation), observation[..., :0]
        seen, memory = observation.split([self.architecture.obs_dim, self.memory_dim], dim=-1)
        return remember(self.architecture.memory, self.memory, 0, self.encoder(seen), memory)

    def head(self, hidden: Tensor, memory: Tensor) -> tuple[ActionDistribution, Tensor]:
        """(..., W) output of the layer, memory as in `Prepared` -> the actions, what is remembered next."""
        active = self.gat_activation(hidden)
        decoded, memory = remember(self.architecture.memory, self.memory, 1, active, memory)
        return action_distribution(self.decoder(decoded), self.architecture.distribution), memory


def mlp(widths: tuple[int, ...], activation: str, n_out: int | None = None) -> nn.Sequential:
    """Linear layers, each with an activation after it; then, if `n_out` is given, one without."""
    layers: list[nn.Module] = []
    for n_in, width in pairwise(widths):
        layers += [nn.Linear(n_in, width), ACTIVATIONS[activation]()]
    if n_out is not None:
        layers.append(nn.Linear(widths[-1], n_out))
    return nn.Sequential(*layers)
