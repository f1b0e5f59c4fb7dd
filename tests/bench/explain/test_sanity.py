"""Sanity of explainers: stability between seeds, and dependence on the policy's weights."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from tests.helpers.policies import random_observations, small_policy
from xmarl_bench.explain.controls import CONTROLS
from xmarl_bench.explain.explainer import Explainer, run_explainer
from xmarl_bench.explain.sanity import seed_stability, shuffled_weights, weight_randomisation
from xmarl_bench.policy import Policy


def attended(policy: Policy, observations: Tensor, generator: torch.Generator) -> Tensor:
    with torch.no_grad():
        return policy.attention(observations)


def nearest(policy: Policy, observations: Tensor, generator: torch.Generator) -> Tensor:
    return torch.exp(-torch.cdist(observations[..., :2], observations[..., :2]))


ATTENDED, NEAREST = Explainer("attended", attended), Explainer("nearest", nearest)


def checks(explainer: Explainer) -> tuple[float, float]:
    policy, observations = small_policy(6, 1), random_observations(60, 5, 6)
    mask = run_explainer(explainer, policy, observations, 0)
    return (
        seed_stability(explainer, policy, observations, mask, 0),
        weight_randomisation(explainer, policy, observations, mask, 0),
    )


def test_ignoring_the_seed_is_stable_and_ignoring_the_policy_fails() -> None:
    stability, randomised = checks(NEAREST)
    assert math.isclose(stability, 1.0)
    assert math.isclose(randomised, 1.0)  # depends only on the observations
    stability, randomised = checks(ATTENDED)
    assert math.isclose(stability, 1.0)
    assert randomised < 0.9


def test_noise_is_neither_stable_nor_dependent_on_weights() -> None:
    stability, randomised = checks(CONTROLS["random"])
    assert abs(stability) < 0.15  # 3 pairs of 300 rows
    assert abs(randomised) < 0.25


def test_masks_that_rank_nothing_have_no_values() -> None:
    assert all(math.isnan(value) for value in checks(CONTROLS["all-ones"]))


def test_shuffling_keeps_every_weight_in_its_tensor() -> None:
    policy = small_policy(6)
    before = {name: tensor.clone() for name, tensor in policy.state_dict().items()}
    shuffled = shuffled_weights(policy, 3).state_dict()
    for name, tensor in policy.state_dict().items():
        assert torch.equal(tensor, before[name])
        assert torch.equal(tensor.flatten().sort().values, shuffled[name].flatten().sort().values)
    assert not torch.equal(shuffled["gat.lin_l.weight"], before["gat.lin_l.weight"])
    again, other = (shuffled_weights(policy, seed).state_dict()["gat.lin_l.weight"] for seed in (3, 4))
    assert torch.equal(again, shuffled["gat.lin_l.weight"])
    assert not torch.equal(other, again)
