"""Graphs without self loops: messages on them, and scores of policies."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from tests.bench.checks.test_policy_checks import failed
from tests.bench.policy.test_layers import CARD, random_policy, record
from tests.conftest import RunCli
from tests.helpers.policies import random_masks, random_observations
from xmarl_bench import score
from xmarl_bench.entry.file import read_entries
from xmarl_bench.policy import (
    CompleteGraph,
    FixedGraph,
    GraphPolicy,
    LayeredArchitecture,
    RadiusGraph,
    load_policy,
    save_policy,
)
from xmarl_bench.scoring.states import States
from xmarl_bench.submission.consistency import entry_findings

LAYERS = [{"conv": "GATv2Conv", "width": 4, "activation": "tanh", "residual": True}]
GRAPHS = [CompleteGraph(loops=False), RadiusGraph(radius=0.9, loops=False)]


def test_edges_by_hand() -> None:
    x = torch.zeros(1, 3, 6)
    x[0, :, 0] = torch.tensor([0.0, 1.0, 2.5])
    everyone = [[False, True, True], [True, False, True], [True, True, False]]
    assert CompleteGraph(loops=False).adjacency(x)[0].tolist() == everyone
    near = [[False, True, False], [True, False, False], [False, False, False]]
    assert RadiusGraph(radius=1.0, loops=False).adjacency(x)[0].tolist() == near
    given = FixedGraph(n_agents=3, edges=((0, 1), (2, 2)), loops=False)
    assert given.adjacency(x)[0].tolist() == [[False] * 3, [True, False, False], [False, False, True]]


def test_records_of_graphs_with_loops_are_written_as_before() -> None:
    assert CompleteGraph().model_dump_json() == '{"kind":"complete"}'
    assert RadiusGraph(radius=1.0).model_dump_json() == '{"kind":"radius","radius":1.0,"position":[0,1]}'
    assert FixedGraph(n_agents=2, edges=()).model_dump_json() == '{"kind":"fixed","n_agents":2,"edges":[]}'
    without = CompleteGraph(loops=False)
    assert CompleteGraph.model_validate_json(without.model_dump_json()) == without


def test_graphs_without_loops_do_not_take_the_fast_path() -> None:
    assert isinstance(random_policy(record(LAYERS)), GraphPolicy)
    assert record(LAYERS, graph={"kind": "complete", "loops": False}).as_one_layer() is None


def test_an_agent_without_messages_acts_on_its_own_observation() -> None:
    policy: Any = random_policy(record(LAYERS, graph={"kind": "radius", "radius": 1e-6, "loops": False}))
    observations = random_observations(3, 3, 6)
    with torch.no_grad():
        full = policy.distribution(observations).loc
        silent = policy.distribution(observations, torch.zeros(3, 3, 3)).loc
        assert not policy.attention(observations).any()
    assert torch.equal(full, silent)
    assert (full[:, 0] - full[:, 1]).abs().max() > 1e-3


def test_the_own_edge_of_a_mask_is_ignored() -> None:
    policy: Any = random_policy(record(LAYERS, graph={"kind": "complete", "loops": False}))
    observations, masks = random_observations(4, 3, 6), random_masks(4, 3)
    other = masks.clone()
    other.diagonal(dim1=1, dim2=2).fill_(0.0)
    with torch.no_grad():
        loc = policy.distribution(observations, masks).loc
        assert torch.equal(loc, policy.distribution(observations, other).loc)


def test_mask_mass_is_over_timesteps_with_an_edge() -> None:
    policy: Any = random_policy(record(LAYERS, graph={"kind": "radius", "radius": 1.5, "loops": False}))
    observations = random_observations(4, 3, 6)
    observations[1] += 100.0 * torch.arange(3)[:, None]  # agents far from one another
    states = States.of(policy, observations, np.random.default_rng(0))
    there = policy.adjacency(observations)
    assert there.any(dim=(1, 2)).tolist() == [True, False, True, True]
    assert states.mask_metrics(0.25 * torch.ones(4, 3, 3)).mask_mass == 0.25


def test_receivers_without_edges_pass_the_check_of_attention() -> None:
    policy: Any = random_policy(record(LAYERS, graph={"kind": "radius", "radius": 1.0, "loops": False}))
    assert failed(policy, "attention", "blind without messages", "masks reach their edges") == {}


@pytest.mark.slow
@pytest.mark.parametrize("graph", GRAPHS, ids=["complete", "radius"])
def test_policies_without_loops_are_saved_and_scored(graph: Any, tmp_path: Path) -> None:
    save_policy(tmp_path / "p", random_policy(record(LAYERS, graph=graph.model_dump())), name="p", **CARD)
    policy, card = load_policy(tmp_path / "p")
    assert isinstance(card.architecture, LayeredArchitecture)
    assert policy.graph == card.architecture.graph == graph
    entry = score(tmp_path / "p", "attention", episodes=2, timesteps=6, max_cycles=12, behaviour_episodes=1)
    assert list(entry_findings(entry)) == []
    cell = entry.results[0]
    assert cell.metrics.fid_delta.value is not None
    assert cell.controls["all-ones"].fid_minus.value == 0.0
    assert cell.controls["all-ones"].mask_mass.value == 1.0
    # Without own edges, `self` keeps nothing.
    nothing = cell.controls["zeros"].fid_minus.value
    assert cell.controls["self"].fid_minus.value == nothing
    assert cell.metrics.communication_dependence.value == pytest.approx(nothing)


@pytest.mark.slow
def test_without_any_edge_mask_mass_is_null(tmp_path: Path, run_cli: RunCli) -> None:
    """Within 1e-6 m no agent has a neighbour, so mask mass is undefined."""
    far: Any = random_policy(record(LAYERS, graph={"kind": "radius", "radius": 1e-6, "loops": False}))
    save_policy(tmp_path / "far", far, name="far", **CARD)
    options = ("--episodes", 1, "--timesteps", 3, "--max-cycles", 4, "--behaviour-episodes", 0)
    ran = run_cli("score", "--policy", tmp_path / "far", "--explainer", "random", *options, "--out", tmp_path)
    assert ran.code == 0, ran.err
    ((_, entry),) = read_entries(tmp_path / "entries")
    assert entry.results[0].metrics.mask_mass.value is None
    assert entry.results[0].metrics.fid_plus.value == 0.0
    assert list(entry_findings(entry)) == []
