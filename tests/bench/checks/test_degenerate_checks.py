"""Every kind of degenerate explanation fails its own check and none of the others."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor

from tests.helpers.policies import random_observations, small_policy
from xmarl_bench import as_explainer
from xmarl_bench.checks import run_checks
from xmarl_bench.checks.degenerate_checks import (
    DEGENERATE_CHECKS,
    mean_over_receivers,
    mean_over_states,
    sameness,
)
from xmarl_bench.checks.explainer_checks import CHECKS
from xmarl_bench.checks.explainer_subject import ExplainerSubject
from xmarl_bench.explain.controls import CONTROLS
from xmarl_bench.explain.explainer import Explainer
from xmarl_bench.policy import Policy


def attended(observations: Tensor, policy: Policy) -> Tensor:
    return policy.attention(observations)


def constant(observations: Tensor, policy: Policy) -> Tensor:
    """All messages get the same value; only own edges differ."""
    return 0.5 + 0.5 * torch.eye(observations.shape[1]).repeat(len(observations), 1, 1)


def of_the_first_state(observations: Tensor, policy: Policy) -> Tensor:
    return policy.attention(observations[:1]).repeat(len(observations), 1, 1)


def of_the_sender(observations: Tensor, policy: Policy) -> Tensor:
    return policy.attention(observations).mean(dim=1, keepdim=True).expand(-1, observations.shape[1], -1)


def of_the_state_before(observations: Tensor, policy: Policy) -> Tensor:
    return policy.attention(observations.roll(1, dims=0))


def of_another_policy(observations: Tensor, policy: Policy) -> Tensor:
    generator = torch.Generator().manual_seed(observations.shape[-1])
    x = torch.cat([observations, torch.ones_like(observations[..., :1])], dim=-1)
    keys = x @ torch.randn(x.shape[-1], 4, generator=generator)
    queries = x @ torch.randn(x.shape[-1], 4, generator=generator)
    return torch.softmax(queries @ keys.mT, dim=-1)


def failed(thing: object) -> set[str]:
    explainer = thing if isinstance(thing, Explainer) else as_explainer(thing)
    subject = ExplainerSubject(explainer, small_policy(6), random_observations(12, 3, 6))
    asked = {**DEGENERATE_CHECKS, "order of timesteps": CHECKS["order of timesteps"]}
    return {each.check for each in run_checks(asked, subject) if each.passed is False}


@pytest.mark.parametrize(
    ("explain", "found"),
    [
        (attended, set()),
        (constant, {"tells messages apart"}),
        (of_the_first_state, {"follows the state", "order of timesteps"}),
        (of_the_sender, {"follows the receiver"}),
        (of_the_state_before, {"order of timesteps"}),
        (of_another_policy, {"follows the policy"}),
    ],
)
def test_each_kind_fails_exactly_its_own_checks(explain: object, found: set[str]) -> None:
    assert failed(explain) == found


def test_a_random_mask_fails_the_checks_of_dependence() -> None:
    def drawn(observations: Tensor, policy: Policy, generator: torch.Generator) -> Tensor:
        return torch.rand(len(observations), 3, 3, generator=torch.Generator().manual_seed(0))

    assert "follows the policy" in failed(drawn)


@pytest.mark.parametrize("explainer", [CONTROLS["all-ones"], CONTROLS["random"]], ids=lambda each: each.name)
def test_the_checks_do_not_apply_to_controls(explainer: Explainer) -> None:
    assert failed(explainer) == set()


def test_the_checks_do_not_apply_to_two_agents() -> None:
    subject = ExplainerSubject(as_explainer(constant), small_policy(6), random_observations(4, 2, 6))
    assert {each.passed for each in run_checks(DEGENERATE_CHECKS, subject)} == {None}


def test_sameness_by_hand() -> None:
    """Receiver 0 ranks 1 above 2 in both states; receiver 1 ranks them differently in each."""
    mask = np.full((2, 3, 3), 0.5)
    mask[:, 0, 1:] = 0.9, 0.1
    mask[0, 1, [0, 2]] = 0.9, 0.1
    mask[1, 1, [0, 2]] = 0.1, 0.9
    # Ranks are +-1/2. The mean ranks nothing for receivers 1 and 2: 2 of 4 ranking rows equal the mean's.
    assert sameness(mask, mean_over_states) == pytest.approx(2 / np.sqrt(4 * 2))
    alike = np.broadcast_to(np.array([0.1, 0.5, 0.9]), (2, 3, 3)).copy()
    assert sameness(alike, mean_over_receivers) == pytest.approx(1.0)
    assert mean_over_receivers(mask)[0, 0] == pytest.approx([0.7, 0.7, 0.1])
    assert np.isnan(sameness(np.ones((2, 3, 3)), mean_over_states))
