"""Speed of the batched explainers compared with PyG's own, one graph at a time: `make bench`.

CPU time of this process per explanation, at 1024 timesteps, on one thread, on states of shipped policies.
Discovery has an ordinary network, navigation the largest decoder (256, 256). In every round PyG explains a
few of the same states on the unmodified policy, as in its manual, then ours explains all of them.

PyG's GNNExplainer also computes unused gradients of the policy's weights; GraphMask does not. So both are
measured, as they are and with these gradients switched off. A busy machine slows PyG's many small steps more
than our large products: quote ratios of an idle machine only.
"""

from __future__ import annotations

import copy
import time
from collections.abc import Callable

import numpy as np
import pytest
from pytest_benchmark.fixture import BenchmarkFixture
from torch_geometric.explain import ExplainerAlgorithm, GNNExplainer, GraphMaskExplainer
from xmarl_baselines.explainers.gnn_explainer import gnn_explainer
from xmarl_baselines.explainers.graphmask import graphmask

from tests.baselines.reference import by_pyg, shipped_name, trained
from tests.benchmarks.conftest import Report
from tests.benchmarks.side_by_side import record
from xmarl_bench.explain.explainer import Explainer, run_explainer

N_STEPS, GRAPHS, ROUNDS = 1024, 3, 5
POLICIES = {name: shipped_name(f"blind_{name}_v0") for name in ("discovery", "navigation")}
PEERS: dict[str, tuple[Explainer, Callable[[], ExplainerAlgorithm]]] = {
    "GNNExplainer": (gnn_explainer, GNNExplainer),
    "GraphMask": (graphmask, lambda: GraphMaskExplainer(num_layers=1, log=False)),
}
BARS = {("GNNExplainer", 3): 100, ("GNNExplainer", 8): 60, ("GraphMask", 3): 200, ("GraphMask", 8): 80}


@pytest.mark.benchmark(timer=time.process_time, warmup=False)
@pytest.mark.parametrize("policy_name", POLICIES)
@pytest.mark.parametrize(("peer", "n_agents"), BARS)
def test_beside_pyg_one_graph_at_a_time(
    benchmark: BenchmarkFixture, report: Report, peer: str, n_agents: int, policy_name: str
) -> None:
    policy, few = trained(POLICIES[policy_name], 64, n_agents)
    without_gradients = copy.deepcopy(policy).requires_grad_(False)
    observations = few.repeat(N_STEPS // 64, 1, 1)
    explainer, algorithm = PEERS[peer]
    run_explainer(explainer, policy, few[:2], 0)
    as_it_is, frozen = list[float](), list[float]()  # seconds per explanation

    def time_theirs() -> None:
        for model, times in ((policy, as_it_is), (without_gradients, frozen)):
            started = time.process_time()
            for seed in range(GRAPHS):
                by_pyg(model, algorithm(), few[seed * 20], seed)
            times.append((time.process_time() - started) / GRAPHS)

    benchmark.pedantic(  # type: ignore[no-untyped-call]
        run_explainer, (explainer, policy, observations, 0), setup=time_theirs, rounds=ROUNDS
    )
    if benchmark.stats is None:  # --benchmark-disable
        return
    ours, bar = np.array(benchmark.stats.stats.data) / N_STEPS, BARS[peer, n_agents]
    what = f"{peer}, N = {n_agents}, {policy_name}"
    for whose, theirs, their_bar in (
        ("PyG", as_it_is, bar),
        ("PyG, weights without gradients", frozen, None),
    ):
        record(benchmark, report, what, whose, ours=ours, theirs=theirs, unit="ms", bar=their_bar)
