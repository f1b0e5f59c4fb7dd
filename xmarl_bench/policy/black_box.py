"""A policy that only answers: what an explainer gets that declares neither gradients nor weights.

It keeps a promise honest, it is no prison: whoever digs through Python's closures finds the network. What it
guards against is using by mistake what was declared unused: answers carry no gradient, there are no
parameters and no layers, and attention is told only to those who declared it.
"""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from xmarl_bench.errors import InputError
from xmarl_bench.policy import ActionDistribution, Policy

Answer = Callable[[Tensor | None], ActionDistribution]


class BlackBox(Policy):
    """Answers F and F(m) for (S, N, D) observations; nothing else of the policy has a name here."""

    def __init__(self, policy: Policy, *, attention: bool = False) -> None:
        super().__init__()
        self.graph, self.continuous_actions = policy.graph, policy.continuous_actions
        self.memory_dim = policy.memory_dim

        def prepare(observation: Tensor) -> Answer:
            with torch.no_grad():
                prepared = policy.prepare(observation)

            def answer(mask: Tensor | None) -> ActionDistribution:
                with torch.no_grad():
                    return policy.decode(prepared, mask)

            return answer

        def forward(x: Tensor, edge_index: Tensor) -> Tensor:
            with torch.no_grad():
                action: Tensor = policy(x, edge_index)
            return action

        def attended(observation: Tensor) -> Tensor:
            if not attention:
                raise InputError("attention was asked for, but is not among the accesses declared: add it.")
            with torch.no_grad():
                return policy.attention(observation)

        self._row_wise, self._prepare, self._forward, self._attended = (
            policy.row_wise, prepare, forward, attended,
        )  # fmt: skip

    @property
    def row_wise(self) -> bool:
        return self._row_wise

    def forward(self, x: Tensor, edge_index: Tensor) -> Tensor:
        """(n, D), (2, edges) -> (n, A): F(1), without gradient."""
        return self._forward(x, edge_index)

    def prepare(self, observation: Tensor) -> Answer:
        """(S, N, D) -> what answers for these observations."""
        return self._prepare(observation)

    def decode(self, prepared: Answer, mask: Tensor | None = None) -> ActionDistribution:
        """F(m), without gradient."""
        return prepared(mask)

    def attention(self, observation: Tensor) -> Tensor:
        """(S, N, D) -> (S, N, N). Raises InputError where attention is not declared."""
        return self._attended(observation)
