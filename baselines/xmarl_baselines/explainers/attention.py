"""Attention as explanation: the mask is the layer's own softmax coefficients.

Paper: Kailas, Jain and Ravichandar (ICML 2025), who ask when attention explains a team; for graphs,
Velickovic et al. (ICLR 2018). Formula: mask[i, j] = alpha_ij, with alpha_i = softmax_j of the scores of
receiver i. Rows of a softmax sum to 1, so the mask mass is then 1 / N.

Departures: heads and layers are averaged, so that a row sums to 1. PyG's AttentionExplainer takes the
maximum, so rows of several heads exceed 1. With one head and one layer the two agree (tested).
"""

from __future__ import annotations

import torch
from torch import Tensor

from xmarl_baselines.explainers.batching import by_chunks
from xmarl_bench.explain.explainer import Explainer
from xmarl_bench.policy import Policy


def attention_mask(policy: Policy, observations: Tensor, generator: torch.Generator) -> Tensor:
    """(S, N, D) -> (S, N, N)."""
    with torch.no_grad():
        return by_chunks(observations, lambda steps: policy.attention(observations[steps]))


attention = Explainer(
    "attention",
    attention_mask,
    "the attention coefficients themselves",
    hyperparameters={"heads": "mean", "layers": "mean"},
)
