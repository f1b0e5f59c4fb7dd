"""Rank agreement by hand; degenerate explanations and the checks that find them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from tests.conftest import save_bundle
from tests.helpers.made_entries import made_board, made_entry
from tests.helpers.policies import random_observations, small_policy
from xmarl_bench.board import board_of
from xmarl_bench.board.agreement import rank_agreement, scores_of_board
from xmarl_bench.meta.agreement import absences_agree, scores_of_planted
from xmarl_bench.meta.degenerate import RIGHT, degenerate_scores, failed_checks, kinds_of
from xmarl_bench.meta.planted_suite import score_planted
from xmarl_bench.metrics.absence import Absence
from xmarl_bench.policy import load_policy
from xmarl_bench.scoring.states import States


def test_agreement_by_hand() -> None:
    """Fid- is better where it is low; a metric that is missing leaves its explainer out."""
    scores = {
        name: {"fid_delta": float(k), "fid_minus": -float(k), "fid_plus": None if k == 5 else float(-k)}
        for k, name in enumerate("abcdef")
    }
    names = ["fid_delta", "fid_minus", "fid_plus", "gef"]
    found = rank_agreement([scores], names)
    assert found[0, :3] == pytest.approx([1.0, 1.0, -1.0])
    assert np.isnan(found[3]).all()
    few = {name: scores[name] for name in "bcdef"}  # four with Fid+
    assert np.isnan(rank_agreement([few], names)[0, 2])
    swapped = {**scores, "a": scores["f"], "f": scores["a"]}
    both = rank_agreement([scores, few, swapped], names)
    assert both[0, 1] == pytest.approx(1.0)
    assert both[0, 2] == pytest.approx(-1.0)


def test_policies_of_the_board_without_controls_and_gates() -> None:
    entries = [*made_board(["p0"], {"a": 0.9, "b": 0.5}), made_entry("failing", "a", 0.9, success_rate=0.2)]
    (scores,) = scores_of_board(board_of([(f"{k}.json", entry) for k, entry in enumerate(entries)])["tables"])
    assert set(scores) == {"a", "b"}
    assert scores["a"]["message_fidelity"] == pytest.approx(0.9, abs=0.1)


@pytest.mark.slow
def test_planted_scores_are_of_explainers() -> None:
    kinds = [each for each in kinds_of(small_policy(6)).values()][:1]
    from xmarl_bench.explain.explainer import Explainer

    found = scores_of_planted(score_planted([Explainer("right", kinds[0])], sizes=[4], n_steps=3))
    assert [set(each) for each in found] == [{"right"}] * 6


def test_absence_models_agree_with_themselves() -> None:
    policy, x = small_policy(6), random_observations(5, 4, 6)
    states = States.of(policy, x, np.random.default_rng(0), random_observations(7, 4, 6))
    found = absences_agree([states])
    assert found.shape == (len(Absence), len(Absence))
    assert found == pytest.approx(found.T)
    assert np.diagonal(found) == pytest.approx(1.0)
    assert found.min() < 0.999
    assert np.isnan(absences_agree([States.of(policy, x, np.random.default_rng(0))])).all()


FOUND_BY = {
    RIGHT: set(),
    "constant": {"tells messages apart"},
    "first state for all": {"follows the state", "order of timesteps"},
    "one ranking for all receivers": {"follows the receiver"},
    "state before": {"order of timesteps"},
    "state half an episode away": {"order of timesteps"},
    "another policy": {"follows the policy"},
}


@pytest.mark.slow
def test_every_kind_is_found_by_its_check() -> None:
    kinds = kinds_of(small_policy(6, seed=1))
    assert set(kinds) == set(FOUND_BY)
    for name, explain in kinds.items():
        found = failed_checks(explain, small_policy(6), random_observations(20, 4, 6))
        assert set(found) == FOUND_BY[name], name


@pytest.mark.slow
def test_what_metrics_say_of_degenerate_explanations(tmp_path: Path) -> None:
    """A constant ranks nothing: exactly 0. At N = 3 Shapley's ranking is the best under `zero`: exactly 1."""
    policy, card = load_policy(save_bundle(tmp_path))
    found = {each.kind: each for each in degenerate_scores(policy, card, small_policy(6, seed=1), episodes=2)}
    assert found["constant"].values["message_fidelity"] == 0.0
    assert found[RIGHT].values["comm_budgeted_fidelity"] == pytest.approx(1.0)
    for each in found.values():
        assert each.values["comm_budgeted_fidelity"] <= 1.0 + 1e-9
    mask = kinds_of(policy)["one ranking for all receivers"](
        policy, random_observations(4, 4, 6), torch.Generator()
    )
    for j in range(4):
        others = [i for i in range(4) if i != j]
        assert torch.allclose(mask[:, others, j], mask[:, others[:1], j])
