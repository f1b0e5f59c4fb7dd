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
        self.memory_dim, self.row_wise = policy.memory_dim, policy.row_wise
        # A closure, because an attribute would make its weights ours.
        self._policy: Callable[[], Policy] = lambda: policy
        self._reads_attention = attention

    @torch.no_grad()
    def act(self, x: Tensor, edge_index: Tensor, weight: Tensor | None = None) -> Tensor:
        """(n, D), (2, edges) -> (n, A): F(m), without gradient."""
        return self._policy().act(x, edge_index, weight)

    @torch.no_grad()
    def prepare(self, observation: Tensor) -> Answer:
        """(S, N, D) -> a function that answers for these observations."""
        policy = self._policy()
        prepared = policy.prepare(observation)
        return torch.no_grad()(lambda mask: policy.decode(prepared, mask))

    @torch.no_grad()
    def decode(self, prepared: Answer, mask: Tensor | None = None) -> ActionDistribution:
        """F(m), without gradient."""
        return prepared(mask)

    @torch.no_grad()
    def attention(self, observation: Tensor) -> Tensor:
        """(S, N, D) -> (S, N, N). Raises InputError if the explainer does not declare attention."""
        if not self._reads_attention:
            raise InputError(
                "the explainer reads attention but does not declare it: add 'attention' to its accesses."
            )
        return self._policy().attention(observation)
