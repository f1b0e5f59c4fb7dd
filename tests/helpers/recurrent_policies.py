"""Policies with memory and random weights: from the closed list, and networks given as code."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor, nn
from torch_geometric.nn import GATv2Conv

from xmarl_bench.policy import GraphPolicy, LayeredArchitecture, build_policy
from xmarl_bench.policy.build import LayeredPolicy
from xmarl_bench.policy.shapes import weight_shapes

ONE_LAYER = ({"conv": "GATv2Conv", "width": 8, "residual": True, "activation": "tanh"},)
TWO_LAYERS = (
    {"conv": "GATConv", "width": 4, "heads": 2, "activation": "elu"},
    {"conv": "TransformerConv", "width": 5, "activation": "tanh"},
)


def remembering(
    cell: str, after: int, layers: tuple[dict[str, Any], ...] = ONE_LAYER, width: int = 5
) -> LayeredArchitecture:
    """An architecture for observations of 6 entries."""
    return LayeredArchitecture.model_validate(
        {
            "obs_dim": 6,
            "encoder": (7,),
            "encoder_activation": "relu",
            "layers": layers,
            "memory": {"cell": cell, "width": width, "after": after},
            "decoder": (9,),
            "decoder_activation": "tanh",
        }
    )


def random_weights(architecture: LayeredArchitecture) -> dict[str, Tensor]:
    """Weights large enough that messages and memories matter."""
    generator = torch.Generator().manual_seed(0)
    return {
        name: torch.randn(shape, generator=generator) * 0.6
        for name, shape in weight_shapes(architecture).items()
    }


def recurrent_policy(architecture: LayeredArchitecture) -> GraphPolicy | LayeredPolicy:
    """A policy with random weights; GATv2 of one head takes the fast path."""
    return build_policy(architecture, random_weights(architecture))


@torch.no_grad()
def drawn(network: nn.Module) -> None:
    """Set all parameters to random numbers, the same in every process."""
    generator = torch.Generator().manual_seed(0)
    for parameter in network.parameters():
        parameter.copy_(torch.randn(parameter.shape, generator=generator) * 0.6)


class AttentionThenGru(nn.Module):
    """Messages go into an agent's memory, from which it computes its action."""

    def __init__(self) -> None:
        super().__init__()
        self.layer = GATv2Conv(6, 8, add_self_loops=False)
        self.gru = nn.GRUCell(8, 5)
        self.decoder = nn.Linear(5, 4)
        drawn(self)

    def initial_state(self, n: int) -> Tensor:
        return torch.zeros(n, 5)

    def step(self, x: Tensor, edge_index: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
        state = self.gru(torch.tanh(self.layer(x, edge_index)), state)
        return self.decoder(state), state


class LstmThenAttention(nn.Module):
    """Observations go into an agent's memory, from which messages are computed."""

    def __init__(self) -> None:
        super().__init__()
        self.lstm = nn.LSTMCell(6, 5)
        self.layer = GATv2Conv(5, 8, heads=2, add_self_loops=False)
        self.decoder = nn.Linear(16, 4)
        drawn(self)

    def initial_state(self, n: int) -> tuple[Tensor, Tensor]:
        return torch.zeros(n, 5), torch.ones(n, 5)

    def step(
        self, x: Tensor, edge_index: Tensor, state: tuple[Tensor, Tensor]
    ) -> tuple[Tensor, tuple[Tensor, Tensor]]:
        h, c = self.lstm(x, state)
        return self.decoder(torch.tanh(self.layer(h, edge_index))), (h, c)
