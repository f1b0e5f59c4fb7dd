"""What explainers and metrics ask of a policy, whatever network stands behind it.

S is the number of timesteps (or any batch), N agents, D observation entries, A action entries.
`mask[s, i, j]` scales the message on edge j -> i (sender j, receiver i) in every layer that passes messages.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn


class ActionDistribution(NamedTuple):
    """A TanhNormal per agent and action entry: tanh of a Normal(loc, scale)."""

    loc: Tensor  # (..., N, A)
    scale: Tensor  # (..., N, A), positive

    @property
    def action(self) -> Tensor:
        """(..., N, A) in (-1, 1): the deterministic action tanh(loc), what the metrics compare."""
        return torch.tanh(self.loc)


class Policy(nn.Module, ABC):
    """A policy shared by all agents of a team on the complete graph with self loops.

    `GraphPolicy` computes one attention layer in closed form and fast; `ModulePolicy` takes any network of
    torch_geometric layers. Both give the same numbers where both apply.
    """

    @property
    @abstractmethod
    def row_wise(self) -> bool:
        """Whether F_i depends on row i of the mask alone, as with a single layer that passes messages."""

    @abstractmethod
    def forward(self, x: Tensor, edge_index: Tensor) -> Tensor:
        """(n, D), (2, edges) -> (n, A) deterministic actions, by PyG's message passing on any graph."""

    @abstractmethod
    def prepare(self, observation: Tensor) -> Any:
        """(S, N, D) -> what of the forward pass does not depend on the mask: computed once, for `decode`."""

    @abstractmethod
    def decode(self, prepared: Any, mask: Tensor | None = None) -> ActionDistribution:
        """F(m). mask: (..., S, N, N) in [0, 1], any leading axes; None is the mask of ones."""

    @abstractmethod
    def attention(self, observation: Tensor) -> Tensor:
        """(S, N, D) -> (S, N, N), rows sum to 1: the mean of the coefficients over heads and layers.

        Raises InputError where no layer attends.
        """

    def distribution(self, observation: Tensor, mask: Tensor | None = None) -> ActionDistribution:
        """(S, N, D) observations -> the action distributions under the mask."""
        return self.decode(self.prepare(observation), mask)
