"""Integrated gradients of the factors on messages, from all dropped to all kept.

Paper: Sundararajan, Taly and Yan, "Axiomatic Attribution for Deep Networks" (ICML 2017). Formula:

    a_ij = integral over t in [0, 1] of  d e_i(m) / d m_ij  at m = t,

by the midpoint rule, with the effect e_i of xmarl_bench.explain.effect. A row sums to e_i(1) = d_i(0), the
change caused by removing all messages, up to the rule's error (completeness, tested). In a policy of several
layers the sum of e over all agents is integrated, and all rows together sum to its value.

Departures: the mask is 0.5 + a / (2 max |a|) over the row, which keeps order and sign.
"""

from __future__ import annotations

import torch
from torch import Tensor

from xmarl_baselines.explainers.batching import by_chunks
from xmarl_baselines.explainers.frozen_policy import frozen
from xmarl_baselines.explainers.gradient import gradient_at
from xmarl_bench.explain.effect import NORMALISER, signed_to_unit
from xmarl_bench.explain.explainer import Explainer
from xmarl_bench.explain.messages_only import messages_only
from xmarl_bench.metrics.absence import Absence
from xmarl_bench.policy import Policy

POINTS = 32


def midpoints(n: int) -> list[float]:
    """The midpoints of n equal intervals of [0, 1]."""
    return [(k + 0.5) / n for k in range(n)]


def integrated_gradients_mask(policy: Policy, observations: Tensor, generator: torch.Generator) -> Tensor:
    """(S, N, D) -> (S, N, N)."""
    policy = frozen(policy)

    def explain(steps: slice) -> Tensor:
        return signed_to_unit(gradient_at(policy, observations[steps], midpoints(POINTS)))

    return by_chunks(observations, explain)


integrated_gradients = Explainer(
    "integrated_gradients",
    integrated_gradients_mask,
    "gradients integrated from no message to all messages",
    hyperparameters={"points": POINTS, "rule": "midpoint", "normaliser": NORMALISER},
    absence=Absence.ZERO,
)

integrated_gradients_messages = messages_only(integrated_gradients)
