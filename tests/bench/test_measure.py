"""One episode's metrics, against the dense reference and at their limits."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from tests.bench.dense_reference import reference_distribution
from tests.policies import random_masks, random_observations, small_policy
from xmarl_bench.controls import CONTROLS
from xmarl_bench.entry import EpisodeRow
from xmarl_bench.explainer import Explainer
from xmarl_bench.measure import Unit, explanation_metrics, measure, spaced_timesteps
from xmarl_bench.policy import GraphPolicy
from xmarl_bench.rollout import Episode


def metrics_of(policy: GraphPolicy, observations: torch.Tensor, mask: torch.Tensor) -> dict[str, float]:
    metrics = explanation_metrics(policy, observations, mask)
    assert None not in metrics.values()
    return {name: value for name, value in metrics.items() if value is not None}


def test_metrics_equal_an_independent_dense_reference() -> None:
    policy = small_policy(6, 1)
    observations, masks = random_observations(7, 3, 6), random_masks(7, 3)
    expected: dict[str, list[float]] = {
        "fid_plus": [],
        "fid_minus": [],
        "gef": [],
        "communication_dependence": [],
    }
    kls = []
    for observation, mask in zip(observations.double().numpy(), masks.double().numpy(), strict=True):
        loc, scale = reference_distribution(policy, observation, np.ones((3, 3)))
        kept_loc, kept_scale = reference_distribution(policy, observation, mask)
        dropped, _ = reference_distribution(policy, observation, 1 - mask)
        alone, _ = reference_distribution(policy, observation, np.eye(3))
        kl = (
            np.log(kept_scale / scale) + (scale**2 + (loc - kept_loc) ** 2) / (2 * kept_scale**2) - 0.5
        ).sum(1)
        kls.append(kl)
        expected["fid_plus"].append(np.abs(np.tanh(loc) - np.tanh(dropped)).mean())
        expected["fid_minus"].append(np.abs(np.tanh(loc) - np.tanh(kept_loc)).mean())
        expected["communication_dependence"].append(np.abs(np.tanh(loc) - np.tanh(alone)).mean())
        expected["gef"].append((1 - np.exp(-kl)).mean())
    metrics = metrics_of(policy, observations, masks)
    for name, values in expected.items():
        assert metrics[name] == pytest.approx(np.mean(values), abs=1e-6), name
    assert metrics["median_kl"] == pytest.approx(np.median(kls), rel=1e-5)
    assert metrics["fid_delta"] == pytest.approx(metrics["fid_plus"] - metrics["fid_minus"], abs=1e-12)
    assert metrics["mask_mass"] == pytest.approx(float(masks.double().mean()), abs=1e-9)
    assert metrics["communication_dependence"] > 1e-3


def test_ones_are_perfectly_faithful_and_zeros_their_complement() -> None:
    policy = small_policy(6, 2)
    observations = random_observations(20, 4, 6)
    ones = metrics_of(policy, observations, torch.ones(20, 4, 4))
    zeros = metrics_of(policy, observations, torch.zeros(20, 4, 4))
    assert ones["fid_minus"] == ones["gef"] == ones["median_kl"] == 0.0
    assert ones["fid_plus"] == zeros["fid_minus"] > 0.0
    assert zeros["fid_plus"] == 0.0
    assert (ones["mask_mass"], zeros["mask_mass"]) == (1.0, 0.0)


def test_the_complement_swaps_plus_and_minus() -> None:
    policy = small_policy(6, 3)
    observations = random_observations(20, 4, 6)
    masks = torch.round(random_masks(20, 4) * 256) / 256  # so that 1 - (1 - m) is m to the bit
    one, other = metrics_of(policy, observations, masks), metrics_of(policy, observations, 1 - masks)
    assert one["fid_plus"] == other["fid_minus"]
    assert one["fid_minus"] == other["fid_plus"]
    assert one["fid_delta"] == -other["fid_delta"]


def test_the_own_edge_is_explained_like_any_other() -> None:
    policy = small_policy(6, 4)
    observations = random_observations(20, 3, 6)
    without_own = metrics_of(policy, observations, (1 - torch.eye(3)).repeat(20, 1, 1))
    assert without_own["fid_minus"] > 1e-3
    assert without_own["fid_plus"] == pytest.approx(without_own["communication_dependence"], abs=1e-12)


def test_what_is_not_a_number_is_none_never_zero() -> None:
    policy = small_policy(6, 5)
    observations = random_observations(4, 3, 6)
    observations[2] = torch.inf
    metrics = explanation_metrics(policy, observations, random_masks(4, 3))
    for name in ("fid_plus", "fid_minus", "fid_delta", "gef", "median_kl", "communication_dependence"):
        assert metrics[name] is None, name
    assert metrics["mask_mass"] is not None


@given(st.integers(1, 500), st.integers(1, 600))
def test_spaced_timesteps_are_distinct_in_range_and_centred(length: int, timesteps: int) -> None:
    chosen = spaced_timesteps(length, timesteps)
    assert len(chosen) == min(length, timesteps) == len(set(chosen.tolist()))
    assert 0 <= chosen.min() <= chosen.max() < length
    gaps = np.diff(chosen)
    assert gaps.size == 0 or gaps.max() - gaps.min() <= 1


def test_spaced_timesteps_by_hand() -> None:
    assert spaced_timesteps(10, None).tolist() == list(range(10))
    assert spaced_timesteps(10, 1).tolist() == [5]
    assert spaced_timesteps(10, 5).tolist() == [1, 3, 5, 7, 9]
    assert spaced_timesteps(3, 5).tolist() == [0, 1, 2]


def episode(seed: int = 7) -> Episode:
    observations = random_observations(30, 3, 6, seed).numpy()
    return Episode(seed, observations, -1.5, 1 / 3, 0.0, 1.0, 30)


def row_of(explainer: Explainer, *, seed: int = 0, episode_seed: int = 7) -> EpisodeRow:
    unit = Unit(small_policy(6), explainer, episode(episode_seed), seed, timesteps=None, walls=False)
    return measure(unit).row


def test_a_row_depends_on_the_seed_of_run_and_episode_alone() -> None:
    control = CONTROLS["random"]
    assert row_of(control) == row_of(control)
    assert row_of(control, seed=1).mask_mass != row_of(control).mask_mass
    assert row_of(control, episode_seed=8).mask_mass != row_of(control).mask_mass


def test_a_row_does_not_depend_on_threads_or_alignment() -> None:
    shifted = np.empty(30 * 3 * 6 + 1, dtype=np.float32)[1:].reshape(30, 3, 6)
    shifted[:] = episode().observations
    moved = Episode(7, shifted, -1.5, 1 / 3, 0.0, 1.0, 30)
    unit = Unit(small_policy(6), CONTROLS["random"], moved, 0, timesteps=None, walls=False)
    threads = torch.get_num_threads()
    torch.set_num_threads(2)
    try:
        assert measure(unit).row == row_of(CONTROLS["random"])
        assert torch.get_num_threads() == 2
    finally:
        torch.set_num_threads(threads)


def test_explainers_run_on_one_thread() -> None:
    def explain(policy: GraphPolicy, observations: torch.Tensor, generator: torch.Generator) -> torch.Tensor:
        return torch.full((30, 3, 3), 1.0 / torch.get_num_threads())

    threads = torch.get_num_threads()
    torch.set_num_threads(2)
    try:
        assert row_of(Explainer("threads", explain)).mask_mass == 1.0
    finally:
        torch.set_num_threads(threads)


def test_task_metrics_pass_into_the_row() -> None:
    row = row_of(CONTROLS["all-ones"])
    assert (row.reward, row.success_rate, row.no_agent_collision, row.makespan) == (-1.5, 1 / 3, 0.0, 30.0)
    assert row.no_object_collision is None  # no walls: not a 1, nobody could have touched one
    assert (row.length, row.timesteps) == (30, 30)
