"""The batched GNNExplainer equals PyG's own, one graph at a time, on trained policies too."""

from __future__ import annotations

import pytest
import torch
from torch_geometric.explain import GNNExplainer
from xmarl_baselines.explainers.gnn_explainer import (
    SETTINGS,
    GNNExplainerSettings,
    gnn_explainer,
    optimise_mask,
    random_logits,
)
from xmarl_baselines.explainers.gnn_explainer_tuned import gnn_explainer_tuned

from tests.baselines.reference import TRAINED, by_pyg, trained
from tests.helpers.policies import random_observations, small_policy
from xmarl_bench.explain.explainer import run_explainer
from xmarl_bench.policy import GraphPolicy
from xmarl_bench.reproducible import timestep_seeds


def pyg_masks(policy: GraphPolicy, observations: torch.Tensor, seed: int) -> torch.Tensor:
    seeds = timestep_seeds(len(observations), torch.Generator().manual_seed(seed))
    return torch.stack(
        [by_pyg(policy, GNNExplainer(), x, each) for x, each in zip(observations, seeds, strict=True)]
    )


@pytest.mark.slow
@pytest.mark.parametrize("name", TRAINED)
def test_batched_equals_pyg_one_graph_at_a_time_on_trained_policies(name: str) -> None:
    policy, observations = trained(name, 3)
    ours = run_explainer(gnn_explainer, policy, observations, 7)
    theirs = pyg_masks(policy, observations, 7)
    # A hundred steps of Adam amplify float32's rounding, but it stays far below the 0.1 of the next line.
    torch.testing.assert_close(ours, theirs, rtol=0, atol=1e-3)
    first = random_logits(3, timestep_seeds(3, torch.Generator().manual_seed(7))).sigmoid()
    assert (ours - first).abs().max() > 0.1  # the optimisation changed the mask


@pytest.mark.slow
@pytest.mark.parametrize("residual", [False, True])
def test_batched_equals_pyg_one_graph_at_a_time(residual: bool) -> None:
    policy, observations = small_policy(6, 5, residual=residual), random_observations(4, 3, 6)
    ours = run_explainer(gnn_explainer, policy, observations, 7)
    torch.testing.assert_close(ours, pyg_masks(policy, observations, 7), rtol=0, atol=1e-3)


@pytest.mark.slow
def test_batched_equals_pyg_for_larger_teams() -> None:
    policy, observations = trained(TRAINED[2], 2, n_agents=8)
    ours = run_explainer(gnn_explainer, policy, observations, 3)
    torch.testing.assert_close(ours, pyg_masks(policy, observations, 3), rtol=0, atol=1e-3)


@pytest.mark.slow
def test_edges_without_gradient_end_as_zero_and_stay_uncounted_as_in_pyg() -> None:
    policy = small_policy(6, 1)
    with torch.no_grad():
        policy.gat.lin_l.bias.zero_()
        list(policy.encoder.parameters())[1].zero_()
    observations = random_observations(3, 3, 6)
    observations[1, 2] = 0.0  # agent 2 is silent there: its message is 0
    ours = run_explainer(gnn_explainer, policy, observations, 1)
    torch.testing.assert_close(ours, pyg_masks(policy, observations, 1), rtol=0, atol=1e-5)
    assert bool((ours[1, :, 2] == 0).all())
    assert int((ours == 0).sum()) == 3


@pytest.mark.slow
def test_a_policy_that_ignores_its_team_is_explained_by_nothing_as_in_pyg() -> None:
    policy = small_policy(6, 1)
    with torch.no_grad():
        next(policy.decoder.parameters()).zero_()
    observations = random_observations(2, 3, 6)
    ours = run_explainer(gnn_explainer, policy, observations, 1)
    assert bool((ours == 0).all())
    assert torch.equal(ours, pyg_masks(policy, observations, 1))


def test_the_defaults_are_pygs() -> None:
    algorithm = GNNExplainer()
    assert (algorithm.epochs, algorithm.lr) == (SETTINGS.epochs, SETTINGS.lr)
    for name in ("edge_size", "edge_ent"):
        assert algorithm.coeffs[name] == getattr(SETTINGS, name)
    assert algorithm.coeffs["edge_reduction"] == "sum"
    assert algorithm.coeffs["EPS"] == 1e-15


@pytest.mark.slow
def test_the_default_result_is_mostly_its_random_start() -> None:
    policy, observations = trained(TRAINED[2], 40)
    one, two = (run_explainer(gnn_explainer, policy, observations, seed) for seed in (1, 2))
    start = random_logits(3, timestep_seeds(40, torch.Generator().manual_seed(1)))
    assert correlation(one, start) > 0.6
    assert abs(correlation(one, two)) < 0.3


@pytest.mark.slow
def test_a_timestep_s_mask_does_not_depend_on_other_timesteps() -> None:
    policy, observations = small_policy(6, 3), random_observations(5, 3, 6)
    start = random_logits(3, [1, 2, 3, 4, 5])
    settings = GNNExplainerSettings(epochs=30)
    mask = optimise_mask(policy, observations, start, settings)
    for s in range(5):
        alone = optimise_mask(policy, observations[s : s + 1], start[s : s + 1], settings)
        torch.testing.assert_close(mask[s : s + 1], alone, rtol=0, atol=1e-5)
    reversed_ = optimise_mask(policy, observations.flip(0), start.flip(0), settings).flip(0)
    torch.testing.assert_close(mask, reversed_, rtol=0, atol=1e-5)


def correlation(a: torch.Tensor, b: torch.Tensor) -> float:
    return float(torch.corrcoef(torch.stack([a.flatten(), b.flatten()]))[0, 1])


@pytest.mark.slow
def test_tuned_starts_from_zero_draws_nothing_and_changes_the_action_less() -> None:
    for name in TRAINED:
        policy, observations = trained(name, 40)
        tuned = run_explainer(gnn_explainer_tuned, policy, observations, 1)
        assert torch.equal(tuned, run_explainer(gnn_explainer_tuned, policy, observations, 2))
        default = run_explainer(gnn_explainer, policy, observations, 1)
        with torch.no_grad():
            full, small, large = (
                policy.distribution(observations, mask).action for mask in (None, tuned, default)
            )
        assert (full - small).square().mean() < (full - large).square().mean()
        assert tuned.mean() < 0.99  # not by keeping everything


@pytest.mark.slow
def test_a_tuned_mask_is_equal_for_identical_senders() -> None:
    """Identical senders get the same mask; from a random start they do not."""
    policy, observations = small_policy(6, 3), random_observations(5, 4, 6)
    observations[:, 2] = observations[:, 1]
    tuned = run_explainer(gnn_explainer_tuned, policy, observations, 1)
    torch.testing.assert_close(tuned[:, :, 1], tuned[:, :, 2], rtol=0, atol=1e-4)
    default = run_explainer(gnn_explainer, policy, observations, 1)
    assert (default[:, :, 1] - default[:, :, 2]).abs().mean() > 0.05
