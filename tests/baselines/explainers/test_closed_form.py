"""F and its gradient in closed form against autograd through `decode`: the same numbers."""

from __future__ import annotations

import pytest
import torch
from xmarl_baselines.explainers.closed_form import actions_of
from xmarl_baselines.explainers.frozen_policy import frozen

from tests.helpers.policies import ROUNDING, random_masks, random_observations, small_policy
from xmarl_bench.explain.messages_only import OwnKept
from xmarl_bench.policy import Policy


def check(policy: Policy, n_agents: int = 4) -> str:
    """Compares two masks in turn, the second one not differentiated, and returns how F was computed."""
    observations = random_observations(7, n_agents, 5, 1)
    with torch.no_grad():
        prepared = policy.prepare(observations)
    actions = actions_of(policy, prepared)
    for seed in (2, 3):
        mask = random_masks(7, n_agents, seed).requires_grad_()
        expected = policy.decode(prepared, mask).action
        torch.testing.assert_close(actions.of(mask), expected, rtol=0, atol=ROUNDING)
        slope = torch.randn(expected.shape, generator=torch.Generator().manual_seed(seed))
        (gradient,) = torch.autograd.grad(expected, [mask], slope)
        assert gradient.abs().max() > 1e-4
        torch.testing.assert_close(actions.gradient(slope), gradient, rtol=0, atol=ROUNDING)
        actions.of(torch.zeros_like(mask))
    return type(actions).__name__


@pytest.mark.parametrize("n_agents", [1, 3, 5])
@pytest.mark.parametrize("residual", [False, True], ids=["plain", "residual"])
def test_the_closed_form_equals_autograd(n_agents: int, residual: bool) -> None:
    policy = small_policy(5, 1, residual=residual)
    assert check(frozen(policy), n_agents) == "_ClosedForm"
    assert check(policy, n_agents) == "_ClosedForm"
    policy.gat_activation = policy.decoder[1] = torch.nn.ReLU()
    assert check(policy, n_agents) == "_ClosedForm"


def test_other_policies_use_autograd() -> None:
    assert check(small_policy(5, 1, categorical=True)) == "_Autograd"
    assert check(OwnKept(small_policy(5, 1))) == "_Autograd"
    unknown = small_policy(5, 1)
    unknown.decoder[1] = torch.nn.SiLU()
    assert check(unknown) == "_Autograd"
