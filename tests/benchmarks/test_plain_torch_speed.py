"""Explainers beside what a user writes in their place in plain torch, all timesteps at once.

`batched autograd` is a loop around `backward` of a sum over timesteps. `torch.func.vmap` writes the objective
of one timestep and maps its gradient. Both compute messages and attention once, on a policy whose weights
need no gradient, and their masks equal ours. 1024 states of shipped policies.
"""

from __future__ import annotations

import copy
import math
import time
from collections.abc import Callable

import pytest
import torch
from pytest_benchmark.fixture import BenchmarkFixture
from torch import Tensor
from torch.func import grad, vmap
from torch.nn import functional as F
from xmarl_baselines.explainers.gnn_explainer import gnn_explainer_mask, random_logits
from xmarl_baselines.explainers.graphmask import graphmask_mask, uniform_noise

from tests.baselines.reference import shipped_name, trained
from tests.benchmarks.conftest import Report
from tests.benchmarks.side_by_side import clocked, side_by_side
from xmarl_bench.policy import GraphPolicy, Prepared
from xmarl_bench.reproducible import timestep_seeds

pytestmark = pytest.mark.benchmark(timer=time.process_time)
N_STEPS = 1024
EPOCHS, RATE, SIZE, ENTROPY = 100, 0.01, 0.005, 1.0  # PyG's defaults
POLICIES = {name: shipped_name(f"blind_{name}_v0") for name in ("discovery", "navigation")}
Mask = Callable[[GraphPolicy, Tensor, Tensor], Tensor]


def objective(policy: GraphPolicy, prepared: Prepared, target: Tensor, mask: Tensor, size: float) -> Tensor:
    """(..., N, N) -> (...): GNNExplainer's, whose first epoch is without size and entropy."""
    error = (policy.decode(prepared, mask).action - target).square().mean((-2, -1))
    entropy = -mask * (mask + 1e-15).log() - (1 - mask) * (1 - mask + 1e-15).log()
    return error + size * (SIZE * mask.sum((-2, -1)) + ENTROPY * entropy.mean((-2, -1)))


def batched_autograd(policy: GraphPolicy, observations: Tensor, start: Tensor) -> Tensor:
    with torch.no_grad():
        prepared = policy.prepare(observations)
        target = policy.decode(prepared).action
    w = start.clone().requires_grad_()
    adam = torch.optim.Adam([w], lr=RATE)
    for epoch in range(EPOCHS):
        adam.zero_grad()
        objective(policy, prepared, target, w.sigmoid(), float(epoch > 0)).sum().backward()
        adam.step()
    return w.detach().sigmoid()


def by_vmap(policy: GraphPolicy, observations: Tensor, start: Tensor) -> Tensor:
    with torch.no_grad():
        prepared = policy.prepare(observations)
        target = policy.decode(prepared).action

    def one(w: Tensor, prepared: Prepared, target: Tensor, size: float) -> Tensor:
        return objective(policy, prepared, target, w.sigmoid(), size)

    gradient = vmap(grad(one), in_dims=(0, 0, 0, None))
    w = start.clone()
    adam = torch.optim.Adam([w], lr=RATE)
    for epoch in range(EPOCHS):
        w.grad = gradient(w, prepared, target, float(epoch > 0))
        adam.step()
    return w.sigmoid()


@pytest.mark.parametrize("policy_name", POLICIES)
@pytest.mark.parametrize("n_agents", [3, 8])
@pytest.mark.parametrize(
    ("peer", "theirs"), [("batched autograd", batched_autograd), ("torch.func.vmap", by_vmap)]
)
def test_gnn_explainer(
    benchmark: BenchmarkFixture, report: Report, peer: str, theirs: Mask, n_agents: int, policy_name: str
) -> None:
    policy, few = trained(POLICIES[policy_name], 64, n_agents)
    observations = few.repeat(N_STEPS // 64, 1, 1)
    plain = copy.deepcopy(policy).requires_grad_(False)
    start = random_logits(n_agents, timestep_seeds(N_STEPS, torch.Generator().manual_seed(0)))

    def ours() -> Tensor:
        return gnn_explainer_mask(policy, observations, torch.Generator().manual_seed(0))

    torch.testing.assert_close(theirs(plain, observations, start), ours(), atol=1e-3, rtol=0.0)
    what = f"GNNExplainer, N = {n_agents}, {policy_name}"
    side_by_side(
        benchmark, report, what, peer, ours, clocked(lambda: theirs(plain, observations, start)),
        pieces=N_STEPS, unit="us", rounds=5,
    )  # fmt: skip


def graphmask_by_autograd(policy: GraphPolicy, observations: Tensor, noise: Tensor) -> Tensor:
    def hard(s: Tensor) -> Tensor:
        soft = (1.2 * s - 0.2).clamp(0, 1)
        return (soft > 0.5).float() + (soft - soft.detach())

    def change(mask: Tensor) -> Tensor:
        return (policy.decode(prepared, mask).action - target).square().sum((1, 2))

    with torch.no_grad():
        prepared = policy.prepare(observations)
        target = policy.decode(prepared).action
    w, kept = torch.zeros_like(noise[0]).requires_grad_(), torch.ones_like(noise[0])
    multiplier = torch.full_like(noise[0, :, 0, 0], 0.55).requires_grad_()
    largest = change(torch.zeros_like(kept)).clamp_min(1e-30)
    gates = torch.optim.Adam([w], lr=0.1)
    ascent = torch.optim.RMSprop([multiplier], lr=0.1, centered=True, maximize=True)
    for step, u in enumerate(noise, start=1):
        z = hard(torch.sigmoid((torch.logit(u) + w + 3) * 3))
        is_open = torch.sigmoid(w + 3 - math.log(0.2) / 3).mean((1, 2))
        loss = is_open + F.softplus(multiplier) * F.relu(change(z) / largest - 0.01)
        gates.zero_grad()
        ascent.zero_grad()
        loss.sum().backward()
        gates.step()
        ascent.step()
        with torch.no_grad():
            multiplier.clamp_(-2, 30)
            if step % 5 == 0:
                mask = hard(torch.sigmoid(w + 3))
                better = (mask.sum((1, 2)) < kept.sum((1, 2))) & (change(mask) / largest <= 0.01)
                kept = torch.where(better[:, None, None], mask, kept)
    return kept


@pytest.mark.parametrize("policy_name", POLICIES)
@pytest.mark.parametrize("n_agents", [3, 8])
def test_graphmask(benchmark: BenchmarkFixture, report: Report, n_agents: int, policy_name: str) -> None:
    policy, few = trained(POLICIES[policy_name], 64, n_agents)
    observations = few.repeat(N_STEPS // 64, 1, 1)
    plain = copy.deepcopy(policy).requires_grad_(False)
    noise = uniform_noise(60, n_agents, timestep_seeds(N_STEPS, torch.Generator().manual_seed(0)))

    def ours() -> Tensor:
        return graphmask_mask(policy, observations, torch.Generator().manual_seed(0))

    def theirs() -> Tensor:
        return graphmask_by_autograd(plain, observations, noise)

    assert (ours() == theirs()).float().mean() > 0.99  # a gate at its threshold may fall to either side
    what = f"GraphMask, N = {n_agents}, {policy_name}"
    side_by_side(
        benchmark, report, what, "batched autograd", ours, clocked(theirs),
        pieces=N_STEPS, unit="us", rounds=5,
    )  # fmt: skip
