"""The subject of an explainer's checks: its masks of a policy, on states that no score uses."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Final

from torch import Tensor

from xmarl_bench.checks.findings import NotApplicable
from xmarl_bench.errors import InputError
from xmarl_bench.explain.explainer import Explainer, mask_of_explainer, returned_by, run_explainer
from xmarl_bench.policy import Policy

SEED: Final = 1


@dataclass(frozen=True)
class ExplainerSubject:
    """An explainer, fitted if it needs fitting, with a policy and states that no score uses."""

    explainer: Explainer
    policy: Policy
    observations: Tensor  # (S, N, D)

    @cached_property
    def returned(self) -> object:
        return returned_by(self.explainer, self.policy, self.observations, SEED)

    @cached_property
    def mask(self) -> Tensor:
        """(S, N, N). Raises InputError if the explainer returned no valid mask."""
        return mask_of_explainer(self.explainer, self.returned, *self.observations.shape[:2])

    def mask_or_skip(self) -> Tensor:
        try:
            return self.mask
        except InputError:
            raise NotApplicable("the explainer returned no valid mask.") from None

    def explain(self, observations: Tensor, seed: int = SEED) -> Tensor:
        return run_explainer(self.explainer, self.policy, observations, seed)
