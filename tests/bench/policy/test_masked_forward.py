"""F(m): the batched path, PyG's message passing and the written-out formula agree."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor, nn
from torch_geometric.explain.algorithm.utils import clear_masks, set_masks
from torch_geometric.nn import GATv2Conv, MessagePassing, SAGEConv

from tests.helpers.deep_policies import Opened, one_layer, transformers, two_layers
from tests.helpers.dense_reference import reference_distribution
from tests.helpers.policies import ROUNDING, random_masks, random_observations, small_policy
from xmarl_bench.errors import InputError
from xmarl_bench.policy import ModulePolicy, complete_graph

with_and_without_residual = pytest.mark.parametrize("residual", [False, True], ids=["plain", "residual"])


@pytest.mark.slow
@given(
    n_agents=st.integers(1, 6),
    seed=st.integers(0, 1000),
    encoder=st.sampled_from([(), (7,), (5, 6)]),
    residual=st.booleans(),
    binary=st.booleans(),
)
def test_masked_forward_equals_the_formula(
    n_agents: int, seed: int, encoder: tuple[int, ...], residual: bool, binary: bool
) -> None:
    policy = small_policy(5, seed, encoder, residual=residual)
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
        np.testing.assert_allclose(single.action[s].numpy(), np.tanh(loc), rtol=0, atol=ROUNDING)
        np.testing.assert_allclose(single.scale[s].numpy(), scale, rtol=2e-6, atol=1e-6)
        np.testing.assert_allclose(double.loc[s].numpy(), loc, rtol=1e-10, atol=1e-12)


@with_and_without_residual
def test_batched_path_equals_pyg_forward(residual: bool) -> None:
    policy = small_policy(6, 1, residual=residual)
    observations = random_observations(8, 4, 6)
    with torch.no_grad():
        batched = policy.distribution(observations).action
        each = torch.stack([policy(x, complete_graph(4)) for x in observations])
    torch.testing.assert_close(batched, each, rtol=0, atol=ROUNDING)


@with_and_without_residual
def test_masked_path_equals_pyg_with_an_edge_mask_including_loops(residual: bool) -> None:
    policy = small_policy(6, 2, residual=residual)
    observations, masks = random_observations(8, 4, 6), random_masks(8, 4)
    model = copy.deepcopy(policy)
    for x, mask in zip(observations, masks, strict=True):
        set_masks(model, mask.reshape(-1), complete_graph(4), apply_sigmoid=False)
        with torch.no_grad():
            theirs = model(x, complete_graph(4))
            ours = policy.distribution(x[None], mask[None]).action[0]
        clear_masks(model)
        torch.testing.assert_close(ours, theirs, rtol=0, atol=ROUNDING)


@with_and_without_residual
def test_row_i_of_the_mask_changes_only_receiver_i(residual: bool) -> None:
    policy = small_policy(6, 3, residual=residual)
    observations = random_observations(1, 4, 6)
    mask = torch.ones(1, 4, 4)
    mask[0, 1, 2] = 0.0  # the message 2 -> 1
    with torch.no_grad():
        full = policy.distribution(observations).action[0]
        changed = (policy.distribution(observations, mask).action[0] - full).abs().sum(-1)
    assert changed[1] > 1e-4
    assert changed[[0, 2, 3]].max() == 0.0


@with_and_without_residual
@pytest.mark.parametrize("edge", [(0, 0), (2, 2), (0, 1), (2, 0)])
def test_every_edge_carries_its_message_including_the_own_edge(edge: tuple[int, int], residual: bool) -> None:
    policy = small_policy(5, 4, residual=residual)
    observations = random_observations(1, 3, 5)
    mask = torch.ones(1, 3, 3)
    mask[0, *edge] = 0.0
    with torch.no_grad():
        change = (policy.distribution(observations, mask).loc - policy.distribution(observations).loc).abs()
    assert change[0, edge[0]].max() > 1e-4


@with_and_without_residual
def test_permuting_agents_permutes_actions(residual: bool) -> None:
    policy = small_policy(6, 5, residual=residual)
    observations, masks = random_observations(5, 4, 6), random_masks(5, 4)
    order = torch.tensor([2, 0, 3, 1])
    with torch.no_grad():
        prepared = policy.prepare(observations)
        permuted = policy.prepare(observations[:, order])
        action = policy.decode(prepared, masks).action
        permuted_action = policy.decode(permuted, masks[:, order][:, :, order]).action
    torch.testing.assert_close(
        permuted.attention, prepared.attention[:, order][:, :, order], rtol=0, atol=ROUNDING
    )
    torch.testing.assert_close(permuted_action, action[:, order], rtol=0, atol=ROUNDING)


@with_and_without_residual
def test_a_mask_of_ones_equals_no_mask_bit_for_bit(residual: bool) -> None:
    policy = small_policy(6, 6, residual=residual)
    observations = random_observations(40, 3, 6)
    with torch.no_grad():
        assert torch.equal(
            policy.distribution(observations).loc, policy.distribution(observations, torch.ones(40, 3, 3)).loc
        )


@pytest.mark.slow
@settings(max_examples=15)
@given(
    n_agents=st.integers(1, 6),
    seed=st.integers(0, 1000),
    encoder=st.sampled_from([(), (7,)]),
    residual=st.booleans(),
)
def test_the_generic_path_equals_the_fast_path(
    n_agents: int, seed: int, encoder: tuple[int, ...], residual: bool
) -> None:
    fast = small_policy(5, seed, encoder, residual=residual)
    generic = ModulePolicy(Opened(fast), 5)
    observations = random_observations(3, n_agents, 5, seed)
    masks = torch.stack([random_masks(3, n_agents, seed + k) for k in range(2)])
    with torch.no_grad():
        for mask in (None, masks[0], masks, masks[:, :1], (masks[:, :, :1] > 0.5).float()):
            ours, theirs = generic.distribution(observations, mask), fast.distribution(observations, mask)
            torch.testing.assert_close(ours.loc, theirs.loc, rtol=0, atol=1e-5)
            torch.testing.assert_close(ours.scale, theirs.scale, rtol=1e-5, atol=1e-5)
        torch.testing.assert_close(
            generic.attention(observations), fast.attention(observations), rtol=0, atol=1e-5
        )


@pytest.mark.parametrize("make", [one_layer, two_layers, transformers])
def test_a_batch_equals_pyg_one_graph_at_a_time(make: Callable[[int], ModulePolicy]) -> None:
    policy = make(6)
    observations, masks = random_observations(4, 3, 6), random_masks(4, 3)
    with torch.no_grad():
        batched = policy.distribution(observations, masks).action
        whole = policy.distribution(observations).action
    model = copy.deepcopy(policy)
    for s in range(4):
        with torch.no_grad():
            plain = model(observations[s], complete_graph(3))
            set_masks(model, masks[s].reshape(-1), complete_graph(3), apply_sigmoid=False)
            masked = model(observations[s], complete_graph(3))
            clear_masks(model)
        torch.testing.assert_close(batched[s], masked, rtol=0, atol=ROUNDING)
        torch.testing.assert_close(whole[s], plain, rtol=0, atol=ROUNDING)
        assert (masked - plain).abs().max() > 1e-3


@pytest.mark.parametrize("make", [one_layer, two_layers, transformers])
def test_gradients_of_a_batch_are_uncoupled(make: Callable[[int], ModulePolicy]) -> None:
    policy, observations = make(6), random_observations(3, 3, 6)
    masks = random_masks(3, 3).requires_grad_()
    (gradient,) = torch.autograd.grad(policy.distribution(observations, masks).action[1].sum(), masks)
    assert gradient[1].abs().max() > 1e-4
    assert bool((gradient[[0, 2]] == 0).all())


def test_masks_do_not_change_the_residual() -> None:
    """With every message masked, the decoder gets R x_i + b: a linear map of the agent's own encoding."""
    policy, observations = small_policy(6, 7, residual=True), random_observations(5, 4, 6)
    encoded = policy.encoder(observations)
    own = encoded @ policy.gat.res.weight.mT + policy.gat.bias
    with torch.no_grad():
        nothing = policy.distribution(observations, torch.zeros(5, 4, 4))
        torch.testing.assert_close(nothing.loc, policy.head(own, own[..., :0])[0].loc, rtol=0, atol=ROUNDING)
        # Without a residual every agent gets only b, and all act alike.
        plain = small_policy(6, 7).distribution(observations, torch.zeros(5, 4, 4)).loc
    assert (nothing.loc[:, 0] - nothing.loc[:, 1]).abs().max() > 1e-2
    torch.testing.assert_close(plain, plain[:1, :1].expand_as(plain), rtol=0, atol=ROUNDING)


