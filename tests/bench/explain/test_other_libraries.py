"""Explainers of other libraries run unmodified, by the recipes of docs/explainers.md."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch_geometric.nn import GATConv
from xmarl_baselines.explainers.occlusion import occlusion
from xmarl_baselines.explainers.shapley import shapley

from tests.helpers.deep_policies import stack
from tests.helpers.libraries import defined_in_block, library
from tests.helpers.policies import random_observations, small_policy
from tests.helpers.recurrent_policies import recurrent_policy, remembering
from xmarl_bench import as_explainer
from xmarl_bench.explain.explainer import Explainer, run_explainer
from xmarl_bench.policy import Policy

N = 3
CONTINUOUS, DISCRETE = small_policy(6, residual=True), small_policy(6, categorical=True)
POLICIES = pytest.mark.parametrize("policy", [CONTINUOUS, DISCRETE], ids=["continuous", "discrete"])
OBSERVATIONS = random_observations(2, N, 6)

Value = Callable[[Tensor], Tensor]  # rows (B, N) of a mask -> (B,)
Array = NDArray[np.float64]
PAGE: dict[str, Any] = {"torch": torch, "as_explainer": as_explainer}


@pytest.fixture(scope="module")
def kept() -> Callable[[Policy, Tensor, int], Value]:
    library("captum")
    recipe: Callable[[Policy, Tensor, int], Value] = defined_in_block("def kept(", PAGE)["kept"]
    return recipe


def by_rows(attribute: Callable[[Value], Any]) -> Explainer:
    """An explainer of what attributes the value of a row of ones to its N entries."""

    def explain(observations: Tensor, policy: Policy) -> Tensor:
        values = [PAGE["kept"](policy, observations, i) for i in range(len(observations))]
        return torch.stack([torch.as_tensor(attribute(value)).detach().float().view(-1) for value in values])

    return as_explainer(explain, batched=False, signed=True, stochastic=True)


def in_numpy(value: Value) -> Callable[[Array], Array]:
    return lambda rows: value(torch.from_numpy(np.asarray(rows)).float()).numpy(force=True)


def run_twice(explainer: Explainer, policy: Policy) -> Tensor:
    """The mask: valid, not constant, and the same again."""
    mask = run_explainer(explainer, policy, OBSERVATIONS, 1)
    assert mask.shape == (2, N, N)
    assert bool(((mask >= 0) & (mask <= 1)).all())
    assert float(mask.std()) > 0
    assert torch.equal(mask, run_explainer(explainer, policy, OBSERVATIONS, 1))
    return mask


ROW, NOTHING = torch.ones(1, N), np.zeros((1, N))
ROWS = np.ones((1, N))
OPTIONS: dict[str, dict[str, Any]] = {
    "GradientShap": {"baselines": torch.zeros(1, N)},
    "KernelShap": {"n_samples": 150},
    "Occlusion": {"sliding_window_shapes": (1,)},
    "ShapleyValueSampling": {"n_samples": 100},
}
OF_CAPTUM = {
    name: lambda value, name=name: getattr(library("captum.attr"), name)(value).attribute(
        ROW, **OPTIONS.get(name, {})
    )
    for name in (
        "FeatureAblation", "GradientShap", "IntegratedGradients", "KernelShap", "Lime", "Occlusion",
        "ShapleyValueSampling", "ShapleyValues",
    )
}  # fmt: skip
OF_SHAP = {
    "ExactExplainer": lambda value: (
        library("shap").ExactExplainer(in_numpy(value), NOTHING)(ROWS, silent=True).values
    ),
    "KernelExplainer": lambda value: (
        library("shap").KernelExplainer(in_numpy(value), NOTHING).shap_values(ROWS, silent=True)
    ),
    "PermutationExplainer": lambda value: (
        library("shap").PermutationExplainer(in_numpy(value), NOTHING, seed=1)(ROWS, silent=True).values
    ),
    "SamplingExplainer": lambda value: (
        library("shap").SamplingExplainer(in_numpy(value), NOTHING).shap_values(ROWS, silent=True)
    ),
}
OF_LIGHTSHAP = {
    f"explain_any {method}": lambda value, method=method: (
        library("lightshap").explain_any(
            in_numpy(value), ROWS, NOTHING, method=method, verbose=False
        ).shap_values
    )
    for method in ("kernel", "permutation")
}  # fmt: skip
BY_ROWS: dict[str, Callable[[Value], Any]] = {**OF_CAPTUM, **OF_SHAP, **OF_LIGHTSHAP}
EXACT = ("ShapleyValues", "ExactExplainer", "KernelExplainer", *OF_LIGHTSHAP)
SAMPLED = ("ShapleyValueSampling", "KernelShap", "PermutationExplainer", "SamplingExplainer")


@pytest.mark.slow
@pytest.mark.usefixtures("kept")
@POLICIES
@pytest.mark.parametrize("name", BY_ROWS)
def test_explainers_of_a_function_explain_rows_of_the_mask(name: str, policy: Policy) -> None:
    """Shapley values, exact or sampled, are ours; leaving out one message at a time is occlusion."""
    if name in ("KernelShap", "Lime"):  # Captum imports it for these
        library("sklearn")
    mask = run_twice(by_rows(BY_ROWS[name]), policy)
    ours = run_explainer(shapley, policy, OBSERVATIONS, 0)
    if name in EXACT:
        torch.testing.assert_close(mask, ours, rtol=0, atol=1e-4)
    elif name in SAMPLED:
        torch.testing.assert_close(mask, ours, rtol=0, atol=0.15)
    elif name in ("FeatureAblation", "Occlusion"):  # ours is a / max a, theirs 0.5 + a / (2 max |a|)
        expected = 0.5 + run_explainer(occlusion, policy, OBSERVATIONS, 0) / 2
        torch.testing.assert_close(mask, expected, rtol=0, atol=1e-5)


@pytest.mark.slow
@POLICIES
def test_integrated_gradients_is_the_integral(
    policy: Policy, kept: Callable[[Policy, Tensor, int], Value]
) -> None:
    value = kept(policy, OBSERVATIONS[0], 1)
    theirs = library("captum.attr").IntegratedGradients(value).attribute(ROW, n_steps=200)[0].float()
    steps = ((torch.arange(2000) + 0.5) / 2000)[:, None].expand(-1, N).clone().requires_grad_()
    (gradient,) = torch.autograd.grad(value(steps).sum(), steps)
    torch.testing.assert_close(theirs, gradient.mean(dim=0), rtol=0, atol=2e-3)


@pytest.mark.slow
def test_the_recipes_of_the_page_are_shapley_values(kept: Value) -> None:
    library("shap")
    expected = run_explainer(shapley, CONTINUOUS, OBSERVATIONS, 0)
    assert float(expected.std()) > 0.1
    for name in ("captum_shapley", "kernel_shap"):
        recipe = defined_in_block(f"def {name}(", PAGE)[name]
        torch.testing.assert_close(run_twice(recipe, CONTINUOUS), expected, rtol=0, atol=1e-4)


@pytest.mark.slow
@pytest.mark.usefixtures("kept")
@pytest.mark.parametrize("after", [0, 1], ids=["before attention", "after attention"])
def test_the_recipes_explain_policies_with_memory(after: int) -> None:
    policy = recurrent_policy(remembering("lstm", after))
    observations = random_observations(2, N, 6 + policy.memory_dim)
    recipe = defined_in_block("def captum_shapley(", PAGE)["captum_shapley"]
    mask = run_explainer(recipe, policy, observations, 1)
    expected = run_explainer(shapley, policy, observations, 0)
    torch.testing.assert_close(mask, expected, rtol=0, atol=1e-4)
    kept_nodes = run_explainer(of_graph_explain("SubgraphX"), policy, observations, 1)
    assert bool((kept_nodes.diagonal(dim1=1, dim2=2) == 1).all())


QUICK: dict[str, dict[str, int]] = {
    "GNNExplainer": {"epochs": 20}, "PGExplainer": {"epochs": 3}, "NodeMask": {"epochs": 20},
    "IntegratedGradients": {"steps": 20},
}  # fmt: skip
OF_GRAPH_EXPLAIN = (
    "Counterfactual", "GNNExplainer", "GradXInput", "GraphLIME", "GuidedBackprop", "IntegratedGradients",
    "NodeMask", "RandomBaseline", "Saliency", "SubgraphX", "PGExplainer", "AttentionExplainer",
)  # fmt: skip


def of_graph_explain(name: str) -> Explainer:
    """By the recipe of the page, with fewer epochs."""
    library("graph_explain")
    page = defined_in_block("def of_graph_explain(", PAGE)
    algorithm: Any = getattr(page["graph_explain"], name)

    def make() -> Any:
        return algorithm(**QUICK.get(name, {}))

    made: Explainer = page["of_graph_explain"](make)
    return made


@pytest.mark.slow
@POLICIES
@pytest.mark.parametrize("name", OF_GRAPH_EXPLAIN)
def test_explainers_of_models_of_torch_geometric_explain_the_policy(name: str, policy: Policy) -> None:
    if name == "AttentionExplainer":  # asks for GATConv
        policy = stack(GATConv, 6, 1, 1, add_self_loops=False)
    run_twice(of_graph_explain(name), policy)


@pytest.mark.slow
@POLICIES
def test_gradients_of_graph_explain_are_those_of_autograd(policy: Policy) -> None:
    """The sum over entries of j's observation of |d(largest entry of i's output) / dx_j|."""
    mask = run_explainer(of_graph_explain("Saliency"), policy, OBSERVATIONS, 1)
    for s, i in np.ndindex(2, N):
        x = OBSERVATIONS[s].clone().requires_grad_()
        output = policy.distribution(x[None]).action[0, i]
        (gradient,) = torch.autograd.grad(output.max(), x)
        sums = gradient.abs().sum(dim=-1)
        torch.testing.assert_close(mask[s, i], 0.5 + sums / (2 * sums.max()), rtol=0, atol=1e-5)


@pytest.mark.slow
def test_subgraphx_removes_messages_by_edge_weights() -> None:
    """What it calls with weights is F(m): it keeps the agent itself, and zeros and ones."""
    calls: list[Tensor] = []

    class Watched(nn.Module):
        def __init__(self) -> None:
            super().__init__()
            self.edges = CONTINUOUS.edges

        def forward(self, x: Tensor, edge_index: Tensor, edge_weight: Tensor | None = None) -> Tensor:
            action: Tensor = CONTINUOUS(x, edge_index, edge_weight)
            if edge_weight is not None:
                calls.append(edge_weight)
                matrix = edge_weight.view(1, N, N)  # edges are row-major by receiver
                expected = CONTINUOUS.distribution(x[None], matrix).action[0]
                torch.testing.assert_close(action, expected, rtol=0, atol=1e-6)
            return action

    explain: Any = of_graph_explain("SubgraphX").explain
    mask = explain(Watched(), OBSERVATIONS[0], torch.Generator())
    assert len({tuple(each.tolist()) for each in calls}) > N
    assert bool((mask.diagonal() == 1).all())
    assert set(mask.unique().tolist()) == {0.0, 1.0}


@pytest.mark.slow
def test_the_recipe_puts_edges_in_the_row_of_the_receiver() -> None:
    library("graph_explain")
    page = defined_in_block("def of_graph_explain(", PAGE)

    class Numbered(page["graph_explain"].methods.base.ExplanationAlgorithm):  # type: ignore[misc]
        """Edge j -> i of the explanation of agent k gets 100 k + 10 j + i."""

        def explain(self, *, data: Any, index: int, **given: Any) -> Any:
            sender, receiver = data.edge_index
            return page["graph_explain"].Explanation(edge_importance=100 * index + 10 * sender + receiver)

    explain: Any = page["of_graph_explain"](Numbered).explain
    mask = explain(CONTINUOUS, OBSERVATIONS[0], torch.Generator())
    assert mask.tolist() == [[100 * i + 10 * j + i for j in range(N)] for i in range(N)]
