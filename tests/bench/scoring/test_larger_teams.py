"""Larger teams than in training, and networks of several layers: from a request to entry and board."""

from __future__ import annotations

import pytest
from torch_geometric.nn import GATv2Conv

from tests.conftest import MakeBundle
from tests.helpers.deep_policies import Stack
from xmarl_bench import PolicyModule
from xmarl_bench.board import board_of
from xmarl_bench.entry.protocol import SAMPLED
from xmarl_bench.entry.schema import Entry
from xmarl_bench.explain.sampled_oracle import ORDERS
from xmarl_bench.metrics.table import UNDER_ABSENCES
from xmarl_bench.plugins.registry import find_explainer
from xmarl_bench.policy import load_policy
from xmarl_bench.records.files import canonical_json
from xmarl_bench.rollout.cell import Cell, Sampling
from xmarl_bench.scoring.request import Request
from xmarl_bench.scoring.score import entries_of, score, score_requests
from xmarl_bench.submission.consistency import entry_findings


def bytes_of(entry: Entry) -> bytes:
    return canonical_json(entry.model_dump(mode="json", exclude={"provenance", "cost"}))


@pytest.mark.slow
@pytest.mark.parametrize("n_agents", [8, 10])
@pytest.mark.parametrize("task", ["blind_navigation_v0", "blind_discovery_v0"])
def test_a_policy_of_five_is_scored_in_a_larger_team(
    make_bundle: MakeBundle, task: str, n_agents: int
) -> None:
    entry = score(make_bundle(task, 5), "attention", n_agents=n_agents, episodes=1, timesteps=2, max_cycles=8)
    (cell,) = entry.results
    assert (entry.policy.n_agents, cell.n_agents) == (5, n_agents)
    assert list(entry_findings(entry)) == []
    assert cell.oracle_kind == "enumerated"
    (row,) = cell.episodes
    for absence in ("comm", "mean", "resample", "renormalised"):
        budget = getattr(row, f"{absence}_budget")
        assert len(budget.explained) == len(budget.random) == len(budget.oracle) == n_agents - 2
        assert budget.random_error is None
    assert None not in [getattr(row, name) for name in (*UNDER_ABSENCES, "message_fidelity")]
    (table,) = board_of([("one.json", entry)])["tables"]
    assert table["n_agents"] == n_agents
    assert table["policies"][0]["trained_n_agents"] == 5


@pytest.mark.slow
def test_above_ten_agents_the_oracle_is_sampled(make_bundle: MakeBundle) -> None:
    folder = make_bundle(n_agents=5)
    entry = score(folder, "attention", n_agents=11, episodes=2, timesteps=2, max_cycles=8)
    (cell,) = entry.results
    assert list(entry_findings(entry)) == []
    assert cell.oracle is not None
    assert (cell.oracle.kind, cell.oracle.orders, cell.oracle.definition) == ("sampled", ORDERS, SAMPLED)
    assert cell.oracle.error is not None
    assert 0.0 < cell.oracle.error < 0.5
    assert {"oracle", "soft-oracle"} < set(cell.controls)
    for metric in (*UNDER_ABSENCES, "message_fidelity"):
        assert getattr(cell.metrics, metric).value is not None, metric
        for control in ("all-ones", "zeros", "self"):
            assert getattr(cell.controls[control], metric).value == 0.0


def two_layers() -> PolicyModule:
    network = Stack(GATv2Conv, 6, 2, 1, add_self_loops=False)
    return PolicyModule("two-layers", network, "blind_navigation_v0", 3)


@pytest.mark.slow
def test_a_network_of_two_layers_end_to_end() -> None:
    entry = score(two_layers(), "attention", episodes=2, timesteps=3, max_cycles=10)
    (cell,) = entry.results
    assert list(entry_findings(entry)) == []
    assert cell.oracle is not None
    assert cell.oracle.kind == "sampled"
    assert set(UNDER_ABSENCES) & set(cell.not_measured) == set(UNDER_ABSENCES) - {"comm_budgeted_fidelity"}
    assert cell.metrics.message_fidelity == cell.metrics.comm_budgeted_fidelity
    value = cell.metrics.message_fidelity.value
    assert value is not None
    assert value <= 1.0
    for control in ("all-ones", "zeros", "self"):
        assert cell.controls[control].message_fidelity.value == 0.0
    best, everything = (cell.controls[name].fid_delta.value for name in ("oracle", "all-ones"))
    assert best is not None
    assert everything is not None
    assert best >= everything - 1e-6
    (table,) = board_of([("one.json", entry)])["tables"]
    assert table["oracle"] == "sampled"


@pytest.mark.slow
def test_a_sampled_oracle_depends_on_no_batch_and_no_company(make_bundle: MakeBundle) -> None:
    policy, card = load_policy(make_bundle(n_agents=5))
    sampling = Sampling(episodes=3, timesteps=1, max_cycles=6)
    requests = [
        Request(policy, card, find_explainer(name), (Cell(card.task, 11),), sampling, 0)
        for name in ("attention", "random")
    ]
    together = [bytes_of(entry) for entry in entries_of(score_requests(requests, parallel_episodes=1))]
    alone = [bytes_of(entry) for each in requests for entry in entries_of(score_requests([each]))]
    assert together == alone


@pytest.mark.slow
def test_an_edited_error_is_found(make_bundle: MakeBundle) -> None:
    entry = score(two_layers(), "attention", episodes=2, timesteps=3, max_cycles=10, behaviour_episodes=0)
    (cell,) = entry.results
    assert cell.oracle is not None
    for change, said in (
        ({"error": 0.5}, "oracle.error is 0.5"),
        ({"definition": "the best"}, "oracle.definition is not"),
        ({"kind": "enumerated"}, "random_error contradicts an oracle that is enumerated"),
    ):
        oracle = cell.oracle.model_copy(update=change)
        edited = entry.model_copy(update={"results": (cell.model_copy(update={"oracle": oracle}),)})
        assert any(said in finding for finding in entry_findings(edited)), said
