"""Gradients, occlusion and Shapley values against finite differences, Captum, all orders and their axioms."""

from __future__ import annotations

from itertools import permutations

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch import Tensor
from torch_geometric.explain import CaptumExplainer
from xmarl_baselines.explainers.gradient import gradient_at
from xmarl_baselines.explainers.integrated_gradients import midpoints
from xmarl_baselines.explainers.occlusion import changes_without, occlusion
from xmarl_baselines.explainers.shapley import exact_values, sampled_values, shapley, shapley_mask

from tests.baselines.reference import TRAINED, trained
from tests.helpers.deep_policies import one_layer, two_layers
from tests.helpers.policies import random_observations, small_policy
from xmarl_bench.explain.effect import effect_direction, share_of_largest, signed_to_unit
from xmarl_bench.explain.explainer import run_explainer
from xmarl_bench.explain.oracle import change_table
from xmarl_bench.explain.pyg import PygExplain
from xmarl_bench.policy import Policy

N = 4


def change(policy: Policy, x: Tensor, mask: Tensor) -> Tensor:
    """(S, N): d_i of any mask, a mean over action entries or the total variation distance."""
    with torch.no_grad():
        full, masked = policy.distribution(x).action, policy.distribution(x, mask).action
    if policy.continuous_actions:
        return (full - masked).abs().mean(dim=-1)
    return (full - masked).clamp_min(0.0).sum(dim=-1)


def silence(policy: Policy, x: Tensor) -> Tensor:
    """(S, N): the change caused by removing all messages."""
    return change(policy, x, torch.zeros(len(x), x.shape[1], x.shape[1], dtype=x.dtype))


both_actions = pytest.mark.parametrize("categorical", [False, True])


@pytest.mark.parametrize("residual", [False, True])
@both_actions
def test_gradient_equals_finite_differences(residual: bool, categorical: bool) -> None:
    policy = small_policy(6, 1, residual=residual, categorical=categorical).double()
    x = random_observations(3, N, 6).double()
    ours = gradient_at(policy, x, [1.0])
    direction = effect_direction(policy, policy.prepare(x))
    for i, j in ((0, 0), (1, 3), (2, 1)):
        low, high = torch.ones(2, 3, N, N, dtype=torch.double)
        low[:, i, j], high[:, i, j] = 1 - 1e-6, 1 + 1e-6
        with torch.no_grad():
            moved = policy.distribution(x, high).action - policy.distribution(x, low).action
        expected = (moved * direction).sum(dim=(-2, -1)) / 2e-6
        torch.testing.assert_close(ours[:, i, j], expected, rtol=1e-5, atol=1e-8)


@pytest.mark.slow
@pytest.mark.parametrize("name", TRAINED)
def test_integrated_gradients_are_complete(name: str) -> None:
    policy, x = trained(name, 3)
    total = gradient_at(policy, x, midpoints(1000)).sum(dim=-1)
    torch.testing.assert_close(total, silence(policy, x), rtol=0, atol=0.01)


@pytest.mark.slow
def test_integrated_gradients_of_probabilities_are_complete() -> None:
    policy, x = small_policy(6, 3, categorical=True), random_observations(5, N, 6)
    total = gradient_at(policy, x, midpoints(1000)).sum(dim=-1)
    torch.testing.assert_close(total, silence(policy, x), rtol=0, atol=1e-3)
    assert float(total.max()) > 0.1


@pytest.mark.slow
@pytest.mark.parametrize(
    ("method", "arguments", "levels"),
    [
        ("Saliency", {"abs": False}, [1.0]),
        ("InputXGradient", {}, [1.0]),
        ("IntegratedGradients", {"n_steps": 8, "method": "riemann_middle"}, midpoints(8)),
    ],
)
@pytest.mark.parametrize("residual", [False, True])
@both_actions
def test_captum_gives_the_same_attributions(
    method: str, arguments: dict[str, object], levels: list[float], residual: bool, categorical: bool
) -> None:
    policy = small_policy(6, 3, residual=residual, categorical=categorical)
    x = random_observations(3, 3, 6)
    captum = PygExplain(lambda: CaptumExplainer(method, **arguments), effect=True, to_unit=signed_to_unit)
    theirs = captum(policy, x, torch.Generator())
    torch.testing.assert_close(signed_to_unit(gradient_at(policy, x, levels)), theirs, rtol=0, atol=1e-4)
    assert float(theirs.std()) > 0.05


@pytest.mark.parametrize(
    "policy",
    [
        small_policy(6, 2),
        small_policy(6, 2, residual=True),
        small_policy(6, 2, categorical=True),
        one_layer(6),
        two_layers(6),
    ],
    ids=["fast", "residual", "categorical", "1", "2"],
)
def test_occlusion_is_the_change_without_one_edge(policy: Policy) -> None:
    x = random_observations(3, N, 6)
    with torch.no_grad():
        ours = changes_without(policy, x)
    for i in range(N):
        for j in range(N):
            mask = torch.ones(3, N, N)
            mask[:, i, j] = 0.0
            torch.testing.assert_close(ours[:, i, j], change(policy, x, mask).sum(dim=-1), rtol=0, atol=1e-5)
    assert run_explainer(occlusion, policy, x, 0).amax(dim=-1).eq(1).all()


