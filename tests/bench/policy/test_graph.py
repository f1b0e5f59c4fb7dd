"""Incomplete graphs: absent edges carry no message, and no metric ranks, keeps or counts them."""

from __future__ import annotations

from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor
from torch_geometric.explain.algorithm.utils import clear_masks, set_masks

from tests.bench.policy.test_layers import CARD, random_policy, record
from tests.helpers.policies import random_masks, random_observations
from xmarl_bench import Explainer, score
from xmarl_bench.errors import InputError
from xmarl_bench.explain.explainer import run_explainer
from xmarl_bench.explain.oracle import change_table, oracle_mask
from xmarl_bench.explain.pyg import PygExplain
from xmarl_bench.metrics import (
    attention_distance,
    fid_delta_table,
    mask_mass,
    oracle_at_k,
    other_senders,
    random_at_k,
    rank_correlation,
    rows_within,
)
from xmarl_bench.policy import (
    CompleteGraph,
    FixedGraph,
    RadiusGraph,
    complete_graph,
    save_policy,
)
from xmarl_bench.policy.build import LayeredPolicy
from xmarl_bench.policy.graph import edge_index_of
from xmarl_bench.scoring.behaviour import top_messages
from xmarl_bench.scoring.states import States

RADIUS = RadiusGraph(radius=1.2)
LAYERS = [{"conv": "GATv2Conv", "width": 4, "heads": 2, "activation": "tanh"}]
N = 4


def policy_on(graph: Any, layers: list[dict[str, Any]] = LAYERS) -> LayeredPolicy:
    made: LayeredPolicy = random_policy(record(layers, graph=graph.model_dump()))
    return made


def states_of(policy: LayeredPolicy, seed: int = 0) -> States:
    return States.of(policy, random_observations(6, N, 6, seed), np.random.default_rng(seed))


def test_edges_of_a_radius_by_hand() -> None:
    x = torch.zeros(1, 3, 6)
    x[0, :, 0] = torch.tensor([0.0, 1.0, 2.5])
    there = RadiusGraph(radius=1.0).adjacency(x)[0]
    assert there.tolist() == [[True, True, False], [True, True, False], [False, False, True]]
    shifted = RadiusGraph(radius=1.0, position=(1, 0)).adjacency(x)[0]
    assert torch.equal(shifted, there)
    with pytest.raises(InputError, match="entry 6 of an observation of 6"):
        RadiusGraph(radius=1.0, position=(0, 6)).check(3, 6)


def test_edges_of_a_given_adjacency_by_hand() -> None:
    ring = FixedGraph(n_agents=3, edges=((0, 1), (1, 2), (2, 0)))
    assert (
        ring.adjacency(torch.zeros(2, 3, 6)).tolist()
        == [[[True, False, True], [True, True, False], [False, True, True]]] * 2
    )
    with pytest.raises(InputError, match="for 3 agents, not for 4"):
        ring.check(4, 6)
    with pytest.raises(InputError, match="edge of agent 5 in a team of 2"):
        FixedGraph(n_agents=2, edges=((0, 5),)).check(2, 6)


def test_edges_have_the_order_of_the_mask() -> None:
    assert torch.equal(edge_index_of(torch.ones(1, 3, 3, dtype=torch.bool)), complete_graph(3))


@pytest.mark.parametrize("layers", [LAYERS, LAYERS * 2], ids=["one layer", "two layers"])
def test_masked_forward_equals_pyg_on_the_policy_s_edges(layers: list[dict[str, Any]]) -> None:
    policy = policy_on(RADIUS, layers)
    observations, masks = random_observations(5, N, 6), random_masks(5, N)
    there = RADIUS.adjacency(observations)
    assert 0.3 < there.float().mean() < 0.9
    with torch.no_grad():
        ours = policy.distribution(observations, masks).action
        for s in range(5):
            edge_index = edge_index_of(there[s : s + 1])
            set_masks(policy.network, masks[s][there[s]], edge_index, apply_sigmoid=False)
            theirs = policy(observations[s], edge_index)
            clear_masks(policy.network)
            torch.testing.assert_close(ours[s], theirs, rtol=0, atol=1e-5)


def test_mask_values_of_absent_edges_are_ignored() -> None:
    policy, observations = policy_on(RADIUS), random_observations(5, N, 6)
    there = RADIUS.adjacency(observations)
    masks = random_masks(5, N)
    other = torch.where(there, masks, 1.0 - masks)
    with torch.no_grad():
        assert torch.equal(
            policy.distribution(observations, masks).loc, policy.distribution(observations, other).loc
        )
    states = states_of(policy)
    there = RADIUS.adjacency(states.observations)
    masks = random_masks(6, N)
    assert states.mask_metrics(masks) == states.mask_metrics(torch.where(there, masks, 1.0 - masks))
    alpha = policy.attention(observations)
    assert not alpha[~RADIUS.adjacency(observations)].any()
    torch.testing.assert_close(alpha.sum(dim=-1), torch.ones(5, N))


def test_a_given_complete_adjacency_scores_as_the_complete_graph() -> None:
    everyone = tuple((j, i) for i in range(N) for j in range(N))
    given = states_of(policy_on(FixedGraph(n_agents=N, edges=everyone)))
    complete = states_of(policy_on(CompleteGraph()))
    for mask in (random_masks(6, N), torch.eye(N).repeat(6, 1, 1)):
        ours, theirs = dict(given.mask_metrics(mask)), dict(complete.mask_metrics(mask))
        assert all((ours[name] is None) == (theirs[name] is None) for name in theirs)
        numbers = [name for name, value in theirs.items() if value is not None]
        assert "comm_budgeted_fidelity" in numbers
        for name in numbers:
            assert ours[name] == pytest.approx(theirs[name], rel=1e-9, abs=1e-9), name


