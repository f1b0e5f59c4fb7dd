"""Planted policies follow their rules, checked by interventions on their messages."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from torch import Tensor

from xmarl_bench.errors import InputError
from xmarl_bench.planted.families import CODES, CONTENT, FAMILIES, MATCH_GAP, Planted, planted

TEAMS = [(family, n) for family, rule in FAMILIES.items() for n in (rule.min_agents, 6, CODES)]
EACH = pytest.mark.parametrize(("family", "n_agents"), TEAMS)
SMALL = 1e-4


def location(truth: Planted, mask: Tensor | None = None) -> Tensor:
    """(S, N)"""
    with torch.no_grad():
        return truth.policy.distribution(truth.observations, mask).loc[..., 0]


def without(truth: Planted, senders: np.ndarray) -> Tensor:
    """(S, N): how far locations move without the messages of `senders` (S, N, N)."""
    return (location(truth) - location(truth, torch.from_numpy(~senders).float())).abs()


@EACH
def test_only_relevant_messages_move_the_counted_receivers(family: str, n_agents: int) -> None:
    truth = planted(family, n_agents)
    counted = torch.from_numpy(truth.counted)
    off_diagonal = ~np.eye(n_agents, dtype=bool)
    irrelevant = ~truth.relevant & off_diagonal
    assert without(truth, irrelevant)[counted].max() < SMALL
    missed = truth.relevant.copy()
    if family == "exclusive-or":  # without both messages the receiver acts as if the two disagree
        np.put_along_axis(missed, missed.argmax(axis=-1)[..., None], False, axis=-1)
    assert without(truth, missed)[counted].min() > 0.1
    assert location(truth).abs().max() < 20


@EACH
def test_every_counted_receiver_has_relevant_and_irrelevant_messages(family: str, n_agents: int) -> None:
    truth = planted(family, n_agents)
    assert truth.counted.any()
    n_relevant = truth.relevant.sum(axis=-1)[truth.counted]
    assert (n_relevant == max(1, FAMILIES[family].speakers)).all()
    assert (n_relevant < n_agents - 1).all()
    assert not truth.relevant[:, np.arange(n_agents), np.arange(n_agents)].any()


def test_one_message_of_a_redundant_pair_is_enough() -> None:
    truth = planted("redundant-pair", 5)
    counted, one, other = torch.from_numpy(truth.counted), truth.relevant.copy(), truth.relevant.copy()
    first = truth.relevant.argmax(axis=-1)
    np.put_along_axis(one, first[..., None], False, axis=-1)
    other[one] = False
    assert without(truth, one)[counted].max() < SMALL
    assert without(truth, other)[counted].max() < SMALL
    assert without(truth, truth.relevant)[counted].min() > 1.0


def test_an_exclusive_or_needs_both_messages() -> None:
    truth = planted("exclusive-or", 5)
    acts = location(truth)[torch.from_numpy(truth.counted)]
    assert set(acts.round(decimals=3).abs().tolist()) == {0.0, 2.0}
    said = truth.observations[..., CONTENT].numpy()
    sums = (truth.relevant * said[:, None, :]).sum(axis=-1)[truth.counted]
    np.testing.assert_allclose(acts.numpy(), np.where(sums == 0, 2.0, 0.0), atol=1e-3)


def test_a_decoy_gets_most_of_the_attention() -> None:
    truth = planted("decoy", 5)
    with torch.no_grad():
        attention = truth.policy.attention(truth.observations).numpy()
    read = (attention * truth.relevant).sum(axis=-1)[truth.counted]
    np.testing.assert_allclose(read, 1 / (1 + math.e), atol=1e-3)
    assert (attention.max(axis=-1)[truth.counted] > 0.7).all()


def test_away_from_walls_no_message_matters() -> None:
    truth = planted("near-wall", 5)
    away = ~truth.relevant.any(axis=-1) & (truth.observations[..., 3].numpy() == 0)
    everyone = np.broadcast_to(~np.eye(5, dtype=bool), truth.relevant.shape)
    assert without(truth, everyone)[torch.from_numpy(away)].max() < SMALL


def test_the_gap_between_matching_and_other_codes() -> None:
    """One unit at 1 and the rest at -1, against two at 0 and the rest at -1, slope 0.2."""
    n = CODES
    assert pytest.approx(1 - 0.2 * (n - 1) + 0.2 * (n - 2)) == MATCH_GAP


def test_the_same_seed_gives_the_same_states_and_another_seed_others() -> None:
    one, same, other = (planted("decoy", 4, seed=seed) for seed in (0, 0, 1))
    assert torch.equal(one.observations, same.observations)
    assert not torch.equal(one.observations, other.observations)


def test_invalid_team_sizes_and_names_are_refused() -> None:
    with pytest.raises(InputError, match="takes 4 to 10 agents, got 3"):
        planted("exclusive-or", 3)
    with pytest.raises(InputError, match="one-sender"):
        planted("one-sendr", 4)


def test_states_for_another_team_size() -> None:
    assert planted("by-content", 3).relevant.shape == (100, 3, 3)
