"""The metrics of masks, against a dense reference and at their limits."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from torch import Tensor, nn
from torch_geometric.nn import GATv2Conv

from tests.helpers.dense_reference import reference_distribution
from tests.helpers.policies import random_masks, random_observations, small_policy
from xmarl_bench.explain import oracle
from xmarl_bench.metrics.table import UNDER_ABSENCES
from xmarl_bench.policy import ModulePolicy, Policy
from xmarl_bench.scoring.enumerated import Enumerated
from xmarl_bench.scoring.states import States


def states_of(policy: Policy, observations: Tensor) -> States:
    reference = random_observations(30, observations.shape[1], observations.shape[2], seed=9)
    return States.of(policy, observations, np.random.default_rng(0), reference)


def metrics_of(policy: Policy, observations: Tensor, mask: Tensor) -> dict[str, float]:
    metrics = states_of(policy, observations).mask_metrics(mask)
    values = {name: value for name, value in metrics if value is not None}
    assert len(values) == len(type(metrics).model_fields)
    return values


@pytest.mark.parametrize("communication", [False, True])
def test_metrics_equal_an_independent_dense_reference(communication: bool) -> None:
    policy = small_policy(6, 1)
    observations, masks = random_observations(7, 3, 6), random_masks(7, 3)
    own = np.eye(3) if communication else np.zeros((3, 3))  # kept in subgraph and complement
    expected: dict[str, list[float]] = {"fid_plus": [], "fid_minus": [], "gef": []}
    kls, dependence = [], []
    for observation, mask in zip(observations.double().numpy(), masks.double().numpy(), strict=True):
        loc, scale = reference_distribution(policy, observation, np.ones((3, 3)))
        kept_loc, kept_scale = reference_distribution(policy, observation, np.maximum(mask, own))
        dropped, _ = reference_distribution(policy, observation, np.maximum(1 - mask, own))
        alone, _ = reference_distribution(policy, observation, np.eye(3))
        kl = (
            np.log(kept_scale / scale) + (scale**2 + (loc - kept_loc) ** 2) / (2 * kept_scale**2) - 0.5
        ).sum(1)
        kls.append(kl)
        expected["fid_plus"].append(np.abs(np.tanh(loc) - np.tanh(dropped)).mean())
        expected["fid_minus"].append(np.abs(np.tanh(loc) - np.tanh(kept_loc)).mean())
        expected["gef"].append((1 - np.exp(-kl)).mean())
        dependence.append(np.abs(np.tanh(loc) - np.tanh(alone)).mean())
    metrics, prefix = metrics_of(policy, observations, masks), "comm_" if communication else ""
    for name, values in expected.items():
        assert metrics[prefix + name] == pytest.approx(np.mean(values), abs=1e-6), name
    assert metrics[prefix + "fid_delta"] == pytest.approx(
        metrics[prefix + "fid_plus"] - metrics[prefix + "fid_minus"], abs=1e-12
    )
    if not communication:
        assert metrics["median_kl"] == pytest.approx(np.median(kls), rel=1e-5)
        assert metrics["mask_mass"] == pytest.approx(float(masks.double().mean()), abs=1e-9)
        received = states_of(policy, observations).policy_metrics().communication_dependence
        assert received == pytest.approx(np.mean(dependence), abs=1e-6)
        assert np.mean(dependence) > 1e-3


def test_ones_are_perfectly_faithful_and_zeros_their_complement() -> None:
    policy = small_policy(6, 2)
    observations = random_observations(20, 4, 6)
    ones = metrics_of(policy, observations, torch.ones(20, 4, 4))
    zeros = metrics_of(policy, observations, torch.zeros(20, 4, 4))
    assert ones["fid_minus"] == ones["gef"] == ones["median_kl"] == ones["comm_gef"] == 0.0
    assert ones["fid_plus"] == zeros["fid_minus"] > 0.0
    assert zeros["fid_plus"] == zeros["comm_fid_plus"] == 0.0
    assert (ones["mask_mass"], zeros["mask_mass"]) == (1.0, 0.0)
    own = metrics_of(policy, observations, torch.eye(4).repeat(20, 1, 1))
    for name in (*UNDER_ABSENCES, "message_fidelity", "smallest_message_fidelity"):
        assert ones[name] == zeros[name] == own[name] == 0.0, name  # none of them ranks messages
    assert ones["budgeted_fidelity"] == zeros["budgeted_fidelity"] == 0.0


def test_the_complement_swaps_plus_and_minus() -> None:
    policy = small_policy(6, 3)
    observations = random_observations(20, 4, 6)
    masks = torch.round(random_masks(20, 4) * 256) / 256  # so that 1 - (1 - m) equals m exactly
    one, other = metrics_of(policy, observations, masks), metrics_of(policy, observations, 1 - masks)
    for prefix in ("", "comm_"):
        assert one[prefix + "fid_plus"] == other[prefix + "fid_minus"]
        assert one[prefix + "fid_minus"] == other[prefix + "fid_plus"]
        assert one[prefix + "fid_delta"] == -other[prefix + "fid_delta"]


def test_the_own_edge_is_explained_like_any_other_but_not_among_messages() -> None:
    policy = small_policy(6, 4)
    observations = random_observations(20, 3, 6)
    states = states_of(policy, observations)
    without_own = states.mask_metrics((1 - torch.eye(3)).repeat(20, 1, 1))
    dependence = states.policy_metrics().communication_dependence
    assert (without_own.fid_minus or 0.0) > 1e-3
    assert without_own.fid_plus == pytest.approx(dependence, abs=1e-12)
    assert without_own.comm_fid_minus == 0.0
    assert without_own.comm_fid_plus == pytest.approx(dependence, abs=1e-12)
    masks = random_masks(20, 3)
    one, other = states.mask_metrics(masks), states.mask_metrics(torch.maximum(masks, torch.eye(3)))
    for name, value in one:
        if name.startswith("comm_"):
            assert value == getattr(other, name), name


def test_binary_masks_get_the_same_fid_delta_from_table_and_forward() -> None:
    """The best binary mask has the same FidDelta in the table and when run like any other mask."""
    policy, observations = small_policy(6, 5), random_observations(30, 4, 6)
    states = states_of(policy, observations)
    assert states.oracle_mask is not None
    assert isinstance(states.oracle, Enumerated)
    received = states.mask_metrics(states.oracle_mask).fid_delta
    assert received == pytest.approx(states.oracle.all_edges.delta.max(axis=0).mean(), abs=1e-6)


def test_squeezing_a_ranking_raises_fid_delta_but_not_budgeted_fidelity() -> None:
    policy, observations = small_policy(6, 6), random_observations(200, 4, 6)
    states = states_of(policy, observations)
    ranking = torch.round(random_masks(200, 4) * 256) / 256
    plain, squeezed = states.mask_metrics(ranking), states.mask_metrics(0.9 + ranking / 10)
    assert (squeezed.fid_delta or 0.0) > 10 * abs(plain.fid_delta or 0.0)
    for name in ("budgeted_fidelity", *UNDER_ABSENCES, "topk_fid_delta"):
        assert getattr(plain, name) == getattr(squeezed, name), name


def test_nan_becomes_none_and_never_zero() -> None:
    policy = small_policy(6, 5)
    observations = random_observations(4, 3, 6)
    observations[2] = torch.inf
    states = states_of(policy, observations)
    metrics = states.mask_metrics(random_masks(4, 3))
    assert {name for name, value in metrics if value is not None} == {"mask_mass"}
    assert states.policy_metrics().communication_dependence is None


@pytest.mark.parametrize(("n_agents", "ranked"), [(1, ()), (2, ("",)), (3, ("", "comm_"))])
def test_small_teams_have_little_to_rank(n_agents: int, ranked: tuple[str, ...]) -> None:
    policy = small_policy(6, 1)
    metrics = states_of(policy, random_observations(5, n_agents, 6)).mask_metrics(random_masks(5, n_agents))
    for prefix in ("", "comm_"):
        assert (getattr(metrics, f"{prefix}topk_fid_delta") is not None) == (prefix in ranked)
        assert (getattr(metrics, f"{prefix}budgeted_fidelity") is not None) == (prefix in ranked)


def test_without_an_oracle_fid_delta_at_k_stands_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    policy, observations, masks = small_policy(6, 2), random_observations(9, 4, 6), random_masks(9, 4)
    table = states_of(policy, observations).mask_metrics(masks)
    monkeypatch.setattr(oracle, "MAX_AGENTS", 3)
    monkeypatch.setattr(oracle, "MAX_SAMPLED", 3)
    states = states_of(policy, observations)
    forward = states.mask_metrics(masks)
    for prefix in ("", "comm_"):
        assert getattr(forward, f"{prefix}topk_fid_delta") == pytest.approx(
            getattr(table, f"{prefix}topk_fid_delta"), abs=1e-6
        )
        assert getattr(forward, f"{prefix}budgeted_fidelity") is None
    assert forward.fid_delta == table.fid_delta
    assert states.oracle_mask is None


@pytest.mark.slow
def test_a_sampled_oracle_scores_as_the_enumerated_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """All normalised metrics of one mask, with random@k estimated and oracle@k searched for."""
    policy, observations = small_policy(6, 2), random_observations(40, 5, 6)
    with torch.no_grad():
        mask = policy.attention(observations)
    enumerated = states_of(policy, observations).mask_metrics(mask)
    monkeypatch.setattr(oracle, "MAX_AGENTS", 3)
    sampled = states_of(policy, observations).mask_metrics(mask)
    for name in ("budgeted_fidelity", *UNDER_ABSENCES, "message_fidelity"):
        assert getattr(sampled, name) == pytest.approx(getattr(enumerated, name), abs=0.05), name
        assert abs(getattr(enumerated, name)) > 0.1, name


class TwoLayers(nn.Module):
    def __init__(self) -> None:
        super().__init__()
        self.first = GATv2Conv(6, 8, heads=2, concat=False, add_self_loops=False)
        self.second = GATv2Conv(8, 4, add_self_loops=False)

    def forward(self, x: Tensor, edge_index: Tensor) -> Tensor:
        out: Tensor = self.second(torch.tanh(self.first(x, edge_index)), edge_index)
        return out


@pytest.mark.slow
def test_policies_of_several_layers_have_all_but_what_needs_coefficients() -> None:
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        policy = ModulePolicy(TwoLayers(), obs_dim=6)
    states = states_of(policy, random_observations(5, 3, 6))
    metrics = states.mask_metrics(random_masks(5, 3))
    missing = {name for name, value in metrics if value is None}
    assert missing == {name for name in UNDER_ABSENCES if name != "comm_budgeted_fidelity"}
    assert metrics.message_fidelity == metrics.comm_budgeted_fidelity
    assert states.oracle_mask is not None
    entropy = states.policy_metrics().attention_entropy
    assert entropy is not None
    assert 0.0 < entropy <= math.log(3)
