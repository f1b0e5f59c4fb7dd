"""Networks that masks cannot explain are refused when opened, by one sentence that names the cause."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch
from torch import Tensor, nn
from torch_geometric import EdgeIndex
from torch_geometric.nn import DenseGATConv, GATv2Conv, GraphConv, MessagePassing, RGCNConv
from torch_geometric.utils import dropout_edge, remove_self_loops, to_torch_coo_tensor

from tests.helpers.gatv2 import OneLayer
from tests.helpers.policies import random_observations, small_policy
from xmarl_bench import CompleteGraph, FixedGraph, PolicyModule
from xmarl_bench.errors import InputError
from xmarl_bench.origin.references import origin_of
from xmarl_bench.plugins.code_policies import open_module
from xmarl_bench.policy import (
    ActionDistribution,
    GraphPolicy,
    Policy,
    Prepared,
    complete_graph,
    load_policy,
    save_policy,
)

N = 3
NO_LOOPS = CompleteGraph(loops=False)


def opened(network: nn.Module, *, n_agents: int = N, **options: Any) -> Policy:
    module = PolicyModule("mine", network, "blind_navigation_v0", n_agents, **options)
    return open_module(module, origin_of(network))[0]


class Network(nn.Module):
    """GATv2 with a fault around it."""

    def __init__(
        self,
        forward: Callable[[Network, Tensor, Tensor], Any],
        layer: nn.Module | None = None,
        dense: nn.Module | None = None,
    ) -> None:
        super().__init__()
        self.does = forward
        self.layer = GATv2Conv(6, 4, add_self_loops=False) if layer is None else layer
        self.dense = dense

    def forward(self, x: Tensor, edge_index: Tensor) -> Any:
        return self.does(self, x, edge_index)


def teams(x: Tensor) -> Tensor:
    return x.view(-1, N, x.shape[-1])


def next_agent(x: Tensor) -> Tensor:
    """Rows shifted by one agent within the team."""
    return teams(x).roll(1, dims=1).reshape(x.shape)


def team_attention(x: Tensor) -> Tensor:
    """Attention of every row to the rows of its team, without messages."""
    team = teams(x)
    return (torch.softmax(team @ team.mT, dim=-1) @ team).reshape(x.shape)


def dense_beside(network: Network, x: Tensor, edge_index: Tensor) -> Tensor:
    out: Tensor = network.layer(x + team_attention(x), edge_index)
    return out + team_attention(x)[:, :4]


def sums_beside(network: Network, x: Tensor, edge_index: Tensor) -> Tensor:
    """Sums along edges outside of any layer."""
    sender, receiver = edge_index
    out: Tensor = network.layer(x, edge_index)
    return out + torch.zeros(len(x), 4).index_add(0, receiver, x[sender, :4])


def dense_after(network: Network, x: Tensor, edge_index: Tensor) -> Tensor:
    return team_attention(network.layer(x, edge_index))


def threshold(network: Network, x: Tensor, edge_index: Tensor) -> Tensor:
    near = (x[edge_index[0], :2] - x[edge_index[1], :2]).norm(dim=-1) < 1.5
    out: Tensor = network.layer(x, edge_index[:, near])
    return out


def learned_gate(network: Network, x: Tensor, edge_index: Tensor) -> Tensor:
    assert network.dense is not None
    kept = network.dense(torch.cat([x[edge_index[0]], x[edge_index[1]]], dim=-1)).squeeze(-1) > 0
    out: Tensor = network.layer(x, edge_index[:, kept])
    return out


def remember(network: Network, x: Tensor, edge_index: Tensor) -> Tensor:
    out: Tensor = network.layer(x, edge_index)
    before = getattr(network, "before", torch.zeros(1, 4))
    network.before = out.mean(dim=0, keepdim=True).detach()
    return out + before


def by_receiver(edges: Tensor, n: int) -> EdgeIndex:
    return EdgeIndex(edges, sparse_size=(n, n), sort_order="col")


class Shuffles(MessagePassing):  # type: ignore[misc]
    """Gives each agent the messages of another one, on its own edges, so it has no graph of loops."""

    def forward(self, x: Tensor, edge_index: Tensor) -> Tensor:
        team = torch.arange(0, len(x), N)[:, None]
        edge_index = (complete_graph(N)[:, None] + team).flatten(1)
        out: Tensor = self.propagate(edge_index, x=x[:, :4])
        return teams(out).roll(1, dims=1).reshape(out.shape) + x[:, :4]


class Short(MessagePassing):  # type: ignore[misc]
    """Returns half a message for each edge."""

    def forward(self, x: Tensor, edge_index: Tensor) -> Tensor:
        out: Tensor = self.propagate(edge_index, x=x[:, :4])
        return out

    def message(self, x_j: Tensor) -> Tensor:
        return x_j[::2]


REFUSED: dict[str, tuple[nn.Module, str]] = {
    "no message passing": (
        Network(lambda self, x, edges: team_attention(x)[:, :4], layer=nn.Identity()),
        "Network passes no message through a layer of torch_geometric",
    ),
    "dense layers of torch_geometric": (
        Network(
            lambda self, x, edges: self.layer(teams(x), torch.ones(len(x) // N, N, N)).flatten(0, 1),
            layer=DenseGATConv(6, 4),
        ),
        "passes no message",
    ),
    "dense attention beside": (Network(dense_beside), "agent 0 reacts to what others observe"),
    "dense attention after": (
        Network(dense_after),
        "agent 0 reacts to what others observe on a graph of loops",
    ),
    "sums beside": (Network(sums_beside), "agent 0 reacts to what others observe"),
    "rows in another order": (
        Network(lambda self, x, edges: self.layer(next_agent(x), edges)),
        "agent 0 reacts to what others observe on a graph of loops alone",
    ),
    "senders in another order": (
        Network(lambda self, x, edges: self.layer((next_agent(x), x), edges)),
        "agent 0 reacts to what others observe on a graph of loops alone",
    ),
    "handed on": (Shuffles(), r"masking the message \d -> \d changes agent \d"),
    "all rows": (
        Network(lambda self, x, edges: self.layer(x - x.mean(dim=0), edges)),
        "mixes the graphs of a batch",
    ),
    "hard dropping": (Network(threshold), r"passes \d messages on 9 edges: it drops \d -> \d"),
    "learned dropping": (
        Network(learned_gate, dense=nn.Linear(12, 1)),
        r"passes \d messages on 9 edges: it drops \d -> \d",
    ),
    "loops removed": (
        OneLayer(lambda edges, n: remove_self_loops(edges)[0]),
        "6 messages on 9 edges: it drops 0 -> 0",
    ),
    "random dropping": (OneLayer(lambda edges, n: dropout_edge(edges, p=0.5)[0]), "it drops"),
    "edges twice": (
        OneLayer(lambda edges, n: torch.cat([edges, edges], dim=1)),
        "0 -> 0 has more than one",
    ),
    "relations": (
        Network(
            lambda self, x, edges: self.layer(x, edges, (edges[0] == edges[1]).long()), RGCNConv(6, 4, 2)
        ),
        "RGCNConv passes 6 messages on 9 edges",
    ),
    "backwards": (OneLayer(flow="target_to_source"), "from target to source: build it with flow='source_"),
    "noise": (
        Network(lambda self, x, edges: self.layer(x, edges) + 0.1 * torch.randn(len(x), 4)),
        "draws random numbers",
    ),
    "state": (Network(remember), "keeps a state between calls"),
    "sparse": (
        Network(
            lambda self, x, edges: self.layer(x, to_torch_coo_tensor(edges.flip(0), size=len(x))),
            GraphConv(6, 4),
        ),
        "GraphConv receives its edges as a sparse matrix",
    ),
    "fused": (
        Network(
            lambda self, x, edges: self.layer(x, by_receiver(edges, len(x))),
            GraphConv(6, 4),
        ),
        "GraphConv sums its messages without computing each one",
    ),
    "half a message": (Short(), "makes 5 messages on 9 edges"),
    "width": (GATv2Conv(6, 8, add_self_loops=False), r"\(3, 8\) for 3 agents: return \(3, 4\), location and"),
    "a pair": (
        Network(lambda self, x, edges: (self.layer(x, edges), x)),
        r"returned a tuple .* return \(3, 4\)",
    ),
    "another dtype": (
        Network(lambda self, x, edges: self.layer(x, edges).double()),
        "returned torch.float64 for torch.float32: keep",
    ),
    "rows of one team": (
        Network(lambda self, x, edges: self.layer(x, edges)[:N]),
        r"returned shape \(3, 4\) for two teams of 3 agents",
    ),
    "exit": (Network(lambda self, x, edges: sys.exit(3)), r"failed on 3 agents \(SystemExit: 3\)"),
    "not a number": (Network(lambda self, x, edges: self.layer(x, edges) / 0.0), "returned NaN or infinity"),
    "crash": (
        Network(lambda self, x, edges: self.layer(x)),
        r"failed on 3 agents \(TypeError.*edge_index \(2,",
    ),
}


@pytest.mark.parametrize(("network", "said"), REFUSED.values(), ids=REFUSED)
def test_refused_with_the_cause(network: nn.Module, said: str) -> None:
    with pytest.raises(InputError, match=said) as error:
        opened(network)
    assert str(error.value).endswith(".")


def test_loops_added_to_a_graph_without_them_are_refused() -> None:
    network = OneLayer(add_self_loops=True)
    opened(network)
    with pytest.raises(InputError, match="9 messages on 6 edges: it adds the loop 0 -> 0"):
        opened(network, graph=NO_LOOPS)
    opened(OneLayer(), graph=NO_LOOPS)


def test_edges_turned_round_are_refused_where_not_all_go_both_ways() -> None:
    turned = OneLayer(lambda edges, n: edges.flip(0))
    opened(turned)
    with pytest.raises(InputError, match="1 -> 0 is not an edge of the policy's graph"):
        opened(turned, graph=FixedGraph(n_agents=N, edges=((0, 1), (1, 2))))


def test_a_fault_that_appears_only_while_scoring_is_refused_then() -> None:
    """The network drops edges on states that the random tests on opening do not reach."""
    network = OneLayer(lambda edges, n: edges)
    policy = opened(network)
    network.rewire = lambda edges, n: edges[:, :-1]
    with pytest.raises(InputError, match="GATv2Conv passes 17 messages on 18 edges: it drops 5 -> 5"):
        policy.distribution(random_observations(2, N, 6))


@pytest.mark.parametrize(
    ("forward", "said"),
    [
        (
            lambda self, x, edges: 1 / 0,
            r"Network failed on 6 agents \(ZeroDivisionError: .*\): correct the n",
        ),
        (lambda self, x, edges: sys.exit(3), r"Network failed on 6 agents \(SystemExit: 3\)"),
        (lambda self, x, edges: self.layer(x, edges)[:4], r"Network returned shape \(4, 4\) for 6 agents"),
        (lambda self, x, edges: None, "Network returned a NoneType for 6 agents: return a row for each"),
    ],
)
def test_a_network_that_fails_only_later_is_named_then(
    forward: Callable[..., Tensor], said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    network = Network(lambda self, x, edges: self.layer(x, edges))
    policy, observations = opened(network), random_observations(2, N, 6)
    monkeypatch.setattr(Network, "forward", forward)
    with pytest.raises(InputError, match=said):
        policy.distribution(observations)


def test_bundles_are_tested_when_they_are_opened(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """No bundle contains such a network, so the fault is patched into ours."""
    card: dict[str, Any] = {"task": "blind_navigation_v0", "n_agents": 4, "attention_entropy": 0.0}
    save_policy(tmp_path, small_policy(6), name="mine", **card)
    load_policy(tmp_path)
    decode = GraphPolicy.decode

    def turned(policy: GraphPolicy, prepared: Prepared, mask: Tensor | None = None) -> ActionDistribution:
        return decode(policy, prepared, None if mask is None else mask.mT)

    monkeypatch.setattr(GraphPolicy, "decode", turned)
    with pytest.raises(InputError, match=r"masking the message (\d) -> \d changes agent \1"):
        load_policy(tmp_path)


def test_opening_draws_no_global_random_numbers() -> None:
    network, before = OneLayer(), torch.get_rng_state()
    opened(network)
    assert torch.equal(torch.get_rng_state(), before)
