"""Attention divided by its row's maximum: the same ranking as `attention`, a larger mask.

Formula: mask[i, j] = alpha_ij / max_k alpha_ik, so every receiver keeps its most attended message whole.

Source: the benchmark's own, to compare with `attention`. Both rank edges alike, so where a metric prefers
this one it rewards mask mass, not the explanation.
"""

from __future__ import annotations

import torch
from torch import Tensor

from xmarl_baselines.explainers.attention import attention_mask
from xmarl_bench.explain.effect import share_of_largest
from xmarl_bench.explain.explainer import Explainer
from xmarl_bench.policy import Policy


def attention_rowmax_mask(policy: Policy, observations: Tensor, generator: torch.Generator) -> Tensor:
    """(S, N, D) -> (S, N, N), the largest entry of every row is 1."""
    return share_of_largest(attention_mask(policy, observations, generator))


attention_rowmax = Explainer(
    "attention-rowmax",
    attention_rowmax_mask,
    "attention divided by its row's maximum: same ranking, more mass",
    hyperparameters={"heads": "mean", "layers": "mean"},
)