def test_shapley_values_are_the_mean_over_all_orders() -> None:
    policy, x = trained(TRAINED[2], 5)
    expected = torch.zeros(5, 3, 3)
    for order in permutations(range(3)):
        mask, before = torch.zeros(5, 3, 3), silence(policy, x)
        for j in order:
            mask[:, :, j] = 1.0
            after = change(policy, x, mask)
            expected[:, :, j] += (before - after) / 6
            before = after
    ours = torch.from_numpy(exact_values(change_table(policy, x))).float()
    torch.testing.assert_close(ours, expected, rtol=0, atol=1e-5)
    torch.testing.assert_close(
        run_explainer(shapley, policy, x, 0), signed_to_unit(expected), atol=1e-3, rtol=0
    )


@pytest.mark.slow
@given(
    n_agents=st.integers(1, 6), seed=st.integers(0, 1000), residual=st.booleans(), categorical=st.booleans()
)
def test_shapley_axioms(n_agents: int, seed: int, residual: bool, categorical: bool) -> None:
    policy = small_policy(6, seed, residual=residual, categorical=categorical)
    x = random_observations(3, n_agents, 6, seed)
    if n_agents > 2:
        x[:, 2] = x[:, 1]  # two identical senders
    values = torch.from_numpy(exact_values(change_table(policy, x)))
    torch.testing.assert_close(
        values.sum(dim=-1).float(), silence(policy, x), rtol=0, atol=1e-5
    )  # efficiency
    if n_agents > 2:
        torch.testing.assert_close(values[:, :, 1], values[:, :, 2], rtol=0, atol=1e-5)  # symmetry


def test_a_silent_sender_gets_nothing() -> None:
    policy, x = small_policy(6, 1, encoder=()), random_observations(3, N, 6)
    with torch.no_grad():
        policy.gat.lin_l.bias.zero_()
    x[:, 2] = 0.0
    values = exact_values(change_table(policy, x))
    assert abs(values[:, :, 2]).max() < 1e-9
    assert abs(values).max() > 1e-2
    with torch.no_grad():
        assert bool((changes_without(policy, x)[:, :, 2] == 0).all())
    assert bool((gradient_at(policy, x, [1.0])[:, :, 2] == 0).all())


def test_fid_delta_is_a_game_with_twice_these_values() -> None:
    policy, x = small_policy(6, 4), random_observations(3, N, 6)
    table = change_table(policy, x)
    values = exact_values(table)
    fid_delta = table[::-1] - table
    assert abs(exact_values(-fid_delta) - 2 * values).max() < 1e-12


@pytest.mark.slow
def test_sampled_values_are_efficient_and_approach_the_exact_ones() -> None:
    policy, x = trained(TRAINED[2], 10, n_agents=5)
    exact = torch.from_numpy(exact_values(change_table(policy, x))).float()
    with torch.no_grad():
        few, many = (sampled_values(policy, x, list(range(10)), pairs) for pairs in (4, 256))
    for sampled in (few, many):
        torch.testing.assert_close(sampled.sum(dim=-1), silence(policy, x), rtol=0, atol=1e-5)
    assert (many - exact).abs().mean() < 0.25 * (few - exact).abs().mean()
    torch.testing.assert_close(many, exact, rtol=0, atol=0.03)


@pytest.mark.slow
def test_shapley_of_several_layers_is_one_game_of_all_edges() -> None:
    policy, x = two_layers(6), random_observations(2, 3, 6)
    with torch.no_grad():
        values = sampled_values(policy, x, [1, 2], 8)
    torch.testing.assert_close(values.sum(dim=(-2, -1)), silence(policy, x).sum(dim=-1), rtol=0, atol=1e-5)
    mask = shapley_mask(policy, x, torch.Generator().manual_seed(0))
    assert not torch.equal(mask, shapley_mask(policy, x, torch.Generator().manual_seed(1)))
    for single in (one_layer(6), small_policy(6, 1, categorical=True)):
        exact = torch.from_numpy(exact_values(change_table(single, x))).float()
        with torch.no_grad():
            torch.testing.assert_close(sampled_values(single, x, [1, 2], 64), exact, rtol=0, atol=0.03)


def test_above_ten_agents_shapley_is_sampled() -> None:
    policy, x = small_policy(6, 1), random_observations(1, 11, 6)
    one, two = (run_explainer(shapley, policy, x, seed) for seed in (1, 2))
    assert not torch.equal(one, two)
    assert float(torch.corrcoef(torch.stack([one.flatten(), two.flatten()]))[0, 1]) > 0.8


def test_normalisers_keep_order_and_zero_rows() -> None:
    a = torch.tensor([[[2.0, -4.0], [0.0, 0.0]]])
    assert torch.equal(signed_to_unit(a), torch.tensor([[[0.75, 0.0], [0.5, 0.5]]]))
    assert torch.equal(share_of_largest(a.abs()), torch.tensor([[[0.5, 1.0], [0.0, 0.0]]]))
