"""The oracle against brute force over whole masks, and its limit."""

from __future__ import annotations

from itertools import product
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.helpers.dense_reference import reference_distribution
from tests.helpers.policies import ROUNDING, random_masks, random_observations, small_policy
from xmarl_bench.errors import InputError
from xmarl_bench.explain import oracle
from xmarl_bench.explain.oracle import (
    MAX_AGENTS,
    action_tables,
    best_rows,
    binary_rows,
    change_table,
    oracle_mask,
    soft_oracle_mask,
)
from xmarl_bench.metrics import prediction_change
from xmarl_bench.policy import GraphPolicy

with_and_without_residual = pytest.mark.parametrize("residual", [False, True], ids=["plain", "residual"])


def fid_delta(policy: GraphPolicy, observations: torch.Tensor, mask: torch.Tensor) -> np.ndarray:
    """(S, N): FidDelta of each receiver, by plain masked forwards."""
    with torch.no_grad():
        full, kept, dropped = (
            policy.distribution(observations, m).action.numpy() for m in (None, mask, 1 - mask)
        )
    divisor = 2 if policy.architecture.distribution == "categorical" else None
    return prediction_change(full, dropped, divisor) - prediction_change(full, kept, divisor)


def test_rows_are_the_bits_of_their_index() -> None:
    rows = binary_rows(3)
    assert rows.tolist()[:4] == [[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]]
    assert rows[-1].tolist() == [1, 1, 1]
    assert torch.equal(rows.flip(0), 1 - rows)


@with_and_without_residual
def test_the_table_equals_the_formula_row_by_row(residual: bool) -> None:
    policy, observations = small_policy(5, 1, residual=residual), random_observations(2, 3, 5)
    with torch.no_grad():
        ((steps, table),) = action_tables(policy, observations)
    assert (steps, tuple(table.action.shape)) == (slice(0, 2), (8, 2, 3, 2))
    for s, r in product(range(2), range(8)):
        mask = np.tile(binary_rows(3)[r].double().numpy(), (3, 1))
        loc, _ = reference_distribution(policy, observations[s].double().numpy(), mask)
        np.testing.assert_allclose(table.action[r, s].numpy(), np.tanh(loc), atol=ROUNDING)


@pytest.mark.slow
@settings(max_examples=12)
@given(
    n_agents=st.integers(1, 5), seed=st.integers(0, 10**6), residual=st.booleans(), categorical=st.booleans()
)
def test_no_binary_mask_beats_the_oracle(n_agents: int, seed: int, residual: bool, categorical: bool) -> None:
    policy = small_policy(5, seed, residual=residual, categorical=categorical)
    observations = random_observations(6, n_agents, 5, seed)
    best = oracle_mask(policy, observations, torch.Generator())
    assert set(best.unique().tolist()) <= {0.0, 1.0}
    highest = fid_delta(policy, observations, best)
    soft = soft_oracle_mask(policy, observations, torch.Generator())
    assert float(soft.min()) >= 0.0
    assert float(soft.max()) <= 1.0
    assert (fid_delta(policy, observations, soft) >= highest - 1e-5).all()
    masks = [random_masks(6, n_agents, seed + k).round() for k in range(4)]
    masks += [torch.ones(6, n_agents, n_agents), torch.eye(n_agents).expand(6, -1, -1)]
    for mask in masks:
        assert (fid_delta(policy, observations, mask) <= highest + 1e-5).all()


@pytest.mark.parametrize("options", [{}, {"residual": True}, {"categorical": True}], ids=str)
def test_the_oracle_is_the_best_of_all_whole_masks(options: dict[str, Any]) -> None:
    policy, observations = small_policy(5, 7, **options), random_observations(1, 3, 5, 3)
    masks = torch.tensor(list(product([0.0, 1.0], repeat=9))).view(512, 3, 3)
    values = fid_delta(policy, observations.expand(512, 3, 5), masks).mean(axis=1)
    received = fid_delta(policy, observations, oracle_mask(policy, observations, torch.Generator())).mean()
    assert received == pytest.approx(values.max(), abs=ROUNDING)
    assert values.max() > 0.0


def test_the_best_row_by_hand() -> None:
    # One receiver, two senders: rows {}, {0}, {1}, {0, 1}.
    change = np.array([0.9, 0.1, 0.6, 0.0]).reshape(4, 1, 1)
    assert best_rows(change).tolist() == [[3]]  # 0.9 - 0.0, against 0.6 - 0.1
    change = np.array([0.2, 0.1, 0.6, 0.0]).reshape(4, 1, 1)
    assert best_rows(change).tolist() == [[1]]  # 0.6 - 0.1, against 0.2 - 0.0


def test_chunks_change_only_rounding(monkeypatch: pytest.MonkeyPatch) -> None:
    policy, observations = small_policy(6, 2), random_observations(50, 4, 6)
    with torch.no_grad():
        whole = change_table(policy, observations)
        monkeypatch.setattr(
            oracle, "DECODED_AT_ONCE", 4 * 16 * 7
        )  # seven timesteps at a time, the last alone
        parts = change_table(policy, observations)
        widths = [table.loc.shape[1] for _, table in action_tables(policy, observations)]
    assert widths == [7] * 7 + [1]
    np.testing.assert_allclose(whole, parts, atol=ROUNDING)
    assert whole[-1].max() == 0.0


@with_and_without_residual
def test_soft_ascent_improves_on_the_binary_oracle(residual: bool) -> None:
    policy, observations = small_policy(6, 3, residual=residual), random_observations(50, 3, 6)
    hard, soft = (
        fid_delta(policy, observations, explain(policy, observations, torch.Generator())).mean()
        for explain in (oracle_mask, soft_oracle_mask)
    )
    assert soft > hard + 1e-4


def test_a_team_too_large_is_refused_in_one_sentence() -> None:
    with pytest.raises(InputError, match=f"at most {MAX_AGENTS} agents, got 11") as raised:
        oracle_mask(small_policy(5), random_observations(1, 11, 5), torch.Generator())
    assert "\n" not in str(raised.value)
