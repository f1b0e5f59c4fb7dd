"""The shipped explainers: equal to PyG where they say so, and without traces."""

from __future__ import annotations

import copy

import pytest
import torch
from torch_geometric.explain import AttentionExplainer, GraphMaskExplainer
from xmarl_baselines.explainers.attention import attention
from xmarl_baselines.explainers.attention_rowmax import attention_rowmax
from xmarl_baselines.explainers.gnn_explainer import gnn_explainer
from xmarl_baselines.explainers.graphmask_pyg import graphmask_pyg

from tests.baselines.reference import by_pyg
from tests.policies import random_observations, small_policy
from xmarl_bench.explainer import Explainer, run_explainer
from xmarl_bench.policy import complete_graph
from xmarl_bench.pyg import PygExplain

SHIPPED = [attention, attention_rowmax, gnn_explainer, graphmask_pyg]
each = pytest.mark.parametrize("explainer", SHIPPED, ids=lambda explainer: explainer.name)


def test_attention_is_what_pyg_calls_attention() -> None:
    policy, observations = small_policy(6, 1), random_observations(6, 4, 6)
    mask = run_explainer(attention, policy, observations, 0)
    theirs = torch.stack([by_pyg(policy, AttentionExplainer(), x) for x in observations])
    torch.testing.assert_close(mask, theirs, rtol=0, atol=1e-6)
    torch.testing.assert_close(mask.sum(-1), torch.ones(6, 4))
    assert not torch.allclose(mask, mask.transpose(1, 2))  # so the test would see rows and columns mixed up


def test_the_adapter_keeps_rows_and_columns_apart() -> None:
    policy, observations = small_policy(6, 1), random_observations(3, 4, 6)
    mask = PygExplain(AttentionExplainer)(policy, observations, torch.Generator())
    torch.testing.assert_close(mask, policy.prepare(observations).attention.detach(), rtol=0, atol=1e-6)


def test_attention_rowmax_ranks_as_attention_and_keeps_the_best_message_whole() -> None:
    policy, observations = small_policy(6, 1), random_observations(6, 4, 6)
    alpha = run_explainer(attention, policy, observations, 0)
    mask = run_explainer(attention_rowmax, policy, observations, 0)
    assert torch.equal(mask.argsort(dim=-1), alpha.argsort(dim=-1))
    assert torch.equal(mask.amax(dim=-1), torch.ones(6, 4))
    torch.testing.assert_close(mask * alpha.amax(dim=-1, keepdim=True), alpha)


@each
def test_an_explainer_leaves_no_trace(explainer: Explainer) -> None:
    policy, observations = small_policy(6, 2), random_observations(2, 3, 6)
    state = {key: tensor.clone() for key, tensor in policy.state_dict().items()}
    names = {name for name, _ in policy.named_parameters()}
    with torch.no_grad():
        plain = policy(observations[0], complete_graph(3))
    before = torch.random.get_rng_state()
    coefficients = copy.deepcopy(GraphMaskExplainer.coeffs)
    # Straight, without the harness's own copies around it.
    explainer.explain(policy, observations, torch.Generator().manual_seed(1))
    assert torch.equal(torch.random.get_rng_state(), before)
    assert all(torch.equal(tensor, state[key]) for key, tensor in policy.state_dict().items())
    assert {name for name, _ in policy.named_parameters()} == names
    assert all(parameter.requires_grad and parameter.grad is None for parameter in policy.parameters())
    assert not policy.gat.explain
    with torch.no_grad():
        assert torch.equal(policy(observations[0], complete_graph(3)), plain)
    assert coefficients == GraphMaskExplainer.coeffs


@each
def test_an_explainer_repeats_and_only_the_stochastic_depend_on_the_seed(explainer: Explainer) -> None:
    policy, observations = small_policy(6, 3), random_observations(2, 3, 6)
    first = run_explainer(explainer, policy, observations, 1)
    torch.manual_seed(99)  # the global state must not matter
    assert torch.equal(first, run_explainer(explainer, policy, observations, 1))
    if not explainer.stochastic:
        assert torch.equal(first, run_explainer(explainer, policy, observations, 2))


def test_seeds_matter_to_gnn_explainer_and_graphs_do_not_leak_into_one_another() -> None:
    policy, observations = small_policy(6, 3), random_observations(3, 3, 6)
    one = run_explainer(gnn_explainer, policy, observations, 1)
    assert not torch.allclose(one, run_explainer(gnn_explainer, policy, observations, 2))
    changed = observations.clone()
    changed[0] += 1.0
    two = run_explainer(gnn_explainer, policy, changed, 1)
    assert not torch.equal(one[0], two[0])
    assert torch.equal(one[1:], two[1:])


@pytest.mark.parametrize("encoder", [(), (8,)], ids=["6 -> 8", "8 -> 8"])
def test_graphmask_gives_binary_masks(encoder: tuple[int, ...]) -> None:
    mask = run_explainer(graphmask_pyg, small_policy(6, 4, encoder), random_observations(1, 3, 6), 0)
    assert set(mask.unique().tolist()) <= {0.0, 1.0}
