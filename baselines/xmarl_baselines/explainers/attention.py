"""Attention as explanation: the mask is the layer's own softmax coefficients.

Paper: Kailas, Jain and Ravichandar (ICML 2025), who ask when attention explains a team; for graphs,
Velickovic et al. (ICLR 2018). Formula: mask[i, j] = alpha_ij, with alpha_i = softmax_j of the GATv2 scores
of receiver i, so every row sums to 1 and the mask's mass is 1 / N, whatever the policy.

Departures: none from PyG's AttentionExplainer on a layer of one head (a test holds the two together); all
timesteps are computed at once. PyG's default reduction, the maximum over heads, would with several heads
make rows that sum to more than 1.
"""

from __future__ import annotations

import torch
from torch import Tensor

from xmarl_bench.explainer import Explainer
from xmarl_bench.policy import GraphPolicy


def attention_mask(policy: GraphPolicy, observations: Tensor, generator: torch.Generator) -> Tensor:
    """(S, N, D) -> (S, N, N)."""
    with torch.no_grad():
        return policy.prepare(observations).attention


attention = Explainer("attention", attention_mask, "the attention coefficients themselves")
