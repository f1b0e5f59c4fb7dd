"""Degraded rankings: what stays, how fast they get worse, and Shapley values by another way."""

from __future__ import annotations

from itertools import permutations

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from tests.helpers.policies import random_observations, small_policy
from xmarl_bench.explain.oracle import change_table
from xmarl_bench.meta.degradation import NOISE, Form, degraded, follows, in_form
from xmarl_bench.meta.right_ranking import ranking_mask, shapley_mask, shapley_values, true_mask
from xmarl_bench.metrics import fid_delta_table, other_senders, others_table, rank_correlation
from xmarl_bench.planted.families import FAMILIES, planted
from xmarl_bench.planted.truth import auroc


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


@given(st.integers(3, 6), st.floats(0.0, 10.0), st.integers(0, 10**6))
def test_rows_keep_their_values_and_own_edges(n_agents: int, noise: float, seed: int) -> None:
    mask = torch.from_numpy(rng(seed).random((4, n_agents, n_agents))).float()
    worse = degraded(mask, noise, rng(seed + 1))
    assert torch.equal(mask.diagonal(dim1=1, dim2=2), worse.diagonal(dim1=1, dim2=2))
    one, other = (np.sort(other_senders(each.numpy()), axis=-1) for each in (mask, worse))
    assert np.array_equal(one, other)
    assert torch.equal(degraded(mask, 0.0, rng(seed)), mask)


def test_two_messages_are_exchanged_as_often_as_noise_says() -> None:
    """Where a normal variable of variance 2 noise^2 exceeds 1."""
    mask = ranking_mask(np.broadcast_to([0.0, 1.0], (4000, 3, 2)))
    expected = [0.0, *stats.norm.sf(1.0 / (np.sqrt(2.0) * np.array(NOISE[1:])))]
    exchanged = [np.mean(degraded(mask, noise, rng()).numpy()[:, 0, 2] == 0.0) for noise in NOISE]
    assert exchanged == pytest.approx(expected, abs=0.02)
    assert [round(100 * share) for share in expected] == [0, 4, 12, 19, 26, 33, 39, 45]


@pytest.mark.parametrize("family", list(FAMILIES))
def test_steps_of_noise_are_steps_from_the_truth_towards_chance(family: str) -> None:
    truth = planted(family, 6, n_steps=300)
    found = [
        auroc(degraded(true_mask(truth), noise, rng(3)).numpy(), truth.relevant, truth.counted)
        for noise in NOISE
    ]
    assert found[0] == 1.0
    assert found == sorted(found, reverse=True)
    assert 0.5 < found[-1] < 0.65
    assert follows(found, NOISE, higher_is_better=True) == pytest.approx(1.0)


def test_the_truth_says_nothing_where_the_rule_is_silent() -> None:
    truth = planted("near-wall", 5)
    mask = other_senders(true_mask(truth).numpy())
    assert (np.ptp(mask, axis=-1)[~truth.counted] == 0.0).all()
    assert (np.ptp(mask, axis=-1)[truth.counted] == 1.0).all()


def test_a_form_changes_no_ranking() -> None:
    mask = torch.from_numpy(rng().random((5, 4, 4)))
    for step in range(len(NOISE)):
        seen = in_form(mask, Form.KEEPS_MORE, step)
        assert rank_correlation(seen.numpy(), mask.numpy()) == pytest.approx(1.0)
        assert float(seen.min()) >= 0.9 * step / (len(NOISE) - 1)
    assert torch.equal(in_form(mask, Form.SAME_VALUES, 3), mask)


def test_what_follows_by_hand() -> None:
    assert follows([3.0, 2.0, 1.0], [0.0, 1.0, 2.0], higher_is_better=True) == pytest.approx(1.0)
    assert follows([3.0, 2.0, 1.0], [0.0, 1.0, 2.0], higher_is_better=False) == pytest.approx(-1.0)
    assert follows([3.0, 1.0, 2.0], [0.0, 1.0, 2.0], higher_is_better=True) == pytest.approx(0.5)
    assert follows([1.0, 1.0], [0.0, 1.0], higher_is_better=True) == 0.0
    assert follows([7.1e-15, 7.5e-15, 8.7e-15], [0.0, 1.0, 2.0], higher_is_better=False) == 0.0  # rounding
    assert np.isnan(follows([3.0, 2.0, np.nan], [0.0, 1.0, 2.0], higher_is_better=True))


def test_shapley_values_are_means_over_the_orders_in_which_messages_come() -> None:
    policy, x = small_policy(6), random_observations(3, 4, 6)
    change = others_table(change_table(policy, x))
    expected = np.zeros((3, 4, 3))
    orders = list(permutations(range(3)))
    for order in orders:
        kept = 0
        for j in order:
            expected[..., j] += (change[kept] - change[kept | 1 << j]) / len(orders)
            kept |= 1 << j
    assert shapley_values(fid_delta_table(change)) == pytest.approx(2.0 * expected)
    mask = shapley_mask(policy, x, torch.Generator())
    assert np.array_equal(other_senders(mask.numpy()).argmax(axis=-1), expected.argmax(axis=-1))
    assert set(other_senders(mask.numpy()).ravel().tolist()) == {0.0, 0.5, 1.0}
