"""Metrics against values computed by hand and against torch.distributions."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import spearmanr
from torch.distributions import Categorical, Independent, Normal
from torch.distributions import kl_divergence as torch_kl

from xmarl_bench.metrics import (
    attention_distance,
    attention_entropy,
    categorical_kl,
    fidelity,
    graph_explanation_unfaithfulness,
    kl_divergence,
    mask_mass,
    prediction_change,
    rank_correlation,
)


def test_fidelity_by_hand() -> None:
    full = np.array([[[0.5, -0.5], [0.0, 1.0]]])  # one timestep, two agents, two action entries
    kept = np.array([[[0.5, -0.3], [0.0, 1.0]]])  # agent 0: (0 + 0.2) / 2 = 0.1, agent 1: 0
    dropped = np.array([[[-0.5, -0.5], [0.4, 0.4]]])  # agent 0: (1 + 0) / 2, agent 1: (0.4 + 0.6) / 2
    result = fidelity(full, kept, dropped)
    np.testing.assert_allclose(prediction_change(full, kept), [[0.1, 0.0]])
    np.testing.assert_allclose(result.minus, [0.05])
    np.testing.assert_allclose(result.plus, [0.5])
    np.testing.assert_allclose(result.delta, [0.45])


def test_fidelity_of_discrete_actions_is_total_variation_by_hand() -> None:
    full = np.array([[[0.5, 0.3, 0.2, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0, 0.0]]])
    kept = np.array([[[0.4, 0.3, 0.2, 0.1, 0.0], [1.0, 0.0, 0.0, 0.0, 0.0]]])  # 0.1 moves; nothing
    dropped = np.array([[[0.0, 0.3, 0.2, 0.0, 0.5], [0.0, 0.0, 0.0, 0.0, 1.0]]])  # 0.5 moves; all
    result = fidelity(full, kept, dropped, 2)
    np.testing.assert_allclose(prediction_change(full, kept, 2), [[0.1, 0.0]])
    np.testing.assert_allclose((result.minus, result.plus, result.delta), [[0.05], [0.75], [0.7]])


def test_fidelity_averages_over_agents_and_not_over_timesteps() -> None:
    full = np.zeros((3, 2, 2))
    kept = np.arange(3.0).reshape(3, 1, 1) * np.ones((3, 2, 2))
    assert fidelity(full, kept, full).minus.tolist() == [0.0, 1.0, 2.0]
    assert fidelity(full, kept, full).plus.tolist() == [0.0, 0.0, 0.0]


def test_the_complement_swaps_plus_and_minus() -> None:
    rng = np.random.default_rng(0)
    full, kept, dropped = rng.uniform(-1, 1, (3, 5, 4, 2))
    one, other = fidelity(full, kept, dropped), fidelity(full, dropped, kept)
    np.testing.assert_array_equal(one.plus, other.minus)
    np.testing.assert_array_equal(one.delta, -other.delta)


def test_kl_by_hand() -> None:
    # KL(N(0, 1) || N(1, 2)) = ln 2 + (1 + 1) / 8 - 1/2, in one action entry; the other is identical.
    kl = kl_divergence(np.array([0.0, 3.0]), np.array([1.0, 0.5]), np.array([1.0, 3.0]), np.array([2.0, 0.5]))
    assert kl == pytest.approx(math.log(2) + 0.25 - 0.5, abs=1e-12)


def test_kl_is_from_full_to_masked() -> None:
    p, q = (np.array([0.0]), np.array([1.0])), (np.array([1.0]), np.array([2.0]))
    forward, reverse = kl_divergence(*p, *q), kl_divergence(*q, *p)
    assert forward == pytest.approx(math.log(2) - 0.25)
    assert reverse == pytest.approx(-math.log(2) + (4 + 1) / 2 - 0.5)


finite = st.floats(-3, 3)
scales = st.floats(0.05, 5)


@given(st.lists(st.tuples(finite, scales, finite, scales), min_size=6, max_size=6))
def test_kl_equals_torch_summed_over_action_entries(rows: list[tuple[float, float, float, float]]) -> None:
    loc_p, scale_p, loc_q, scale_q = np.array(rows).T.reshape(4, 3, 2)  # 3 agents, 2 action entries
    p = Independent(Normal(torch.tensor(loc_p), torch.tensor(scale_p)), 1)
    q = Independent(Normal(torch.tensor(loc_q), torch.tensor(scale_q)), 1)
    ours = kl_divergence(loc_p, scale_p, loc_q, scale_q)
    assert ours.shape == (3,)
    np.testing.assert_allclose(ours, torch_kl(p, q).numpy(), rtol=1e-9, atol=1e-12)


def test_kl_of_categoricals_by_hand() -> None:
    # Of (1/2, 1/2) from (1/4, 3/4): 1/2 ln 2 + 1/2 ln(2/3).
    p, q = np.log([0.5, 0.5]), np.log([0.25, 0.75])
    assert categorical_kl(p, q) == pytest.approx(0.5 * math.log(2) + 0.5 * math.log(2 / 3))
    assert categorical_kl(q, p) == pytest.approx(0.25 * math.log(0.5) + 0.75 * math.log(1.5))


@given(st.lists(st.lists(st.floats(-30, 30), min_size=5, max_size=5), min_size=2, max_size=2))
def test_kl_of_categoricals_equals_torch(logits: list[list[float]]) -> None:
    p, q = (Categorical(logits=torch.tensor(row, dtype=torch.double)) for row in logits)
    ours = categorical_kl(p.logits.numpy(), q.logits.numpy())
    np.testing.assert_allclose(ours, torch_kl(p, q).numpy(), rtol=1e-9, atol=1e-12)


@given(st.lists(st.floats(-30, 30), min_size=5, max_size=5), st.floats(-1e-6, 1e-6))
def test_kl_of_categoricals_is_not_negative_in_float32(logits: list[float], change: float) -> None:
    p = torch.log_softmax(torch.tensor(logits), dim=-1)
    q = torch.log_softmax(torch.tensor(logits) * (1 + change), dim=-1)
    assert 0.0 <= float(categorical_kl(p.numpy(), q.numpy())) < 1e-6


def test_unfaithfulness_is_per_agent_not_joint() -> None:
    kl = np.array([[0.0, math.log(2)], [0.0, np.inf]])
    np.testing.assert_allclose(graph_explanation_unfaithfulness(kl), [0.25, 0.5])


def test_unfaithfulness_is_accurate_for_small_divergences() -> None:
    assert graph_explanation_unfaithfulness(np.array([1e-20])) == pytest.approx(1e-20)


def test_attention_entropy_by_hand() -> None:
    uniform, alone = np.full((3, 3), 1 / 3), np.eye(3)
    halves = np.array([[0.5, 0.5, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    received = attention_entropy(np.stack([uniform, alone, halves]))
    np.testing.assert_allclose(received, [math.log(3), 0.0, math.log(2) / 3], atol=1e-15)


def test_attention_that_does_not_sum_to_1_has_no_entropy() -> None:
    nobody = np.diag([1.0, 1.0, 0.0])  # the last agent hears nobody
    gates, signed = np.full((3, 3), 0.5), np.full((3, 3), 1 / 3) + np.array([1.0, -1.0, 0.0])
    received = attention_entropy(np.stack([nobody, gates, signed, np.eye(3)]).astype(np.float32))
    np.testing.assert_array_equal(received, [0.0, np.nan, np.nan, 0.0])
    distance = attention_distance(np.stack([nobody, gates, signed, np.eye(3)]))
    np.testing.assert_array_equal(distance, [9.0, np.nan, np.nan, 9.0])


def test_attention_distance_by_hand() -> None:
    uniform, alone = np.full((3, 3), 1 / 3), np.eye(3)
    mixed = np.array([[0.75, 0.25, 0.0], [0.5, 0.5, 0.0], [0.4, 0.3, 0.3]])
    # |2 alpha - 1| by row: 0.5 + 0.5 + 1, 0 + 0 + 1, 0.2 + 0.4 + 0.4.
    received = attention_distance(np.stack([uniform, alone, mixed]))
    np.testing.assert_allclose(received, [3.0, 9.0, 4.0], atol=1e-12)


@given(
    st.integers(1, 7).flatmap(
        lambda n: st.lists(st.lists(st.floats(-9, 9), min_size=n, max_size=n), min_size=n, max_size=n)
    )
)
def test_attention_distance_is_at_least_the_paper_s_bound(logits: list[list[float]]) -> None:
    alpha = np.exp(logits) / np.exp(logits).sum(axis=1, keepdims=True)
    n = len(alpha)
    distance = float(attention_distance(alpha))
    assert abs(2 * n - n**2) - 1e-9 <= distance <= n**2 + 1e-9
    assert attention_distance(np.full((n, n), 1 / n)) == pytest.approx(abs(2 * n - n**2))
    # The excess over the bound is by how much each row's largest coefficient exceeds one half.
    excess = np.maximum(0.0, alpha.max(axis=1) - 0.5).sum()
    assert distance == pytest.approx(n**2 - 2 * n + 4 * excess)


def test_uniform_attention_is_not_the_only_one_at_the_lower_bound() -> None:
    peaked = np.tile([0.5, 0.5, 0.0], (3, 1))  # less entropy than uniform, the same distance
    assert attention_distance(peaked) == 3.0
    assert attention_distance(np.full((3, 3), 1 / 3)) == pytest.approx(3.0)


def test_rank_correlation_by_hand() -> None:
    a = np.array([[0.1, 0.2, 0.3], [5.0, 5.0, 5.0]])  # the second row ranks nothing
    assert rank_correlation(a, a * 100 - 3) == pytest.approx(1.0)
    assert rank_correlation(a, -a) == pytest.approx(-1.0)
    # Centred ranks (-1, 0, 1) and, with a tie, (-0.5, -0.5, 1): (0.5 + 1) / sqrt(2 * 1.5).
    assert rank_correlation(a[:1], np.array([[0.0, 0.0, 0.9]])) == pytest.approx(1.5 / math.sqrt(3))
    # Pooled: rows (-1, 0, 1) against the same and against (1, 0, -1) have equal weight.
    assert rank_correlation(np.tile(a[0], (2, 1)), np.array([a[0], -a[0]])) == pytest.approx(0.0)


def test_masks_that_rank_nothing_have_no_rank_correlation() -> None:
    assert math.isnan(rank_correlation(np.ones((4, 3)), np.random.default_rng(0).random((4, 3))))
    holed = np.array([[0.1, np.nan, 0.3]])
    assert math.isnan(rank_correlation(holed, np.array([[1.0, 2.0, 3.0]])))


def test_rank_correlation_of_one_row_is_spearmans() -> None:
    a, b = np.random.default_rng(0).integers(0, 5, (2, 12)).astype(float)  # with ties
    assert rank_correlation(a[None], b[None]) == pytest.approx(spearmanr(a, b).statistic)
    some = np.arange(12) < 9
    of_some = spearmanr(a[some], b[some]).statistic
    assert rank_correlation(a[None], b[None], some[None]) == pytest.approx(of_some)


def test_mask_mass_by_hand() -> None:
    masks = np.array([[[1.0, 0.0], [0.5, 0.5]], [[1.0, 1.0], [1.0, 1.0]]])
    np.testing.assert_array_equal(mask_mass(masks), [0.5, 1.0])


def test_nan_is_propagated() -> None:
    full = np.zeros((2, 1, 2))
    kept = full.copy()
    kept[1, 0, 0] = np.nan
    result = fidelity(full, kept, full)
    assert result.minus[0] == 0.0
    assert np.isnan(result.minus[1])
    assert np.isnan(result.delta[1])
    assert np.isnan(graph_explanation_unfaithfulness(np.array([np.nan, 0.0])))