def test_rows_are_independent_only_in_one_layer() -> None:
    observations = random_observations(2, 4, 6)
    for policy, row_wise in (
        (small_policy(6), True),
        (small_policy(6, residual=True), True),
        (one_layer(6), True),
        (two_layers(6), False),
    ):
        assert policy.row_wise is row_wise
        mask = torch.ones(2, 4, 4)
        mask[:, 1:] = random_masks(2, 4)[:, 1:]
        with torch.no_grad():
            difference = policy.distribution(observations, mask).loc - policy.distribution(observations).loc
        assert (difference[:, 1:].abs().amax() > 1e-3) and (
            (difference[:, 0].abs().amax() < 1e-6) == row_wise
        )


def test_a_layer_that_runs_twice_counts_as_two_layers() -> None:
    class Twice(nn.Module):
        def __init__(self) -> None:
            super().__init__()
            self.layer = GATv2Conv(4, 4, add_self_loops=False)

        def forward(self, x: Tensor, edge_index: Tensor) -> Tensor:
            out: Tensor = self.layer(self.layer(x, edge_index), edge_index)
            return out

    assert not ModulePolicy(Twice(), 4).row_wise


def test_the_generic_path_leaves_no_hooks_and_can_be_pickled() -> None:
    policy, observations = two_layers(6), random_observations(2, 3, 6)
    with torch.no_grad():
        before = policy(observations[0], complete_graph(3))
        masked = policy.distribution(observations, torch.zeros(2, 3, 3)).loc
        policy.attention(observations)
        assert torch.equal(policy(observations[0], complete_graph(3)), before)
        for copied in (copy.deepcopy(policy), pickle.loads(pickle.dumps(policy))):
            assert torch.equal(copied.distribution(observations, torch.zeros(2, 3, 3)).loc, masked)
    for module in policy.modules():
        if isinstance(module, MessagePassing):
            assert not module.explain
            assert module._edge_mask is None
            assert not module._message_forward_hooks
            assert not module._propagate_forward_hooks


def test_attention_of_a_policy_without_attention_raises() -> None:
    class Mean(nn.Module):
        def __init__(self) -> None:
            super().__init__()
            self.layer = SAGEConv(6, 4)

        def forward(self, x: Tensor, edge_index: Tensor) -> Tensor:
            out: Tensor = self.layer(x, edge_index)
            return out

    policy = ModulePolicy(Mean(), 6)
    assert policy.row_wise
    with pytest.raises(InputError, match="no attention layer"):
        policy.attention(random_observations(2, 3, 6))
