"""Measurements of an episode depend only on their arguments."""

from __future__ import annotations

import numpy as np
import torch
from hypothesis import given
from hypothesis import strategies as st

from tests.helpers.example_plugins import BAD
from tests.helpers.policies import random_observations, small_policy
from xmarl_bench.entry.metric_records import ExplanationRow
from xmarl_bench.errors import InputError
from xmarl_bench.explain.controls import CONTROLS
from xmarl_bench.explain.explainer import Explainer
from xmarl_bench.metrics import budgeted_fidelity
from xmarl_bench.policy import Policy
from xmarl_bench.rollout.cell import spaced_timesteps
from xmarl_bench.rollout.episodes import Episode
from xmarl_bench.scoring.measure import Explained, Measured, Unit


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


def measured(*explainers: Explainer, seed: int = 0, episode_seed: int = 7, sanity: bool = False) -> Measured:
    return Unit(small_policy(6), explainers, episode(episode_seed), seed, None, sanity).run()


def controls_of(result: Measured) -> dict[str, ExplanationRow]:
    assert result.shared is not None
    return result.shared.controls


def values_of(explainer: Explainer, seed: int = 0, episode_seed: int = 7) -> ExplanationRow:
    unit = Unit(small_policy(6), (explainer,), episode(episode_seed), seed, None, sanity=False, shared=False)
    explained = unit.run().explained[explainer.name]
    assert isinstance(explained, Explained)
    return explained.row


def test_values_depend_only_on_the_seeds_of_run_and_episode() -> None:
    control = CONTROLS["random"]
    assert values_of(control) == values_of(control)
    assert values_of(control, seed=1).mask_mass != values_of(control).mask_mass
    assert values_of(control, episode_seed=8).mask_mass != values_of(control).mask_mass


def test_values_do_not_depend_on_other_explainers() -> None:
    names = ("random", "self", "oracle", "bernoulli")
    together = measured(*(CONTROLS[name] for name in names)).explained
    for name in names:
        alone, beside = values_of(CONTROLS[name]), together[name]
        assert isinstance(beside, Explained)
        assert beside.row == alone


def test_values_do_not_depend_on_threads_or_alignment() -> None:
    shifted = np.empty(30 * 3 * 6 + 1, dtype=np.float32)[1:].reshape(30, 3, 6)
    shifted[:] = episode().observations
    moved = Episode(7, shifted, -1.5, 1 / 3, 0.0, 1.0, 30)
    unit = Unit(small_policy(6), (CONTROLS["random"],), moved, 0, None, False)
    threads = torch.get_num_threads()
    torch.set_num_threads(2)
    try:
        received = unit.run().explained["random"]
        assert isinstance(received, Explained)
        assert received.row == values_of(CONTROLS["random"])
        assert torch.get_num_threads() == 2
    finally:
        torch.set_num_threads(threads)


def test_explainers_run_on_one_thread() -> None:
    def explain(policy: Policy, observations: torch.Tensor, generator: torch.Generator) -> torch.Tensor:
        return torch.full((30, 3, 3), 1.0 / torch.get_num_threads())

    threads = torch.get_num_threads()
    torch.set_num_threads(2)
    try:
        assert values_of(Explainer("threads", explain)).mask_mass == 1.0
    finally:
        torch.set_num_threads(threads)


def test_a_control_has_the_same_score_as_a_requested_explainer() -> None:
    result = measured(*CONTROLS.values())
    assert list(controls_of(result)) == list(CONTROLS)
    for name, carried in controls_of(result).items():
        asked = result.explained[name]
        assert isinstance(asked, Explained)
        assert asked.row == carried, name


def test_shared_measures_are_computed_on_request() -> None:
    unit = Unit(small_policy(6), (CONTROLS["random"],), episode(), 0, None, sanity=False, shared=False)
    without, beside = unit.run(), measured(CONTROLS["random"])
    assert without.shared is None
    alone, together = without.explained["random"], beside.explained["random"]
    assert isinstance(alone, Explained)
    assert isinstance(together, Explained)
    assert alone.row == together.row


def test_the_inverse_of_a_mask_is_its_complement() -> None:
    result = measured(CONTROLS["all-ones"]).explained["all-ones"]
    assert isinstance(result, Explained)
    assert result.inverted == controls_of(measured())["zeros"]
    assert result.inverted.fid_delta == -(result.row.fid_delta or 0.0)


def test_budgeted_fidelity_follows_from_the_budgets() -> None:
    each = measured(CONTROLS["random"]).explained["random"]
    assert isinstance(each, Explained)
    assert list(each.budgets) == ["budget", "comm_budget"]  # no reference states were given
    for budget, prefix, n_senders in zip(each.budgets.values(), ("", "comm_"), (3, 2), strict=True):
        curves = [np.array(curve, dtype=float) for _, curve in budget if curve is not None]
        assert [curve.shape for curve in curves] == [(n_senders - 1,)] * 3
        assert budgeted_fidelity(*curves) == getattr(each.row, f"{prefix}budgeted_fidelity")
        assert curves[0].mean() == getattr(each.row, f"{prefix}topk_fid_delta")
        assert (curves[2] >= curves[0]).all()


def test_without_an_oracle_a_budget_has_only_the_explained_curve() -> None:
    observations = random_observations(2, 33, 6).numpy()
    crowd = Episode(7, observations, 0.0, 0.0, 0.0, 0.0, 2)
    each = Unit(small_policy(6), (CONTROLS["random"],), crowd, 0, None, False).run().explained["random"]
    assert isinstance(each, Explained)
    for budget, n_senders in zip(each.budgets.values(), (33, 32), strict=True):
        assert budget.random is budget.oracle is budget.random_error is None
        assert len(budget.explained) == n_senders - 1


def test_the_error_of_one_explainer_does_not_stop_the_others() -> None:
    result = measured(BAD["nan"], CONTROLS["random"]).explained
    assert isinstance(result["nan"], InputError)
    assert "'nan'" in str(result["nan"])
    assert isinstance(result["random"], Explained)


def test_a_team_too_large_for_the_oracle_has_no_oracle() -> None:
    observations = random_observations(2, 33, 6).numpy()
    unit = Unit(small_policy(6), (), Episode(7, observations, 0.0, 0.0, 0.0, 0.0, 2), 0, None, False)
    controls = controls_of(unit.run())
    assert set(CONTROLS) - set(controls) == {"oracle", "soft-oracle"}
    assert controls["random"].comm_budgeted_fidelity is None
    assert controls["random"].comm_topk_fid_delta is not None


def test_sanity_is_measured_on_request() -> None:
    random = measured(CONTROLS["random"], sanity=True).explained["random"]
    assert isinstance(random, Explained)
    assert random.sanity is not None
    stability, randomised = random.sanity.seed_stability, random.sanity.weight_randomisation
    assert stability is not None
    assert randomised is not None
    assert abs(stability) < 0.3
    assert abs(randomised) < 0.5
    ones = measured(CONTROLS["all-ones"], sanity=True).explained["all-ones"]
    assert isinstance(ones, Explained)
    assert ones.sanity is not None
    assert ones.sanity.weight_randomisation is None  # it ranks nothing
    assert ones.sanity.seed_stability is None  # it is not stochastic
