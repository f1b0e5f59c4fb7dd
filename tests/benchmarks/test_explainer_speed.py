"""How fast the batched explainers are, beside PyG's own one graph at a time: `make bench`.

Per explanation, at 1024 timesteps, on one thread, in CPU time of this process, on states of shipped policies:
discovery has an ordinary network, navigation the paper's, with the largest decoder (256, 256). PyG explains a
few of the same states on the policy as it is, as its manual says; the best round of each counts.
`ratio` is what one of PyG's explanations costs divided by what one of ours does.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import pytest
from pytest_benchmark.fixture import BenchmarkFixture
from torch_geometric.explain import ExplainerAlgorithm, GNNExplainer, GraphMaskExplainer
from xmarl_baselines.explainers.gnn_explainer import gnn_explainer
from xmarl_baselines.explainers.graphmask import graphmask

from tests.baselines.reference import by_pyg, trained
from xmarl_bench.explainer import Explainer, run_explainer

N_STEPS, GRAPHS, ROUNDS = 1024, 5, 3
POLICIES = {"discovery": "discovery-n3-lambda0-seed0", "navigation": "navigation-paper-n3-lambda0-seed0"}
PEERS: dict[str, tuple[Explainer, Callable[[], ExplainerAlgorithm]]] = {
    "GNNExplainer": (gnn_explainer, GNNExplainer),
    "GraphMask": (graphmask, lambda: GraphMaskExplainer(num_layers=1, log=False)),
}


@pytest.mark.benchmark(timer=time.process_time, warmup=False)
@pytest.mark.parametrize("policy_name", POLICIES)
@pytest.mark.parametrize("n_agents", [3, 8])
@pytest.mark.parametrize("peer", PEERS)
def test_beside_pyg_one_graph_at_a_time(
    benchmark: BenchmarkFixture, peer: str, n_agents: int, policy_name: str
) -> None:
    policy, few = trained(POLICIES[policy_name], 64, n_agents)
    observations = few.repeat(N_STEPS // 64, 1, 1)
    explainer, algorithm = PEERS[peer]
    run_explainer(explainer, policy, few[:2], 0)
    theirs = []
    for _ in range(ROUNDS):
        started = time.process_time()
        for seed in range(GRAPHS):
            by_pyg(policy, algorithm(), few[seed * 12], seed)
        theirs.append((time.process_time() - started) / GRAPHS)
    benchmark.pedantic(  # type: ignore[no-untyped-call]
        run_explainer, (explainer, policy, observations, 0), rounds=ROUNDS
    )
    if benchmark.stats is not None:
        ours = benchmark.stats.stats.min / N_STEPS
        benchmark.extra_info["pyg_ms"] = round(1e3 * min(theirs), 1)
        benchmark.extra_info["ours_ms"] = round(1e3 * ours, 3)
        benchmark.extra_info["ratio"] = round(min(theirs) / ours)
