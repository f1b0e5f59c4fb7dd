"""F(m): the batched path, PyG's message passing and the formula written out are one function."""

from __future__ import annotations

import copy

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch_geometric.explain.algorithm.utils import clear_masks, set_masks

from tests.bench.dense_reference import reference_distribution
from tests.policies import random_masks, random_observations, small_policy
from xmarl_bench.policy import complete_graph


@settings(max_examples=25, deadline=None)
@given(
    n_agents=st.integers(1, 6),
    seed=st.integers(0, 1000),
    encoder=st.sampled_from([(), (7,), (5, 6)]),
    binary=st.booleans(),
)
def test_masked_forward_equals_the_formula(
    n_agents: int, seed: int, encoder: tuple[int, ...], binary: bool
) -> None:
    policy = small_policy(5, seed, encoder)
    observations = random_observations(3, n_agents, 5, seed)
    masks = random_masks(3, n_agents, seed)
    masks = (masks > 0.5).float() if binary else masks
    with torch.no_grad():
        single = policy.distribution(observations, masks)
        double = copy.deepcopy(policy).double().distribution(observations.double(), masks.double())
    for s in range(3):
        loc, scale = reference_distribution(
            policy, observations[s].double().numpy(), masks[s].double().numpy()
        )
        np.testing.assert_allclose(single.action[s].numpy(), np.tanh(loc), atol=1e-6)
        np.testing.assert_allclose(single.scale[s].numpy(), scale, rtol=2e-6, atol=1e-6)
        np.testing.assert_allclose(double.loc[s].numpy(), loc, rtol=1e-10, atol=1e-12)


def test_batched_path_equals_pyg_forward() -> None:
    policy = small_policy(6, 1)
    observations = random_observations(8, 4, 6)
    with torch.no_grad():
        batched = policy.distribution(observations).action
        each = torch.stack([policy(x, complete_graph(4)) for x in observations])
    torch.testing.assert_close(batched, each, rtol=0, atol=1e-6)


def test_masked_path_equals_pyg_with_an_edge_mask_loops_included() -> None:
    policy = small_policy(6, 2)
    observations, masks = random_observations(8, 4, 6), random_masks(8, 4)
    model = copy.deepcopy(policy)
    for x, mask in zip(observations, masks, strict=True):
        set_masks(model, mask.reshape(-1), complete_graph(4), apply_sigmoid=False)
        with torch.no_grad():
            theirs = model(x, complete_graph(4))
            ours = policy.distribution(x[None], mask[None]).action[0]
        clear_masks(model)
        torch.testing.assert_close(ours, theirs, rtol=0, atol=1e-6)


def test_row_i_of_the_mask_is_about_receiver_i() -> None:
    policy = small_policy(6, 3)
    observations = random_observations(1, 4, 6)
    mask = torch.ones(1, 4, 4)
    mask[0, 1, 2] = 0.0  # the message 2 -> 1
    with torch.no_grad():
        full = policy.distribution(observations).action[0]
        changed = (policy.distribution(observations, mask).action[0] - full).abs().sum(-1)
    assert changed[1] > 1e-4
    assert changed[[0, 2, 3]].max() == 0.0


@pytest.mark.parametrize("edge", [(0, 0), (2, 2), (0, 1), (2, 0)])
def test_every_edge_carries_its_message_the_own_one_too(edge: tuple[int, int]) -> None:
    policy = small_policy(5, 4)
    observations = random_observations(1, 3, 5)
    mask = torch.ones(1, 3, 3)
    mask[0, *edge] = 0.0
    with torch.no_grad():
        change = (policy.distribution(observations, mask).loc - policy.distribution(observations).loc).abs()
    assert change[0, edge[0]].max() > 1e-4


def test_permuting_agents_permutes_actions() -> None:
    policy = small_policy(6, 5)
    observations, masks = random_observations(5, 4, 6), random_masks(5, 4)
    order = torch.tensor([2, 0, 3, 1])
    with torch.no_grad():
        prepared = policy.prepare(observations)
        permuted = policy.prepare(observations[:, order])
        action = policy.decode(prepared, masks).action
        permuted_action = policy.decode(permuted, masks[:, order][:, :, order]).action
    torch.testing.assert_close(
        permuted.attention, prepared.attention[:, order][:, :, order], rtol=0, atol=1e-6
    )
    torch.testing.assert_close(permuted_action, action[:, order], rtol=0, atol=1e-6)


def test_a_mask_of_ones_is_no_mask_to_the_bit() -> None:
    policy = small_policy(6, 6)
    observations = random_observations(40, 3, 6)
    with torch.no_grad():
        assert torch.equal(
            policy.distribution(observations).loc, policy.distribution(observations, torch.ones(40, 3, 3)).loc
        )
