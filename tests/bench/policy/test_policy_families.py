"""Six families of policies that the field trains, small and untrained: masks are right, and they are scored.

Networks as their papers and libraries build them, brought as a bundle, a conversion or code.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal

import pytest
import torch
from torch import Tensor, nn
from torch_geometric.nn import MessagePassing, TransformerConv
from torch_geometric.utils import softmax

from tests.bench.policy.test_benchmarl import checkpoint
from tests.bench.policy.test_categorical import pilot
from tests.helpers.policies import random_masks, random_observations
from tests.helpers.recurrent_policies import AttentionThenGru, drawn
from xmarl_bench import PolicyModule, RadiusGraph, build_policy, load_policy, save_policy, score
from xmarl_bench.origin.references import origin_of
from xmarl_bench.plugins.code_policies import open_module
from xmarl_bench.policy import Policy
from xmarl_bench.policy.benchmarl import Settings, read_actor
from xmarl_bench.submission.consistency import entry_findings

N = 3
CARD: dict[str, Any] = {"task": "blind_navigation_v0", "n_agents": N, "attention_entropy": 0.0}


def benchmarl(loops: Literal["layer", "none"]) -> Callable[[Path], Path]:
    """BenchMARL's GNN and MLP: a GATv2Conv on the complete graph, then a decoder; converted."""

    def convert(folder: Path) -> Path:
        record, weights = read_actor(checkpoint(), Settings("tanh", loops), 6)
        save_policy(folder, build_policy(record, weights), name="benchmarl", **CARD)
        return folder

    return convert


class InforMarl(nn.Module):
    """Attention over agents nearby, with distances as features of edges (Nayak et al., ICML 2023).

    The actor gets the agent's own observation beside what it heard.
    """

    def __init__(self) -> None:
        super().__init__()
        self.embed = nn.Linear(6, 8)
        self.layer = TransformerConv(8, 8, heads=2, concat=False, edge_dim=1, root_weight=False)
        self.actor = nn.Sequential(nn.Linear(6 + 8, 16), nn.ReLU(), nn.Linear(16, 4))
        drawn(self)

    def forward(self, x: Tensor, edge_index: Tensor) -> Tensor:
        sender, receiver = edge_index
        distance = torch.linalg.vector_norm(x[sender, :2] - x[receiver, :2], dim=1, keepdim=True)
        heard = self.layer(torch.relu(self.embed(x)), edge_index, distance)
        out: Tensor = self.actor(torch.cat([x, heard], dim=1))
        return out


class TarMacRound(MessagePassing):  # type: ignore[misc]
    """A signature and a value of each sender, a query of each receiver, scaled dot products between them."""

    def __init__(self) -> None:
        super().__init__(aggr="sum")
        self.signature, self.query, self.value = nn.Linear(8, 4), nn.Linear(8, 4), nn.Linear(8, 6)

    def forward(self, h: Tensor, edge_index: Tensor) -> Tensor:
        sender, receiver = edge_index
        match = (self.query(h)[receiver] * self.signature(h)[sender]).sum(dim=1) / 2.0
        heard: Tensor = self.propagate(edge_index, x=self.value(h), alpha=softmax(match, receiver))
        return heard

    def message(self, x_j: Tensor, alpha: Tensor) -> Tensor:
        return alpha[:, None] * x_j


class TarMac(nn.Module):
    """Two rounds of the same targeted communication before every action (Das et al., ICML 2019)."""

    def __init__(self) -> None:
        super().__init__()
        self.encode, self.talk, self.update = nn.Linear(6, 8), TarMacRound(), nn.Linear(8 + 6, 8)
        self.policy = nn.Linear(8, 4)
        drawn(self)

    def forward(self, x: Tensor, edge_index: Tensor) -> Tensor:
        h = torch.tanh(self.encode(x))
        for _ in range(2):
            h = torch.tanh(self.update(torch.cat([h, self.talk(h, edge_index)], dim=1)))
        out: Tensor = self.policy(h)
        return out


def code(network: Callable[[], nn.Module], **options: Any) -> Callable[[Path], PolicyModule]:
    return lambda folder: PolicyModule(
        network.__name__.lower(), network(), "blind_navigation_v0", N, **options
    )


FAMILIES: dict[str, Callable[[Path], Path | PolicyModule]] = {
    "BenchMARL, loops": benchmarl("layer"),
    "BenchMARL, no loops": benchmarl("none"),
    "InforMARL": code(InforMarl, graph=RadiusGraph(radius=2.0, loops=False)),
    "TarMAC": code(TarMac),
    "attention and GRU": code(AttentionThenGru),
    "categorical": lambda folder: pilot(),
}
families = pytest.mark.parametrize("family", FAMILIES)


def opened(given: Path | PolicyModule) -> Policy:
    return (
        load_policy(given)[0] if isinstance(given, Path) else open_module(given, origin_of(given.network))[0]
    )


def answers(policy: Policy, observations: Tensor, mask: Tensor) -> Tensor:
    """(S, N, ...) parameters of the action's distribution, and what agents remember."""
    with torch.no_grad():
        distribution, memory = policy.step(observations, mask)
    return torch.cat([distribution.loc, distribution.scale, memory], dim=-1)


@families
def test_a_message_changes_its_receiver_alone(family: str, tmp_path: Path) -> None:
    """Of one layer under any mask; of two rounds if the other receivers hear nothing."""
    policy = opened(FAMILIES[family](tmp_path / "policy"))
    assert policy.row_wise is (family != "TarMAC")
    observations = random_observations(5, N, 6 + policy.memory_dim)
    there = policy.adjacency(observations)
    there = torch.ones(5, N, N, dtype=torch.bool) if there is None else there
    moved = torch.zeros(5, N, N, dtype=torch.bool)  # [s, i, j]: by the message j -> i
    for i in range(N):
        for j in range(N):
            mask = random_masks(5, N, seed=7) + 0.5
            if not policy.row_wise:
                mask[:, torch.arange(N) != i] = 0.0
            removed = mask.clone()
            removed[:, i, j] = 0.0
            change = answers(policy, observations, mask) - answers(policy, observations, removed)
            change = change.abs().amax(dim=-1)
            moved[:, i, j] = change[:, i] > 1e-4
            change[:, i] = 0.0
            assert not (change > 1e-5).any()
    assert not (moved & ~there).any()
    assert torch.equal(moved.any(dim=0), there.any(dim=0))  # in a single state its coefficient may be near 0


@pytest.mark.slow
@families
def test_the_family_is_scored(family: str, tmp_path: Path) -> None:
    given = FAMILIES[family](tmp_path / "policy")
    entry = score(given, "attention", episodes=2, timesteps=3, max_cycles=6, behaviour_episodes=1)
    assert list(entry_findings(entry)) == []
    (cell,) = entry.results
    assert cell.metrics.fid_delta.value is not None
    assert cell.controls["all-ones"].fid_minus.value == 0.0
    assert cell.controls["zeros"].fid_minus.value is not None
    assert cell.controls["zeros"].fid_minus.value > 1e-4
