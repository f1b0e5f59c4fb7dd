"""Masks are checked, never repaired; explainers change neither policy, observations nor global state."""

from __future__ import annotations

import random

import numpy as np
import pytest
import torch
from torch import Tensor
from torch_geometric.explain import GraphMaskExplainer

from tests.helpers.example_plugins import BAD, vandal
from tests.helpers.policies import random_observations, small_policy
from xmarl_bench.errors import InputError
from xmarl_bench.explain.controls import CONTROLS
from xmarl_bench.explain.explainer import Explainer, run_explainer
from xmarl_bench.explain.returned_mask import checked_mask
from xmarl_bench.policy import Policy


@pytest.mark.parametrize("name", sorted(BAD))
def test_an_invalid_mask_is_refused_with_the_explainers_name(name: str) -> None:
    with pytest.raises(InputError) as raised:
        run_explainer(BAD[name], small_policy(6), random_observations(4, 3, 6), 0)
    message = str(raised.value)
    assert repr(name) in message
    assert "\n" not in message


def test_a_valid_mask_is_returned_unchanged() -> None:
    mask = torch.tensor([[[0.0, 1.0], [0.25, 0.5]]], dtype=torch.float64, requires_grad=True)
    checked = checked_mask("x", mask, 1, 2)
    assert checked.dtype == torch.float32
    assert not checked.requires_grad
    assert torch.equal(checked, mask.detach().float())


def test_an_explainer_cannot_change_the_policy_or_the_random_state() -> None:
    policy, observations = small_policy(6), random_observations(4, 3, 6)
    before = {key: tensor.clone() for key, tensor in policy.state_dict().items()}
    action, seen = policy.distribution(observations).action.detach(), observations.clone()
    torch.manual_seed(3)
    expected = torch.rand(5)
    torch.manual_seed(3)
    first = run_explainer(vandal, policy, observations, 9)
    assert torch.equal(torch.rand(5), expected)
    assert torch.equal(observations, seen)
    assert all(torch.equal(tensor, before[key]) for key, tensor in policy.state_dict().items())
    assert all(parameter.requires_grad for parameter in policy.parameters())
    assert not policy.training
    assert torch.equal(policy.distribution(observations).action.detach(), action)
    assert torch.equal(first, run_explainer(vandal, policy, observations, 9))


def test_global_state_of_other_libraries_is_seeded_and_restored() -> None:
    drawn: list[float] = []

    def explain(policy: Policy, observations: Tensor, generator: torch.Generator) -> Tensor:
        GraphMaskExplainer(num_layers=1, node_feat_size=77.0, EPS=0.5)  # PyG keeps these on the class
        drawn.append(random.random() + np.random.random() + float(torch.rand(1)))  # noqa: NPY002
        return torch.ones(2, 3, 3)

    random.seed(1)
    np.random.seed(1)  # noqa: NPY002
    states = random.getstate(), str(np.random.get_state()), torch.get_rng_state()  # noqa: NPY002
    settings = dict(GraphMaskExplainer.coeffs)
    for _ in range(2):
        run_explainer(Explainer("globals", explain), small_policy(6), random_observations(2, 3, 6), 5)
    assert drawn[0] == drawn[1]
    assert random.getstate() == states[0]
    assert str(np.random.get_state()) == states[1]  # noqa: NPY002
    assert torch.equal(torch.get_rng_state(), states[2])
    assert settings == GraphMaskExplainer.coeffs


@pytest.mark.parametrize("grad", [torch.enable_grad, torch.no_grad, torch.inference_mode])
def test_explainers_can_differentiate_inside_no_grad_and_inference_mode(grad: type[torch.no_grad]) -> None:
    def explain(policy: Policy, observations: Tensor, generator: torch.Generator) -> Tensor:
        mask = torch.full((2, 3, 3), 0.5, requires_grad=True)
        policy.distribution(observations, mask).action.sum().backward()
        assert mask.grad is not None
        return torch.sigmoid(mask.grad)

    with grad():
        mask = run_explainer(Explainer("gradient", explain), small_policy(6), random_observations(2, 3, 6), 0)
    assert float(mask.std()) > 0


def test_controls_have_their_values() -> None:
    observations = random_observations(200, 4, 6)
    ones = run_explainer(CONTROLS["all-ones"], small_policy(6), observations, 0)
    random = run_explainer(CONTROLS["random"], small_policy(6), observations, 0)
    assert ones.shape == random.shape == (200, 4, 4)
    assert bool((ones == 1).all())
    assert abs(float(random.mean()) - 0.5) < 0.02
    assert float(random.min()) < 0.01 < 0.99 < float(random.max())
    assert not torch.equal(random, run_explainer(CONTROLS["random"], small_policy(6), observations, 1))
    assert all(control.control for control in CONTROLS.values())
