"""Degenerate explanations, made from right ones: their metrics, and the checks that find them.

All but the constant are as detailed as the right ranking, Shapley values of messages, and wrong in a known
way. Metrics cannot find each of them: if states change slowly, the mask of the previous state is nearly
right. The checks of explainers must find all.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from xmarl_bench.checks import run_checks
from xmarl_bench.checks.degenerate_checks import DEGENERATE_CHECKS
from xmarl_bench.checks.explainer_checks import CHECKS
from xmarl_bench.checks.explainer_subject import ExplainerSubject
from xmarl_bench.explain.explainer import Explain, Explainer
from xmarl_bench.meta.curves import states_of
from xmarl_bench.meta.right_ranking import shapley_mask
from xmarl_bench.policy import Policy, PolicyCard
from xmarl_bench.reproducible import one_thread

METRICS: Final = ("fid_delta", "budgeted_fidelity", "comm_budgeted_fidelity", "message_fidelity")
RIGHT: Final = "right ranking"
CHECKED: Final = {**DEGENERATE_CHECKS, "order of timesteps": CHECKS["order of timesteps"]}


@dataclass(frozen=True)
class Degenerate:
    """Metrics of an explanation of one policy, and the checks that it fails."""

    policy: str
    kind: str
    values: dict[str, float]  # of METRICS, mean over episodes
    failed: tuple[str, ...]


def degenerate_scores(
    policy: Policy, card: PolicyCard, other: Policy, *, episodes: int = 5, seed: int = 0
) -> list[Degenerate]:
    """Every kind, on every timestep of the policy's scoring episodes. other: a policy to copy from."""
    values: dict[str, list[NDArray[np.float64]]] = {}
    kinds = kinds_of(other)
    observations: list[Tensor] = []
    with one_thread():
        for states, _ in states_of(policy, card, episodes=episodes, timesteps=None, seed=seed):
            observations.append(states.observations)
            for name, explain in kinds.items():
                row = states.mask_metrics(explain(policy, states.observations, torch.Generator()))
                each = np.array([getattr(row, metric) for metric in METRICS], dtype=np.float64)
                values.setdefault(name, []).append(each)
        spread = torch.cat([x[:: max(1, len(x) // 6)] for x in observations])
        return [
            Degenerate(
                card.name,
                name,
                dict(
                    zip(
                        METRICS,
                        np.nanmean(values[name], axis=0).tolist(),
                        strict=True,
                    )
                ),
                failed_checks(explain, policy, spread),
            )
            for name, explain in kinds.items()
        ]


def failed_checks(explain: Explain, policy: Policy, observations: Tensor) -> tuple[str, ...]:
    """Names of CHECKED that an explainer fails on a policy and states (S, N, D)."""
    subject = ExplainerSubject(Explainer("degenerate", explain), policy, observations)
    return tuple(each.check for each in run_checks(CHECKED, subject) if each.passed is False)


def kinds_of(other: Policy) -> dict[str, Explain]:
    """Name -> explanation, the right ranking first."""
    changes: dict[str, Callable[[Tensor], Tensor]] = {
        "constant": torch.ones_like,
        "first state for all": lambda mask: mask[:1].expand_as(mask).clone(),
        "one ranking for all receivers": _same_for_receivers,
        "state before": lambda mask: mask.roll(1, dims=0),
        "state half an episode away": lambda mask: mask.roll(len(mask) // 2, dims=0),
    }
    return {
        RIGHT: shapley_mask,
        **{
            name: lambda *asked, change=change: change(shapley_mask(*asked))
            for name, change in changes.items()
        },
        "another policy": lambda _, observations, generator: shapley_mask(other, observations, generator),
    }


def _same_for_receivers(mask: Tensor) -> Tensor:
    """Each sender at its mean over receivers; own edges stay."""
    own = torch.eye(mask.shape[-1])
    column = (mask * (1.0 - own)).sum(dim=1, keepdim=True) / (mask.shape[-1] - 1)
    return column * (1.0 - own) + mask * own
