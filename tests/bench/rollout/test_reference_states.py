"""Explainers that learn are fitted on states that no score uses, once, and again for shuffled weights."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from tests.conftest import MakeBundle
from tests.helpers.policies import small_policy
from xmarl_bench import as_explainer
from xmarl_bench.policy import Policy, load_policy
from xmarl_bench.render.recording import record
from xmarl_bench.reproducible import PUBLIC_SEEDS, TRAINING_SEEDS
from xmarl_bench.rollout.cell import Cell, Sampling
from xmarl_bench.rollout.episodes import roll_out
from xmarl_bench.rollout.reference_states import FIRST_FIT_SEED, FIT_EPISODES, FIT_TIMESTEPS, fit_states
from xmarl_bench.scoring import sweep
from xmarl_bench.scoring.request import Request
from xmarl_bench.scoring.score import entries_of, score_requests

pytestmark = pytest.mark.slow

FITTED: list[tuple[float, Tensor]] = []  # the weight and states of every fit


class Learner:
    needs_fit = True

    def fit(self, observations: Tensor, policy: Policy) -> None:
        weights = float(sum(parameter.double().square().sum() for parameter in policy.parameters()))
        first = float(next(iter(policy.parameters())).flatten()[0])
        FITTED.append((weights + first, observations.clone()))
        self.shift = torch.tensor(first)

    def explain(self, observations: Tensor, policy: Policy) -> Tensor:
        return torch.sigmoid(self.shift + torch.cdist(observations[..., :2], observations[..., :2]))


def test_states_are_from_episodes_that_no_score_plays() -> None:
    assert FIRST_FIT_SEED + FIT_EPISODES <= TRAINING_SEEDS.stop <= PUBLIC_SEEDS.start
    policy, cell = small_policy(6), Cell("blind_navigation_v0", 3)
    states = fit_states(policy, cell)
    assert states.shape[0] <= FIT_EPISODES * FIT_TIMESTEPS
    assert states.shape[1:] == (3, 6)
    (episode,) = roll_out(cell.make(), policy, [FIRST_FIT_SEED])
    seen = {row.tobytes() for row in episode.observations}
    assert sum(row.numpy().tobytes() in seen for row in states) == min(FIT_TIMESTEPS, episode.makespan)


def test_a_run_fits_once_and_refits_for_shuffled_weights(
    make_bundle: MakeBundle, monkeypatch: pytest.MonkeyPatch
) -> None:
    played: list[str] = []

    def counted(policy: Policy, cell: Cell, max_cycles: int | None) -> Tensor:
        played.append(cell.task)
        return fit_states(policy, cell, max_cycles)

    monkeypatch.setattr(sweep, "fit_states", counted)
    policy, card = load_policy(make_bundle())
    learner = as_explainer(Learner)
    samplings = (
        Sampling(episodes=3, timesteps=2, max_cycles=4),
        Sampling(episodes=2, timesteps=1, max_cycles=4),
    )
    requests = [Request(policy, card, learner, (Cell(card.task, 3),), each, 1) for each in samplings]
    FITTED.clear()
    entries = list(entries_of(score_requests(requests)))
    assert len(played) == 1  # also for the absence models of both samplings
    first, *others = FITTED
    shuffled = [weights for weights, _ in others]
    assert len(shuffled) == 5  # sanity checks of 3 and of 2 episodes
    assert first[0] not in shuffled
    assert all(torch.equal(states, first[1]) for _, states in others)
    assert torch.equal(first[1], fit_states(policy, Cell(card.task, 3), max_cycles=4))
    assert len(first[1]) == 4 * FIT_EPISODES  # episodes end as early as scored ones
    assert all(entry.explainer.needs_fit for entry in entries)
    again = list(entries_of(score_requests([requests[0]])))
    assert again[0].results[0].episodes == entries[0].results[0].episodes


def test_a_picture_shows_the_fitted_explainer() -> None:
    policy, cell = small_policy(6), Cell("blind_navigation_v0", 3)
    recording = record(cell.make(), "small", policy, max_cycles=5)
    assert recording.explain(as_explainer(Learner), range(3)).shape == (3, 3, 3)
