"""The subject of an explainer's checks: its masks of a policy, on states that no score uses."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

from torch import Tensor

from xmarl_bench.checks.findings import NotApplicable
from xmarl_bench.errors import InputError
from xmarl_bench.explain.explainer import (
    Explainer,
    fit_explainer,
    mask_of_explainer,
    on_graph,
    returned_by,
    run_explainer,
)
from xmarl_bench.planted.families import planted
from xmarl_bench.policy import Policy

SEED: Final = 1
FAMILY, N_AGENTS, N_STEPS = "one-sender", 4, 20  # of the planted policy


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
        mask = mask_of_explainer(self.explainer, self.returned, *self.observations.shape[:2])
        return on_graph(mask, self.policy, self.observations)

    @cached_property
    def planted_mask(self) -> Tensor:
        """(S, N, N) on a planted policy. Raises InputError if the explainer does not explain it."""
        truth = planted(FAMILY, N_AGENTS, n_steps=N_STEPS, seed=SEED)
        without_simulator = replace(self.explainer, simulator=None)  # planted states have no episode
        ready = fit_explainer(without_simulator, truth.policy, truth.reference, SEED)
        return run_explainer(ready, truth.policy, truth.observations, SEED)

    def mask_or_skip(self) -> Tensor:
        try:
            return self.mask
        except InputError:
            raise NotApplicable("the explainer returned no valid mask.") from None

    def explain(self, observations: Tensor, seed: int = SEED) -> Tensor:
        return run_explainer(self.explainer, self.policy, observations, seed)
