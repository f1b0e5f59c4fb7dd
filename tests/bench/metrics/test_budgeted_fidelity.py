"""Budgeted fidelity by hand, at its limits, and against brute force over whole masks."""

from __future__ import annotations

from itertools import combinations, permutations

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from tests.helpers.policies import random_observations, small_policy
from xmarl_bench.explain.oracle import change_table
from xmarl_bench.metrics import (
    budgeted_fidelity,
    choices,
    fid_delta_at_k,
    fid_delta_table,
    fidelity,
    oracle_at_k,
    other_senders,
    others_table,
    random_at_k,
)
from xmarl_bench.policy import GraphPolicy

Floats = NDArray[np.float64]


def score_of(change: Floats, mask: NDArray[np.floating]) -> float:
    delta = fid_delta_table(change)
    explained = fid_delta_at_k(delta, choices(mask))
    return budgeted_fidelity(explained, random_at_k(delta), oracle_at_k(delta))


def changes(n_senders: int, seed: int, n_steps: int = 4, n_receivers: int = 3) -> Floats:
    """(R, S, N) random changes, with d(everything kept) = 0."""
    change = np.random.default_rng(seed).random((2**n_senders, n_steps, n_receivers))
    change[-1] = 0.0
    return change


# One receiver, one timestep, three senders. Row 0 keeps nothing, 7 everything, bit j is sender j.
BY_HAND = np.array([1.0, 0.4, 0.8, 0.3, 0.9, 0.2, 0.7, 0.0]).reshape(8, 1, 1)


def test_the_parts_by_hand() -> None:
    delta = fid_delta_table(BY_HAND)
    # {0}: d{1,2} - d{0} = 0.7 - 0.4; {1}: 0.2 - 0.8; {2}: 0.3 - 0.9; pairs are minus their complements.
    np.testing.assert_allclose(delta[[1, 2, 4, 6, 5, 3], 0, 0], [0.3, -0.6, -0.6, -0.3, 0.6, 0.6], atol=1e-12)
    np.testing.assert_allclose(random_at_k(delta), [-0.3, 0.3])
    np.testing.assert_allclose(oracle_at_k(delta), [0.3, 0.6])
    mask = np.array([[[0.2, 0.9, 0.5]]])
    assert choices(mask)[:, 0, 0].tolist() == [0, 0, 1, 0, 0, 0, 1, 0]
    np.testing.assert_allclose(fid_delta_at_k(delta, choices(mask)), [-0.6, -0.3])
    # ((-0.6 + 0.3) / 0.6 + (-0.3 - 0.3) / 0.3) / 2 = (-0.5 - 2) / 2
    assert score_of(BY_HAND, np.array([[[0.2, 0.9, 0.5]]])) == pytest.approx(-1.25)
    assert score_of(BY_HAND, np.array([[[0.9, 0.2, 0.5]]])) == pytest.approx(1.0)


def test_ratio_of_means_not_mean_of_ratios() -> None:
    small = BY_HAND * 0.01
    change = np.concatenate([BY_HAND, small], axis=1)  # a timestep with large changes and one with small ones
    best, worst = [0.9, 0.2, 0.5], [0.2, 0.9, 0.5]
    mixed = score_of(change, np.array([[best], [worst]]))
    assert mixed == pytest.approx((1.0 + 0.01 * -1.25) / 1.01)


def test_without_a_valid_budget_the_value_is_nan() -> None:
    mask = np.random.default_rng(0).random((4, 3, 3))
    assert np.isnan(score_of(np.zeros((8, 4, 3)), mask))
    assert np.isnan(score_of(changes(3, 0) * 1e-4, mask))
    assert np.isnan(budgeted_fidelity(np.array([]), np.array([]), np.array([])))  # one sender: no budget
    one_is_left = budgeted_fidelity(np.array([0.3, 9.0]), np.array([0.1, 0.0]), np.array([0.5, 1e-4]))
    assert one_is_left == pytest.approx(0.5)
    holed = changes(3, 0)
    holed[2, 0, 0] = np.nan
    assert np.isnan(score_of(holed, mask))


def test_one_sender_has_no_budget() -> None:
    assert np.isnan(score_of(changes(1, 0, 2, 1), np.ones((2, 1, 1))))


@given(n_senders=st.integers(2, 5), seed=st.integers(0, 10**6))
def test_values_are_at_most_one_and_one_for_the_best_ranking(n_senders: int, seed: int) -> None:
    change = changes(n_senders, seed)
    mask = np.random.default_rng(seed + 1).random((4, 3, n_senders))
    assert score_of(change, mask) <= 1.0 + 1e-12
    # Where changes add up over senders the best k-subsets are nested, and their ranking scores 1.
    worth = np.random.default_rng(seed + 2).random((4, 3, n_senders))
    kept = np.arange(2**n_senders)[:, None, None, None] >> np.arange(n_senders) & 1
    additive = ((1 - kept) * worth).sum(axis=-1)
    assert score_of(additive, worth) == pytest.approx(1.0)
    assert score_of(additive, -worth) < 0.0


