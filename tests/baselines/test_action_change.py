"""How far a mask moves the actions: fast or by autograd, the same numbers, and each timestep for itself."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor
from xmarl_baselines.action_change import _ByAutograd, _ByStack, action_change
from xmarl_baselines.frozen_policy import frozen
from xmarl_baselines.fused_stack import ROWS

from tests.baselines.reference import TRAINED, trained
from tests.helpers.deep_policies import two_layers
from tests.helpers.policies import random_masks, random_observations, small_policy
from xmarl_bench.policy import Architecture, GraphPolicy, Policy


def by_definition(policy: Policy, observations: Tensor, mask: Tensor) -> tuple[Tensor, Tensor]:
    """D and its gradient, from the policy's own distributions."""
    mask = mask.clone().requires_grad_()
    moved = policy.distribution(observations, mask).action - policy.distribution(observations).action
    change = moved.square().sum(dim=(1, 2))
    (gradient,) = torch.autograd.grad(change.sum(), mask)
    return change.detach(), gradient


def assert_as_defined(policy: Policy, observations: Tensor, kind: type) -> None:
    n_steps, n_agents, _ = observations.shape
    mask = random_masks(n_steps, n_agents)
    change = action_change(frozen(policy), observations)
    assert type(change) is kind
    moved, gradient = change.with_gradient(mask)
    expected, slope = by_definition(policy, observations, mask)
    torch.testing.assert_close(moved, expected, rtol=1e-4, atol=1e-6)
    torch.testing.assert_close(gradient, slope, rtol=1e-4, atol=2e-6 * max(1.0, float(slope.abs().max())))
    assert torch.equal(change(mask).detach(), moved)
    torch.testing.assert_close(change.target, policy.distribution(observations).action.detach())


@pytest.mark.parametrize("n_agents", [3, 5])
@pytest.mark.parametrize("name", TRAINED)
def test_on_trained_policies(name: str, n_agents: int) -> None:
    policy, observations = trained(name, 20, n_agents)
    assert_as_defined(policy, observations, _ByStack)


@pytest.mark.parametrize("residual", [False, True])
@pytest.mark.parametrize("n_steps", [1, ROWS // 3, ROWS // 3 + 1, ROWS])
def test_any_number_of_rows(n_steps: int, residual: bool) -> None:
    policy = small_policy(6, 2, residual=residual)
    assert_as_defined(policy, random_observations(n_steps, 3, 6), _ByStack)


@pytest.mark.parametrize(
    ("after_layer", "in_decoder", "kind"),
    [
        ("tanh", "relu", _ByStack),
        ("relu", "tanh", _ByStack),
        ("identity", "identity", _ByStack),
        ("elu", "tanh", _ByAutograd),
        ("tanh", "silu", _ByAutograd),
    ],
)
@pytest.mark.parametrize("decoder", [(), (9, 7)])
def test_any_activations(after_layer: str, in_decoder: str, kind: type, decoder: tuple[int, ...]) -> None:
    torch.manual_seed(0)
    policy = GraphPolicy(
        Architecture.model_validate(
            {
                "obs_dim": 6,
                "action_dim": 3,
                "encoder": (),
                "encoder_activation": "relu",
                "gat_width": 8,
                "gat_activation": after_layer,
                "decoder": decoder,
                "decoder_activation": in_decoder,
            }
        )
    )
    kind = _ByStack if after_layer == "tanh" and not decoder else kind  # no layer, no activation
    assert_as_defined(policy, random_observations(5, 4, 6), kind)


def test_any_policy() -> None:
    assert_as_defined(two_layers(6), random_observations(3, 4, 6), _ByAutograd)


@pytest.mark.parametrize(
    "policy",
    [small_policy(6, 1), small_policy(6, 1, residual=True), two_layers(6)],
    ids=["one layer", "residual", "two"],
)
def test_the_mask_of_ones_changes_nothing(policy: Policy) -> None:
    change = action_change(frozen(policy), random_observations(4, 3, 6))
    moved, gradient = change.with_gradient(torch.ones(4, 3, 3))
    assert not moved.any()
    assert not gradient.any()


def test_timesteps_do_not_see_one_another() -> None:
    change = action_change(frozen(small_policy(6, 1)), random_observations(4, 3, 6))
    mask = random_masks(4, 3)
    other = mask.clone()
    other[2] = 1 - other[2]
    for mine, theirs in zip(change.with_gradient(mask), change.with_gradient(other), strict=True):
        assert torch.equal(mine[[0, 1, 3]], theirs[[0, 1, 3]])
        assert not torch.equal(mine[2], theirs[2])
