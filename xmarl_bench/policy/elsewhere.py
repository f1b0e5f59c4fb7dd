"""A policy whose code runs in a process of its own, where its explainers run as well."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any

from torch import Tensor

from xmarl_bench.policy.interface import Policy


class PolicyElsewhere(Policy):
    """Answers as its network does, to the bit. It holds no weights here."""

    key: str  # what its function and code are hashed to

    @abstractmethod
    def step_teams(self, observation: Tensor, mask: Tensor | None) -> tuple[Tensor, Tensor]:
        """See `xmarl_bench.policy.teams_apart.StepTeams`."""

    @abstractmethod
    def shuffled(self, seed: int) -> PolicyElsewhere:
        """The policy with the weights of `xmarl_bench.explain.sanity.shuffled_weights`."""

    @abstractmethod
    def taking(self, explainer: Any) -> Any:
        """A shipped explainer in the process that holds the network: an `Elsewhere` of explain.explainer."""
