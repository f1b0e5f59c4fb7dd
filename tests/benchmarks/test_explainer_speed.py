"""Speed of the batched explainers compared with PyG's own, one graph at a time: `make bench`.

CPU time of this process per explanation, at 1024 timesteps, on one thread, on states of shipped policies.
Discovery has an ordinary network, navigation the largest decoder (256, 256). In every round PyG explains a
few of the same states on the unmodified policy, as in its manual, then ours explains all of them; the best
round of each counts. `ratio` is the cost of one of PyG's explanations divided by the cost of one of ours.

PyG's GNNExplainer also computes unused gradients of the policy's weights; GraphMask does not.
`ratio_to_frozen` is the ratio to PyG with these gradients switched off. A busy machine slows PyG's many small
steps more than our large
products: quote ratios of an idle machine only.
"""

from __future__ import annotations

import copy
import time
from collections.abc import Callable

import pytest
from pytest_benchmark.fixture import BenchmarkFixture
from torch_geometric.explain import ExplainerAlgorithm, GNNExplainer, GraphMaskExplainer
from xmarl_baselines.explainers.gnn_explainer import gnn_explainer
from xmarl_baselines.explainers.graphmask import graphmask

from tests.baselines.reference import by_pyg, shipped_name, trained
from tests.benchmarks.conftest import Report
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
    ours, bar = benchmark.stats.stats.min / N_STEPS, BARS[peer, n_agents]
    ratio, ratio_to_frozen = min(as_it_is) / ours, min(frozen) / ours
    benchmark.extra_info |= {
        "pyg_ms": round(1e3 * min(as_it_is), 1),
        "ours_ms": round(1e3 * ours, 3),
        "ratio": round(ratio),
        "ratio_to_frozen": round(ratio_to_frozen),
        "bar": bar,
    }
    report(
        "ms per explanation: PyG's, ours; ratio, its bar; ratio to PyG without gradients of weights",
        f"{peer}, N = {n_agents}, {policy_name}".ljust(40)
        + f"{1e3 * min(as_it_is):>8.1f}{1e3 * ours:>8.3f}{ratio:>6.0f} >= {bar}{ratio_to_frozen:>8.0f}",
    )
    assert ratio >= bar, f"{ratio:.0f} times as fast, should be {bar}"
