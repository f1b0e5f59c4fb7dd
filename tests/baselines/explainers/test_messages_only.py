"""Explainers asked only about messages, against the game over the other agents written out directly."""

from __future__ import annotations

from itertools import permutations

import pytest
import torch
from torch import Tensor
from xmarl_baselines.explainers.gradient import gradient_at, gradient_messages
from xmarl_baselines.explainers.integrated_gradients import integrated_gradients_messages
from xmarl_baselines.explainers.occlusion import changes_without, occlusion_messages
from xmarl_baselines.explainers.shapley import shapley_messages

from tests.helpers.policies import random_masks, random_observations, small_policy
from xmarl_bench.errors import InputError
from xmarl_bench.explain.adapters import as_explainer
from xmarl_bench.explain.effect import NORMALISER, signed_to_unit
from xmarl_bench.explain.explainer import Explainer, fit_explainer, run_explainer
from xmarl_bench.explain.messages_only import OwnKept, messages_only
from xmarl_bench.plugins.registry import find_explainer

N = 4
FORMS = (
    "gnn_explainer", "gnn_explainer-tuned", "gradient", "graphmask", "integrated_gradients", "occlusion",
    "shapley",
)  # fmt: skip


def without_own(mask: Tensor) -> Tensor:
    return mask[:, ~torch.eye(N, dtype=torch.bool)].reshape(len(mask), N, N - 1)


def change(observations: Tensor, mask: Tensor) -> Tensor:
    """(S, N): d_i of a mask with own edges unchanged."""
    policy = small_policy(6, 1)
    with torch.no_grad():
        full, other = policy.distribution(observations).action, policy.distribution(observations, mask).action
    return (full - other).abs().mean(dim=-1)


def test_own_edges_are_kept_for_every_mask() -> None:
    policy, observations, masks = small_policy(6, 1), random_observations(5, N, 6), random_masks(5, N)
    kept, eye = OwnKept(policy), torch.eye(N)
    with torch.no_grad():
        for mask in (masks, torch.zeros(5, N, N), torch.ones(5, N, N)):
            expected = policy.distribution(observations, torch.where(eye > 0, 1.0, mask)).action
            assert torch.equal(kept.distribution(observations, mask).action, expected)
        assert torch.equal(kept.distribution(observations).action, policy.distribution(observations).action)
        assert torch.equal(kept.attention(observations), policy.attention(observations))


@pytest.mark.slow
def test_shapley_of_messages_is_the_mean_over_orders_of_the_others() -> None:
    observations = random_observations(3, N, 6)
    mask = run_explainer(shapley_messages, small_policy(6, 1), observations, 0)
    values = torch.zeros(3, N, N)
    for i in range(N):
        others = [j for j in range(N) if j != i]
        for order in permutations(others):
            kept = torch.eye(N).repeat(3, 1, 1)
            before = change(observations, kept)[:, i]
            for j in order:
                kept[:, i, j] = 1.0
                after = change(observations, kept)[:, i]
                values[:, i, j] += (before - after) / 6
                before = after
    torch.testing.assert_close(without_own(mask), without_own(signed_to_unit(values)), atol=1e-5, rtol=0)
    assert mask.diagonal(dim1=1, dim2=2).eq(1).all()


@pytest.mark.slow
def test_gradients_of_messages_are_complete_for_an_agent_that_hears_itself() -> None:
    policy, observations = small_policy(6, 1), random_observations(6, N, 6)
    points = [(k + 0.5) / 200 for k in range(200)]
    attribution = gradient_at(OwnKept(policy), observations, points)
    assert attribution.diagonal(dim1=1, dim2=2).eq(0).all()
    alone = change(observations, torch.eye(N).repeat(6, 1, 1))  # the change caused by removing all messages
    torch.testing.assert_close(attribution.sum(dim=-1), alone, atol=1e-4, rtol=0)
    assert not torch.allclose(alone, change(observations, torch.zeros(6, N, N)), atol=1e-2)
    for explainer in (gradient_messages, integrated_gradients_messages):
        mask = run_explainer(explainer, policy, observations, 0)
        assert mask.diagonal(dim1=1, dim2=2).eq(1).all()


def test_occlusion_ranks_messages_as_before() -> None:
    policy, observations = small_policy(6, 1), random_observations(6, N, 6)
    mask = run_explainer(occlusion_messages, policy, observations, 0)
    with torch.no_grad():
        changes = changes_without(policy, observations)
    assert torch.equal(without_own(mask).argsort(dim=-1), without_own(changes).argsort(dim=-1))


@pytest.mark.parametrize("name", FORMS)
def test_both_forms_of_an_explainer_are_registered(name: str) -> None:
    plain, messages = find_explainer(name), find_explainer(f"{name}-messages")
    assert messages.hyperparameters == {**plain.hyperparameters, "own_edge": "kept"}
    assert (messages.stochastic, messages.slow, messages.batched) == (
        plain.stochastic, plain.slow, plain.batched,
    )  # fmt: skip


def test_fitting_uses_agents_that_hear_themselves() -> None:
    seen: list[type] = []

    def fit(policy: object, observations: Tensor, generator: torch.Generator) -> object:
        seen.append(type(policy))
        return zeros

    def zeros(policy: object, observations: Tensor, generator: torch.Generator) -> Tensor:
        seen.append(type(policy))
        return torch.zeros(*observations.shape[:2], observations.shape[1])

    def explain(policy: object, observations: Tensor, generator: torch.Generator) -> Tensor:
        raise AssertionError("it is fitted first")

    made = messages_only(Explainer("mine", explain, fit=fit))  # type: ignore[arg-type]
    assert made.name == "mine-messages"
    assert made.fit is not None
    observations = random_observations(2, 3, 6)
    fitted = fit_explainer(made, small_policy(6), observations, 0)
    mask = run_explainer(fitted, small_policy(6), observations, 0)
    assert seen == [OwnKept, OwnKept]
    assert torch.equal(mask, torch.eye(3).expand(2, 3, 3))


@pytest.mark.parametrize("size", [1e-9, 10.0])
def test_own_edges_take_no_part_in_the_scale_of_signed_attributions(size: float) -> None:
    def signed(observations: Tensor, policy: object) -> Tensor:
        return size * torch.tensor([[9.0, -1.0, 0.5]]).expand(len(observations), 3, 3)

    made = messages_only(as_explainer(signed, signed=True))
    assert made.hyperparameters["normaliser"] == NORMALISER
    mask = run_explainer(made, small_policy(6), random_observations(2, 3, 6), 0)
    expected = torch.tensor([[1.0, 0.0, 0.75], [1.0, 1.0, 0.5 + 0.5 / 18], [1.0, 0.5 - 0.5 / 9, 1.0]])
    torch.testing.assert_close(mask[0], expected)


def test_functions_work_and_explainers_that_get_the_network_are_refused() -> None:
    def closest(observations: Tensor, policy: object) -> Tensor:
        return torch.exp(-torch.cdist(observations[..., :2], observations[..., :2]))

    made = messages_only(closest)
    assert made.name == "closest-messages"
    mask = run_explainer(made, small_policy(6), random_observations(2, 3, 6), 0)
    assert mask.diagonal(dim1=1, dim2=2).eq(1).all()
    with pytest.raises(InputError, match="one timestep at a time"):
        messages_only(Explainer("single", closest, batched=False))  # type: ignore[arg-type]
