"""Replacements of removed messages, against a dense computation message by message."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from tests.helpers.policies import random_observations, small_policy
from xmarl_bench.explain import absence as module
from xmarl_bench.explain.absence import DRAWS, message_rows, message_table
from xmarl_bench.explain.oracle import change_table
from xmarl_bench.metrics import others_table
from xmarl_bench.metrics.absence import Absence
from xmarl_bench.policy import GraphPolicy
from xmarl_bench.rollout.cell import Cell
from xmarl_bench.rollout.reference_states import reference_states

Floats = NDArray[np.float64]
SIZES = pytest.mark.parametrize("n_agents", [2, 4])
RESIDUAL = pytest.mark.parametrize("residual", [False, True], ids=["plain", "residual"])
ROUNDING = 2e-6


def table_of(policy: GraphPolicy, n_agents: int, absence: Absence, seed: int = 0) -> Floats:
    observations, reference = (random_observations(n, n_agents, 5, seed=k) for k, n in ((1, 6), (2, 11)))
    return message_table(policy, observations, absence, reference, np.random.default_rng(seed))


def dense_table(policy: GraphPolicy, n_agents: int, absence: Absence, seed: int = 0) -> Floats:
    """(2^(N - 1), S, N), one sum over senders at a time, in float64."""
    policy = policy.double()
    observations, reference = (
        random_observations(n, n_agents, 5, seed=k).double() for k, n in ((1, 6), (2, 11))
    )
    with torch.no_grad():
        alpha, message, own, _ = policy.prepare(observations)
        other = policy.prepare(reference).message
        drawn = np.random.default_rng(seed).integers(len(other), size=(DRAWS, 6))
        stand_ins = {
            Absence.ZERO: [torch.zeros_like(message)],
            Absence.RENORMALISED: [torch.zeros_like(message)],
            Absence.MEAN: [other.mean(dim=0).expand_as(message)],
            Absence.RESAMPLE: [other[torch.from_numpy(each)] for each in drawn],
        }[absence]
        full = policy.decode(policy.prepare(observations)).action
        change = np.zeros((2 ** (n_agents - 1), 6, n_agents))
        for r, s, i in np.ndindex(*change.shape):
            others = [j for j in range(n_agents) if j != i]
            kept = {i} | {j for k, j in enumerate(others) if r >> k & 1}
            share = sum(alpha[s, i, j] for j in kept) if absence is Absence.RENORMALISED else 1.0
            for stand_in in stand_ins:
                hidden = own[s, i].clone()
                for j in range(n_agents):
                    said = message[s, j] / share if j in kept else stand_in[s, j]
                    hidden += alpha[s, i, j] * said
                action = policy.head(hidden, hidden[:0])[0].action
                change[r, s, i] += float((full[s, i] - action).abs().mean()) / len(stand_ins)
    return change


@SIZES
@RESIDUAL
@pytest.mark.parametrize("absence", list(Absence))
def test_each_model_equals_its_formula(n_agents: int, residual: bool, absence: Absence) -> None:
    found = table_of(small_policy(5, 3, residual=residual), n_agents, absence)
    expected = dense_table(small_policy(5, 3, residual=residual), n_agents, absence)
    np.testing.assert_allclose(found, expected, atol=ROUNDING)
    assert found[:-1].max() > 1e-2
    assert found[-1].max() == 0.0  # nothing is removed


@SIZES
def test_zero_equals_the_paper_s_masked_forward(n_agents: int) -> None:
    policy = small_policy(5, 4)
    papers = others_table(change_table(policy, random_observations(6, n_agents, 5, seed=1)))
    np.testing.assert_allclose(table_of(policy, n_agents, Absence.ZERO), papers, atol=ROUNDING)


@RESIDUAL
def test_renormalised_equals_a_team_without_the_silent_agents(residual: bool) -> None:
    policy, observations = small_policy(5, 4, residual=residual), random_observations(3, 4, 5)
    table = message_table(policy, observations, Absence.RENORMALISED, observations, np.random.default_rng(0))
    with torch.no_grad():
        full = policy.distribution(observations).action.numpy()
        for kept in ([0, 2], [1], [0, 1, 3]):
            for i in kept:
                alone = policy.distribution(observations[:, kept]).action.numpy()[:, kept.index(i)]
                others = [j for j in range(4) if j != i]
                row = sum(1 << k for k, j in enumerate(others) if j in kept)
                expected = np.abs(full[:, i] - alone).mean(axis=-1)
                np.testing.assert_allclose(table[row, :, i], expected, atol=ROUNDING)


def test_replacing_a_message_without_attention_changes_nothing() -> None:
    """Coefficients are those of the original messages, so a message with coefficient 0 has no replacement."""
    policy = small_policy(5, 1)
    prepared = policy.prepare(random_observations(6, 3, 5, seed=1))
    attention = prepared.attention.detach().clone()
    attention[:, 0] = torch.tensor([0.4, 0.6, 0.0])
    decoy, without = prepared._replace(attention=attention), torch.ones(6, 3, 3)
    without[:, 0, 2] = 0.0
    with torch.no_grad():
        changed = policy.decode(decoy, without, torch.full_like(prepared.message, 100.0)).action
        assert torch.equal(changed, policy.decode(decoy).action)


def test_rows_keep_the_own_edge() -> None:
    rows = message_rows(3)
    assert rows[0].tolist() == torch.eye(3).tolist()
    assert rows[1].tolist() == [[1, 1, 0], [1, 1, 0], [1, 0, 1]]  # the first of the others
    assert rows[3].tolist() == torch.ones(3, 3).tolist()


def test_draws_are_passed_in_and_chunks_change_only_rounding(monkeypatch: pytest.MonkeyPatch) -> None:
    policy = small_policy(5, 2)
    first, other = (table_of(policy, 4, Absence.RESAMPLE, seed) for seed in (0, 1))
    assert np.array_equal(first, table_of(policy, 4, Absence.RESAMPLE, 0))
    assert not np.allclose(first, other)
    monkeypatch.setattr("xmarl_bench.explain.oracle.DECODED_AT_ONCE", 4 * 8 * 2)
    np.testing.assert_allclose(first, table_of(policy, 4, Absence.RESAMPLE, 0), atol=ROUNDING)


@pytest.mark.slow
def test_reference_states_are_those_of_policies_whose_messages_are_known() -> None:
    policy = small_policy(6, 1)
    states = reference_states(policy, Cell("blind_navigation_v0", 3))
    assert states is not None
    assert states.shape[1:] == (3, 6)
    assert len(states) <= 10 * 20
    assert module.DRAWS == 4  # as in the protocol's definitions