@given(
    values=st.lists(st.integers(0, 6), min_size=48, max_size=48),
    seed=st.integers(0, 10**6),
    power=st.floats(0.2, 5.0),
)
def test_a_monotone_change_of_a_mask_does_not_change_it(values: list[int], seed: int, power: float) -> None:
    mask = np.array(values).reshape(4, 3, 4) / 6
    change = changes(4, seed)
    before = score_of(change, mask)
    for moved in (0.9 + mask / 10, mask**power, np.exp(mask) / 3, mask.astype(np.float32)):
        assert score_of(change, moved) == before


def test_a_random_ranking_scores_zero_in_expectation() -> None:
    change = changes(4, 5, n_steps=2000)
    rng = np.random.default_rng(0)
    scores = [score_of(change, rng.random((2000, 3, 4))) for _ in range(20)]
    assert abs(np.mean(scores)) < 4 * np.std(scores) / np.sqrt(20) < 0.02


@given(n_senders=st.integers(2, 6), seed=st.integers(0, 10**6), level=st.floats(0.0, 1.0))
def test_a_constant_mask_ranks_nothing_and_scores_zero(n_senders: int, seed: int, level: float) -> None:
    assert score_of(changes(n_senders, seed), np.full((4, 3, n_senders), level)) == 0.0


@given(values=st.lists(st.integers(0, 2), min_size=60, max_size=60), seed=st.integers(0, 10**6))
def test_ties_are_averaged_over_all_ways_to_choose(values: list[int], seed: int) -> None:
    """Against every order of the five senders that the mask allows."""
    mask, delta = np.array(values).reshape(4, 3, 5) / 2, fid_delta_table(changes(5, seed))
    explained = fid_delta_at_k(delta, choices(mask))
    orders = np.array(list(permutations(range(5))))
    expected = np.zeros(4)
    for s, i in np.ndindex(4, 3):
        allowed = orders[(np.diff(mask[s, i][orders], axis=1) <= 0).all(axis=1)]
        rows = np.cumsum(1 << allowed, axis=1)[:, :-1]
        expected += delta[:, s, i][rows].mean(axis=0) / 12
    np.testing.assert_allclose(explained, expected, atol=1e-12)


def test_the_exact_mean_equals_the_mean_over_all_subsets() -> None:
    delta = fid_delta_table(changes(5, 3))
    for k in range(1, 5):
        rows = [sum(1 << j for j in chosen) for chosen in combinations(range(5), k)]
        values = np.stack([delta[row] for row in rows])
        assert random_at_k(delta)[k - 1] == pytest.approx(values.mean())
        assert oracle_at_k(delta)[k - 1] == pytest.approx(values.max(axis=0).mean())


def actions(policy: GraphPolicy, observations: torch.Tensor, mask: torch.Tensor | None) -> Floats:
    with torch.no_grad():
        return policy.distribution(observations, mask).action.double().numpy()


@pytest.mark.parametrize("n_agents", [3, 4, 5])
def test_the_table_agrees_with_masked_forwards(n_agents: int) -> None:
    """FidDelta@k from the table equals FidDelta of the binary mask run through the policy."""
    policy, observations = small_policy(5, 1), random_observations(6, n_agents, 5)
    change = change_table(policy, observations)
    mask = np.random.default_rng(0).random((6, n_agents, n_agents))
    eye = torch.eye(n_agents)
    full = actions(policy, observations, None)
    everything = fid_delta_at_k(fid_delta_table(change), choices(mask))
    communication = fid_delta_at_k(fid_delta_table(others_table(change)), choices(other_senders(mask)))
    assert (everything.shape, communication.shape) == ((n_agents - 1,), (n_agents - 2,))
    for k in range(1, n_agents):
        top = torch.tensor(mask >= np.sort(mask, axis=-1)[..., [-k]]).float()
        kept, dropped = (actions(policy, observations, m) for m in (top, 1 - top))
        assert everything[k - 1] == pytest.approx(fidelity(full, kept, dropped).delta.mean(), abs=1e-6)
        if k <= n_agents - 2:
            without_own = np.where(np.eye(n_agents, dtype=bool), -1.0, mask)
            top = torch.tensor(without_own >= np.sort(without_own, axis=-1)[..., [-k]]).float()
            kept = actions(policy, observations, (top + eye).clamp(max=1.0))
            dropped = actions(policy, observations, (1 - top + eye).clamp(max=1.0))
            assert communication[k - 1] == pytest.approx(fidelity(full, kept, dropped).delta.mean(), abs=1e-6)


def test_other_senders_by_hand() -> None:
    mask = np.arange(9.0).reshape(1, 3, 3)
    assert other_senders(mask).tolist() == [[[1.0, 2.0], [3.0, 5.0], [6.0, 7.0]]]
    change = np.arange(8.0).reshape(8, 1, 1) * np.ones((1, 1, 3))  # each value is its row index
    assert others_table(change)[:, 0].T.tolist() == [[1, 3, 5, 7], [2, 3, 6, 7], [4, 5, 6, 7]]
