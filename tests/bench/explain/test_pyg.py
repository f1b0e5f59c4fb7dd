"""The adapter for unmodified algorithms of torch_geometric.explain, and for Captum's through it."""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import replace

import pytest
import torch
from torch_geometric.explain import (
    AttentionExplainer,
    CaptumExplainer,
    DummyExplainer,
    ExplainerAlgorithm,
    GNNExplainer,
    GraphMaskExplainer,
    PGExplainer,
)

from tests.helpers.deep_policies import two_layers, with_a_lonely_timestep
from tests.helpers.policies import random_observations, small_policy
from xmarl_bench.explain.effect import signed_to_unit
from xmarl_bench.explain.explainer import Explainer, run_explainer
from xmarl_bench.explain.pyg import PygExplain, class_settings_kept
from xmarl_bench.policy import FixedGraph, Policy

CAPTUM = CaptumExplainer.SUPPORTED_METHODS


def gnn_explainer() -> ExplainerAlgorithm:
    return GNNExplainer(epochs=5, lr=0.1)


EVERY: dict[str, PygExplain] = {
    "attention": PygExplain(AttentionExplainer),
    "dummy": PygExplain(DummyExplainer),
    "gnn": PygExplain(gnn_explainer),
    "gnn per agent": PygExplain(gnn_explainer, per_agent=True),
    "graphmask": PygExplain(lambda: GraphMaskExplainer(1, epochs=3, log=False)),
    "pg": PygExplain(lambda: PGExplainer(epochs=2)),
} | {
    method: PygExplain(
        lambda method=method: CaptumExplainer(method),  # type: ignore[misc]
        effect=True,
        to_unit=signed_to_unit,
    )
    for method in CAPTUM
}


@pytest.mark.slow
@pytest.mark.parametrize("name", EVERY)
def test_every_algorithm_of_pyg_runs_unmodified_and_repeats(name: str) -> None:
    policy, observations = small_policy(6, 2), random_observations(2, 3, 6)
    explainer = Explainer(name, EVERY[name])
    mask = run_explainer(explainer, policy, observations, 1)
    assert float(mask.std()) > 0 or name == "graphmask"
    assert torch.equal(mask, run_explainer(explainer, policy, observations, 1))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["attention", "gnn", "pg", "IntegratedGradients"])
def test_algorithms_explain_policies_of_several_layers(name: str) -> None:
    mask = run_explainer(Explainer(name, EVERY[name]), two_layers(6), random_observations(2, 3, 6), 1)
    assert float(mask.std()) > 0


def test_rows_are_receivers_and_columns_senders() -> None:
    policy, observations = small_policy(6, 1), random_observations(3, 4, 6)
    alpha = policy.attention(observations).detach()
    for adapter in (PygExplain(AttentionExplainer), PygExplain(AttentionExplainer, per_agent=True)):
        mask = adapter(policy, observations, torch.Generator())
        torch.testing.assert_close(mask, alpha, rtol=0, atol=1e-6)
    assert not torch.allclose(alpha, alpha.mT, atol=1e-2)


def test_a_row_explained_for_one_agent_depends_only_on_that_agent() -> None:
    policy, observations = small_policy(6, 1), random_observations(1, 3, 6)
    mask = EVERY["gnn per agent"](policy, observations, torch.Generator().manual_seed(0))
    assert mask.shape == (1, 3, 3)
    assert bool((mask > 0).all())


@pytest.mark.slow
@pytest.mark.parametrize("residual", [False, True])
@pytest.mark.parametrize("method", CAPTUM)
def test_captum_explains_the_sum_of_effects(method: str, residual: bool) -> None:
    """A message has an effect only on its receiver: rows do not mix in a policy of one layer."""
    policy, observations = small_policy(6, 2, residual=residual), random_observations(1, 4, 6)
    adapter = PygExplain(lambda: CaptumExplainer(method), effect=True)
    whole = adapter(policy, observations, torch.Generator().manual_seed(3))
    with torch.no_grad():
        full, nothing = (
            policy.distribution(observations, mask).action for mask in (None, torch.zeros(1, 4, 4))
        )
    if method in ("IntegratedGradients", "ShapleyValueSampling"):  # complete methods
        total = (full - nothing).abs().mean(dim=-1)
        torch.testing.assert_close(whole.sum(dim=-1), total, rtol=0, atol=2e-3)
    else:
        assert bool(whole.isfinite().all())


def test_settings_that_pyg_keeps_on_its_classes_are_restored() -> None:
    before = copy.deepcopy((GraphMaskExplainer.coeffs, PGExplainer.coeffs))
    with class_settings_kept():
        GraphMaskExplainer(1, node_feat_size=9.0)
        PGExplainer(1, edge_size=9.0)
        PGExplainer.coeffs["temp"][0] = 99.0
        assert GraphMaskExplainer.coeffs["node_feat_size"] == 9.0
    assert (GraphMaskExplainer.coeffs, PGExplainer.coeffs) == before


def test_a_graph_s_mask_does_not_depend_on_other_graphs() -> None:
    policy, observations = small_policy(6, 3), random_observations(3, 3, 6)
    explain: Callable[[Policy, torch.Tensor, torch.Generator], torch.Tensor] = EVERY["gnn"]
    one = explain(policy, observations, torch.Generator().manual_seed(1))
    changed = observations.clone()
    changed[0] += 1.0
    two = explain(policy, changed, torch.Generator().manual_seed(1))
    assert not torch.equal(one[0], two[0])
    assert torch.equal(one[1:], two[1:])


@pytest.mark.parametrize("name", ["attention", "gnn", "pg", "Saliency"])
def test_the_graph_is_the_policys_own(name: str) -> None:
    """A chain 0 <-> 1 <-> 2, without edges between its ends."""
    policy = two_layers(6)
    policy.graph = FixedGraph(n_agents=3, edges=((0, 1), (1, 0), (1, 2), (2, 1)))
    observations = random_observations(2, 3, 6)
    edges = policy.adjacency(observations)
    assert edges is not None
    mask = run_explainer(Explainer(name, replace(EVERY[name], to_unit=None)), policy, observations, 1)
    assert bool((mask[~edges] == 0).all())
    assert bool((mask[edges] != 0).any())
    if name == "attention":  # rows of the largest coefficient over heads and layers
        assert bool((mask.sum(dim=-1) >= 1 - 1e-5).all())


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["attention", "dummy", "gnn", "gnn per agent", "graphmask", "pg", "Saliency"]
)
def test_timesteps_without_an_edge_get_a_mask_of_zeros(name: str) -> None:
    policy, observations, edges = with_a_lonely_timestep()
    assert edges.any(dim=(1, 2)).tolist() == [True, False, True, True]
    mask = run_explainer(Explainer(name, EVERY[name]), policy, observations, 1)
    assert not mask[~edges].any()
