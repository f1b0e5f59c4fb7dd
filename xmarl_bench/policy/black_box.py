"""A policy that only answers queries: given to explainers that declare neither gradients nor weights.

Prevents accidental use of what an explainer did not declare; not a security boundary, because Python closures
still hold the network. Outputs have no gradient, there are no parameters and layers, and attention is
available only to explainers that declare it.
"""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from xmarl_bench.errors import InputError
from xmarl_bench.policy import ActionDistribution, Policy

Answer = Callable[[Tensor | None], ActionDistribution]


class BlackBox(Policy):
    """Answers F and F(m) for (S, N, D) observations, and exposes nothing else of the policy."""

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

        def act(x: Tensor, edge_index: Tensor, weight: Tensor | None) -> Tensor:
            with torch.no_grad():
                return policy.act(x, edge_index, weight)

        def attended(observation: Tensor) -> Tensor:
            if not attention:
                raise InputError(
                    "the explainer reads attention but does not declare it: add 'attention' to its accesses."
                )
            with torch.no_grad():
                return policy.attention(observation)

        self._row_wise, self._prepare, self._act, self._attended = (
            policy.row_wise, prepare, act, attended,
        )  # fmt: skip

    @property
    def row_wise(self) -> bool:
        return self._row_wise

    def act(self, x: Tensor, edge_index: Tensor, weight: Tensor | None = None) -> Tensor:
        """(n, D), (2, edges) -> (n, A): F(m), without gradient."""
        return self._act(x, edge_index, weight)

    def prepare(self, observation: Tensor) -> Answer:
        """(S, N, D) -> a function that answers for these observations."""
        return self._prepare(observation)

    def decode(self, prepared: Answer, mask: Tensor | None = None) -> ActionDistribution:
        """F(m), without gradient."""
        return prepared(mask)

    def attention(self, observation: Tensor) -> Tensor:
        """(S, N, D) -> (S, N, N). Raises InputError if the explainer does not declare attention."""
        return self._attended(observation)
