"""A policy takes a mask as torch_geometric's models take edge weights."""

from __future__ import annotations

import inspect
from typing import Any

import pytest
import torch
from torch import Tensor

from tests.helpers.deep_policies import two_layers, with_a_lonely_timestep
from tests.helpers.policies import random_masks, random_observations, small_policy
from tests.helpers.recurrent_policies import TWO_LAYERS, recurrent_policy, remembering
from xmarl_bench.errors import InputError
from xmarl_bench.explain.messages_only import OwnKept
from xmarl_bench.policy import Policy, complete_graph
from xmarl_bench.policy.black_box import BlackBox
from xmarl_bench.policy.module import block_diagonal

N = 4


def policies() -> dict[str, Policy]:
    return {
        "one layer": small_policy(6, residual=True),
        "discrete actions": small_policy(6, categorical=True),
        "two layers": two_layers(6),
        "memory in closed form": recurrent_policy(remembering("lstm", 1)),
        "memory and two layers": recurrent_policy(remembering("gru", 1, TWO_LAYERS)),
        "black box": BlackBox(small_policy(6)),
        "own edges kept": OwnKept(small_policy(6)),
    }


@pytest.mark.parametrize("name", policies())
def test_weights_of_edges_are_the_mask(name: str) -> None:
    """In any order of the edges, for one team and for teams side by side."""
    policy = policies()[name]
    observations, masks = random_observations(3, N, 6 + policy.memory_dim), random_masks(3, N)
    teams = torch.arange(3).repeat_interleave(N)
    with torch.no_grad():
        expected = policy.distribution(observations, masks).action
        assert not torch.allclose(expected, policy.distribution(observations).action, atol=1e-2)
        order = torch.randperm(3 * N * N, generator=torch.Generator().manual_seed(1))
        edges, weights = block_diagonal(3, N)[:, order], masks.flatten()[order]
        together = policy(observations.flatten(0, 1), edges, weights, teams).view(3, N, -1)
        torch.testing.assert_close(together, expected, rtol=0, atol=1e-6)
        alone = policy(observations[0], complete_graph(N), edge_attr=masks[0].reshape(-1, 1))
        torch.testing.assert_close(alone, expected[0], rtol=0, atol=1e-6)
        plain = policy(observations[0], complete_graph(N), batch=torch.zeros(N, dtype=torch.long))
        assert torch.equal(plain, policy(observations[0], complete_graph(N)))


@pytest.mark.parametrize("name", ["one layer", "two layers", "memory and two layers"])
def test_the_gradient_of_the_weights_is_that_of_the_mask(name: str) -> None:
    policy = policies()[name]
    observations, masks = random_observations(1, N, 6 + policy.memory_dim), random_masks(1, N)
    order = torch.randperm(N * N, generator=torch.Generator().manual_seed(1))
    weights = masks.flatten()[order].requires_grad_()
    (theirs,) = torch.autograd.grad(
        policy(observations[0], complete_graph(N)[:, order], weights)[..., 0].sum(), weights
    )
    masks.requires_grad_()
    (ours,) = torch.autograd.grad(policy.distribution(observations, masks).action[..., 0].sum(), masks)
    assert float(ours.abs().max()) > 1e-2
    torch.testing.assert_close(theirs, ours.flatten()[order], rtol=0, atol=1e-6)


def test_edges_of_a_graph_that_is_not_complete() -> None:
    policy, observations, adjacency = with_a_lonely_timestep()
    masks = random_masks(4, 3)
    with torch.no_grad():
        expected = policy.distribution(observations, masks).action
        for s in range(4):
            each = policy(observations[s], policy.edges(observations[s]), masks[s][adjacency[s]])
            torch.testing.assert_close(each, expected[s], rtol=0, atol=1e-6)


def test_a_weight_of_zero_is_an_edge_left_out_of_the_sum_only() -> None:
    """Nothing is renormalised, unlike without the edge."""
    policy, x = small_policy(6), random_observations(1, N, 6)[0]
    edges, kept = complete_graph(N), torch.ones(N * N)
    kept[1] = 0.0
    assert not torch.allclose(policy(x, edges, kept), policy(x, edges[:, kept > 0]), atol=1e-3)


def test_libraries_find_the_names_of_the_arguments() -> None:
    assert list(inspect.signature(small_policy(6).forward).parameters)[:4] == [
        "x", "edge_index", "edge_weight", "batch",
    ]  # fmt: skip


X, EDGES, ONES = torch.zeros(2, 6), complete_graph(2), torch.ones(4)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"edge_weight": ONES, "edge_attr": ONES}, "both edge_weight and edge_attr"),
        ({"edge_weight": torch.zeros(2, dtype=torch.long)}, "dtype torch.int64: give floating-point"),
        ({"edge_weight": torch.ones(3)}, r"shape \(3,\) on 4 edges: give one number for each"),
        ({"edge_attr": torch.ones(4, 2)}, r"edge_attr has shape \(4, 2\) on 4 edges"),
        ({"batch": torch.zeros(3, dtype=torch.long)}, r"shape \(3,\) of torch.int64 for 2 agents"),
        ({"batch": torch.zeros(2)}, "of torch.float32 for 2 agents"),
        ({"batch": torch.arange(2)}, "ends of an edge into different teams"),
        ({"edge_index": EDGES[:, [0, 1, 2, 2]], "edge_weight": ONES}, "lists an edge twice"),
    ],
)
def test_what_is_no_mask_is_refused(given: dict[str, Any], said: str) -> None:
    arguments: dict[str, Tensor] = {"x": X, "edge_index": EDGES, **given}
    with pytest.raises(InputError, match=said):
        small_policy(6)(**arguments)
