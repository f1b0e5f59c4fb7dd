"""The frozen copy is the same function with the same gradient of the mask; the policy is unchanged."""

from __future__ import annotations

import copy

import pytest
import torch
from torch import Tensor, nn
from xmarl_baselines.explainers.frozen_policy import frozen

from tests.baselines.reference import TRAINED, trained
from tests.helpers.deep_policies import two_layers
from tests.helpers.policies import random_masks, random_observations, small_policy
from xmarl_bench.policy import Architecture, GraphPolicy, Policy


def action_and_gradient(policy: Policy, observations: Tensor, mask: Tensor) -> tuple[Tensor, Tensor]:
    mask = mask.clone().requires_grad_()
    action = policy.distribution(observations, mask).action
    return action.detach(), torch.autograd.grad(action.square().sum(), mask)[0]


def assert_same_function(policy: Policy, observations: Tensor, mask: Tensor, precision: float) -> None:
    for ours, theirs in zip(
        action_and_gradient(frozen(policy), observations, mask),
        action_and_gradient(policy, observations, mask),
        strict=True,
    ):
        torch.testing.assert_close(ours, theirs, rtol=10 * precision, atol=precision)


@pytest.mark.parametrize("name", TRAINED)
def test_same_action_and_gradient_on_trained_policies(name: str) -> None:
    policy, observations = trained(name, 30)
    assert_same_function(policy, observations, random_masks(30, 3), 1e-5)


@pytest.mark.parametrize("residual", [False, True])
@pytest.mark.parametrize("activation", ["relu", "tanh"])
@pytest.mark.parametrize("decoder", [(), (9,), (9, 8, 7)])
def test_any_decoder(activation: str, decoder: tuple[int, ...], residual: bool) -> None:
    torch.manual_seed(0)
    record = dict(obs_dim=6, encoder=(), encoder_activation="relu", gat_width=8, gat_activation="tanh")
    shape = {"decoder": decoder, "decoder_activation": activation, "residual": residual}
    policy = GraphPolicy(Architecture.model_validate({**record, **shape})).double()
    observations, masks = random_observations(5, 4, 6).double(), random_masks(5, 4).double()
    assert_same_function(policy, observations, masks, 1e-12)
    replaced = sum(isinstance(module, nn.Sigmoid) for module in frozen(policy).decoder)
    assert replaced == (len(decoder) if activation == "tanh" else 0)


def test_other_decoders_and_policies_stay_the_same_function() -> None:
    odd = small_policy(6)
    odd.decoder = nn.Sequential(
        nn.Tanh(), nn.Linear(8, 8), nn.Tanh(), nn.Tanh(), nn.Linear(8, 8), nn.ReLU(), nn.Linear(8, 4)
    )
    for policy in (odd, two_layers(6)):
        assert_same_function(policy, random_observations(2, 3, 6), random_masks(2, 3), 1e-6)


def test_the_policy_is_not_touched_and_the_copy_needs_no_gradient() -> None:
    policy = small_policy(6).train()
    before = copy.deepcopy(policy)
    private = frozen(policy)
    assert not private.training
    assert not any(parameter.requires_grad for parameter in private.parameters())
    assert policy.training
    assert all(parameter.requires_grad for parameter in policy.parameters())
    assert str(policy) == str(before)
    for mine, theirs in zip(policy.parameters(), before.parameters(), strict=True):
        assert torch.equal(mine, theirs)
        assert mine.data_ptr() not in {parameter.data_ptr() for parameter in private.parameters()}
