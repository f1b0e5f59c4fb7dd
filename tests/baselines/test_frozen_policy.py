"""The frozen copy is the same function, with the same gradient of the mask, and the policy stays as it is."""

from __future__ import annotations

import copy

import pytest
import torch
from torch import Tensor, nn
from xmarl_baselines.frozen_policy import Fused, frozen

from tests.baselines.reference import TRAINED, trained
from tests.helpers.deep_policies import two_layers
from tests.helpers.policies import random_masks, random_observations, small_policy
from xmarl_bench.policy import Architecture, GraphPolicy, Policy


def action_and_gradient(policy: Policy, observations: Tensor, mask: Tensor) -> tuple[Tensor, Tensor]:
    mask = mask.clone().requires_grad_()
    action = policy.distribution(observations, mask).action
    return action.detach(), torch.autograd.grad(action.square().sum(), mask)[0]


@pytest.mark.parametrize("name", TRAINED)
def test_same_action_and_gradient_on_trained_policies(name: str) -> None:
    policy, observations = trained(name, 30)
    masks = random_masks(30, 3)
    private = frozen(policy)
    assert isinstance(private.decoder[0], Fused)
    for ours, theirs in zip(
        action_and_gradient(private, observations, masks),
        action_and_gradient(policy, observations, masks),
        strict=True,
    ):
        torch.testing.assert_close(ours, theirs, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("activation", ["relu", "tanh"])
@pytest.mark.parametrize("decoder", [(), (9,), (9, 8, 7)])
def test_any_decoder(activation: str, decoder: tuple[int, ...]) -> None:
    torch.manual_seed(0)
    record = dict(obs_dim=6, encoder=(), encoder_activation="relu", gat_width=8, gat_activation="tanh")
    policy = GraphPolicy(
        Architecture.model_validate({**record, "decoder": decoder, "decoder_activation": activation})
    )
    observations, masks = random_observations(5, 4, 6), random_masks(5, 4)
    for ours, theirs in zip(
        action_and_gradient(frozen(policy), observations, masks),
        action_and_gradient(policy, observations, masks),
        strict=True,
    ):
        torch.testing.assert_close(ours, theirs, rtol=1e-5, atol=1e-6)


def test_what_cannot_be_fused_is_left_as_it_is() -> None:
    assert not isinstance(frozen(small_policy(6).double()).decoder[0], Fused)
    odd = small_policy(6)
    odd.decoder = nn.Sequential(nn.Linear(8, 8), nn.Tanh(), nn.ReLU(), nn.Linear(8, 4))
    assert not isinstance(frozen(odd).decoder[0], Fused)
    observations = random_observations(2, 3, 6)
    for policy in (odd, two_layers(6)):
        with torch.no_grad():
            same = frozen(policy).distribution(observations).loc
            torch.testing.assert_close(same, policy.distribution(observations).loc, rtol=0, atol=1e-6)


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


def test_a_frozen_policy_can_be_copied() -> None:
    private, observations = frozen(small_policy(6)), random_observations(2, 3, 6)
    same = copy.deepcopy(private).distribution(observations).loc
    assert torch.equal(same, private.distribution(observations).loc)
