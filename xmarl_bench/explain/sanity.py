"""Checks that an explanation depends on the weights, and not on the seed.

Both checks use a few timesteps of a few episodes, because they run the explainer several more times.
Sources: Adebayo et al., "Sanity Checks for Saliency Maps" (NeurIPS 2018), model parameter randomisation;
Agarwal et al. (GraphXAI, 2023), stability.
"""

from __future__ import annotations

import copy
from itertools import combinations

import numpy as np
import torch
from torch import Tensor

from xmarl_bench.explain.explainer import Explainer, fit_explainer, run_explainer
from xmarl_bench.metrics import rank_correlation
from xmarl_bench.policy import Policy, existing_edges
from xmarl_bench.policy.elsewhere import PolicyElsewhere
from xmarl_bench.reproducible import derived_seed

SEEDS = 3


def seed_stability(
    explainer: Explainer, policy: Policy, observations: Tensor, mask: Tensor, seed: int
) -> float:
    """Mean rank correlation of the masks (S, N, N) of SEEDS seeds, `mask` the first; 1 is perfectly stable.

    NaN if a mask ranks nothing. For stochastic explainers only.
    """
    masks = [mask.numpy()] + [
        run_explainer(explainer, policy, observations, derived_seed("stability", seed, k)).numpy()
        for k in range(1, SEEDS)
    ]
    edges = existing_edges(policy, observations)
    return float(np.mean([rank_correlation(one, other, edges) for one, other in combinations(masks, 2)]))


def weight_randomisation(
    explainer: Explainer, policy: Policy, observations: Tensor, mask: Tensor, seed: int
) -> float:
    """Rank correlation of `mask` (S, N, N) with the mask of the same policy with shuffled weights.

    Should be near 0: shuffling destroys what the policy learned. NaN if a mask ranks nothing.
    """
    other = mask_of_shuffled_weights(explainer, policy, observations, seed)
    return rank_correlation(mask.numpy(), other.numpy(), existing_edges(policy, observations))


def mask_of_shuffled_weights(explainer: Explainer, policy: Policy, observations: Tensor, seed: int) -> Tensor:
    """(S, N, D) -> (S, N, N): what the explainer says of the policy once its weights are shuffled."""
    shuffled = shuffled_weights(policy, derived_seed("shuffled weights", seed))
    if explainer.fitted_on is not None:  # fit it anew to the shuffled weights
        refit = derived_seed("shuffled fit", seed)
        explainer = fit_explainer(explainer, shuffled, explainer.fitted_on, refit)
    return run_explainer(explainer, shuffled, observations, derived_seed("shuffled", seed))


def shuffled_weights(policy: Policy, seed: int) -> Policy:
    """A copy with the entries of every parameter tensor in random order: same scales, nothing learned."""
    if isinstance(policy, PolicyElsewhere):
        return policy.shuffled(seed)
    generator = torch.Generator().manual_seed(seed)
    shuffled = copy.deepcopy(policy)
    with torch.no_grad():
        for parameter in shuffled.parameters():
            order = torch.randperm(parameter.numel(), generator=generator)
            parameter.copy_(parameter.flatten()[order].view_as(parameter))
    return shuffled