def test_random_and_oracle_at_k_equal_brute_force_over_subsets() -> None:
    policy, observations = policy_on(RADIUS), random_observations(6, N, 6)
    there = RADIUS.adjacency(observations).numpy()
    delta = fid_delta_table(change_table(policy, observations))
    random, oracle = random_at_k(delta, there), oracle_at_k(delta, there)
    for k in range(1, N):
        means, bests = [], []
        for s, i in np.ndindex(6, N):
            senders = np.flatnonzero(there[s, i])
            rows = [sum(1 << int(j) for j in c) for c in combinations(senders, min(k, len(senders)))]
            means.append(delta[:, s, i][rows].mean())
            bests.append(delta[:, s, i][rows].max())
        assert random[k - 1] == pytest.approx(np.mean(means), abs=1e-12)
        assert oracle[k - 1] == pytest.approx(np.mean(bests), abs=1e-12)


def test_absent_senders_are_ranked_last_for_every_mask() -> None:
    there = np.array([[[True, False, True], [True, True, True], [False, True, True]]])
    mask = np.array([[[0.1, 1.0, 0.2], [0.3, 0.2, 0.1], [1.0, 0.0, 0.0]]])
    noise = np.array([[[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.9, 0.1]]])
    top = top_messages(mask, noise, 1, there)[0]
    assert top.tolist() == [[0, 0, 1], [1, 0, 0], [0, 1, 0]]
    assert other_senders(there)[0].tolist() == [[False, True], [True, True], [False, True]]
    assert rows_within(8, there)[:, 0, 0].nonzero()[0].tolist() == [0b000, 0b001, 0b100, 0b101]


def test_only_existing_edges_are_counted() -> None:
    there = np.array([[[True, False], [True, True]]])
    assert mask_mass(np.array([[[0.5, 1.0], [0.25, 0.75]]]), there).tolist() == [0.5]
    assert attention_distance(np.array([[[1.0, 0.0], [0.75, 0.25]]]), there).tolist() == [2.0]
    one, other = np.array([[1.0, 9.0, 2.0, 3.0]]), np.array([[3.0, 0.0, 2.0, 1.0]])
    assert rank_correlation(one, other, np.array([[True, False, True, True]])) == pytest.approx(-1.0)


def test_the_oracle_keeps_existing_edges_and_no_mask_beats_it() -> None:
    policy = policy_on(RADIUS)
    states = states_of(policy)
    assert states.oracle_mask is not None
    there = RADIUS.adjacency(states.observations)
    assert not states.oracle_mask[~there].any()
    again = oracle_mask(policy, states.observations, torch.Generator())
    assert torch.equal(again, states.oracle_mask)
    best = states.mask_metrics(states.oracle_mask).fid_delta
    assert best is not None
    for seed in range(20):
        other = states.mask_metrics((random_masks(6, N, seed) > 0.5).float()).fid_delta
        assert other is not None
        assert other <= best + 1e-9


def test_the_harness_sets_masks_of_absent_edges_to_zero() -> None:
    def everything(policy: object, observations: Tensor, generator: torch.Generator) -> Tensor:
        return torch.ones(len(observations), N, N)

    policy, observations = policy_on(RADIUS), random_observations(3, N, 6)
    mask = run_explainer(Explainer("all", everything), policy, observations, 0)
    assert torch.equal(mask, RADIUS.adjacency(observations).float())


def test_pyg_s_explainers_get_the_policy_s_edges() -> None:
    from torch_geometric.explain import DummyExplainer

    policy, observations = policy_on(RADIUS), random_observations(3, N, 6)
    mask = PygExplain(DummyExplainer)(policy, observations, torch.Generator().manual_seed(0))
    there = RADIUS.adjacency(observations)
    assert bool((mask[there] > 0).all())
    assert not mask[~there].any()


@pytest.mark.slow
@pytest.mark.parametrize("layers", [LAYERS, LAYERS * 2], ids=["one layer", "two layers"])
def test_policies_on_a_graph_are_scored(layers: list[dict[str, Any]], tmp_path: Path) -> None:
    graph = RadiusGraph(radius=0.9)
    save_policy(tmp_path / "r", policy_on(graph, layers), name="r", **CARD)
    entry = score(tmp_path / "r", "random", episodes=2, timesteps=5, max_cycles=8, behaviour_episodes=1)
    cell = entry.results[0]
    assert entry.policy.architecture.graph == graph
    oracle = None if len(layers) > 1 else cell.controls["oracle"].fid_delta.value
    if oracle is not None:
        assert cell.metrics.fid_delta.value is not None
        assert oracle >= cell.metrics.fid_delta.value
    ones = cell.controls["all-ones"]
    assert (ones.fid_minus.value, ones.mask_mass.value) == (0.0, 1.0)


def test_a_team_of_another_size_than_the_graph_is_refused(tmp_path: Path) -> None:
    save_policy(tmp_path / "f", policy_on(FixedGraph(n_agents=4, edges=((0, 1),))), name="f", **CARD)
    with pytest.raises(InputError, match="for 4 agents, not for 3"):
        score(tmp_path / "f", "random", episodes=1)
