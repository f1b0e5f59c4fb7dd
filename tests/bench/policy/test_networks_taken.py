"""Networks given as code: masks have the same effect as in a dense computation without torch_geometric."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
import torch
from torch import Tensor, nn
from torch_geometric.nn import EdgeConv, GCNConv, GraphConv, MessagePassing, SAGEConv, TransformerConv
from torch_geometric.nn.models import GAT
from torch_geometric.utils import softmax

from tests.bench.policy.test_networks_refused import opened
from tests.helpers.gatv2 import OneLayer, dense_attention, dense_location
from tests.helpers.policies import random_masks, random_observations
from xmarl_bench import CompleteGraph, FixedGraph, RadiusGraph
from xmarl_bench.errors import InputError
from xmarl_bench.policy import Policy

N = 4
GRAPHS = {
    "complete": CompleteGraph(),
    "no loops": CompleteGraph(loops=False),
    "radius": RadiusGraph(radius=1.5),
    "radius, no loops": RadiusGraph(radius=1.5, loops=False),
    "given": FixedGraph(n_agents=N, edges=((0, 1), (1, 2), (3, 2), (2, 2)), loops=False),
}
Dense = Callable[[Any, Tensor, Tensor], Tensor]  # layer, (N, 6), (N, N) mask, 0 where no edge is -> (N, 4)


def seeded(make: Callable[[], nn.Module], seed: int = 0) -> nn.Module:
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        return make()


def states(n_steps: int = 6) -> tuple[Tensor, Tensor]:
    return random_observations(n_steps, N, 6), random_masks(n_steps, N)


def edges_of(policy: Policy, observations: Tensor) -> Tensor:
    return policy.graph.adjacency(observations)


@pytest.mark.parametrize("relative", [False, True], ids=["no edge features", "where the sender is"])
@pytest.mark.parametrize("graph", GRAPHS.values(), ids=GRAPHS)
def test_attention_equals_the_dense_computation_on_every_graph(graph: Any, relative: bool) -> None:
    network = OneLayer(relative=relative)
    policy = opened(network, n_agents=N, graph=graph)
    observations, masks = states()
    there = edges_of(policy, observations)
    assert bool(there.diagonal(dim1=1, dim2=2).all()) is graph.loops
    with torch.no_grad():
        loc, attention = policy.distribution(observations, masks).loc, policy.attention(observations)
        for s, (x, mask) in enumerate(zip(observations, masks, strict=True)):
            expected = dense_location(network, x, there[s], mask)
            torch.testing.assert_close(loc[s], expected, rtol=1e-4, atol=1e-4)
            weights = dense_attention(network, x, there[s])
            torch.testing.assert_close(attention[s], weights, rtol=1e-4, atol=1e-5)
    assert policy.row_wise


def test_edge_features_change_the_action() -> None:
    x, there, mask = random_observations(1, N, 6)[0], torch.ones(N, N, dtype=torch.bool), torch.ones(N, N)
    network = OneLayer(relative=True)
    with_features = dense_location(network, x, there, mask)
    network.relative = False
    assert (with_features - dense_location(network, x, there, mask)).abs().max() > 0.1


def graph_conv(layer: Any, x: Tensor, mask: Tensor) -> Tensor:
    out: Tensor = layer.lin_rel(mask @ x) + layer.lin_root(x)
    return out


def sage(layer: Any, x: Tensor, mask: Tensor) -> Tensor:
    """On the complete graph, where the mean is over all N."""
    out: Tensor = layer.lin_l(mask @ x / N) + layer.lin_r(x)
    return out


def gcn(layer: Any, x: Tensor, mask: Tensor) -> Tensor:
    """On the complete graph with loops, where every degree is N."""
    out: Tensor = mask @ layer.lin(x) / N + layer.bias
    return out


def edge_conv(layer: Any, x: Tensor, mask: Tensor) -> Tensor:
    receiver, sender = x[:, None].expand(N, N, -1), x[None].expand(N, N, -1)
    message: Tensor = layer.nn(torch.cat([receiver, sender - receiver], dim=-1))
    return (mask[..., None] * message).amax(dim=1)


LAYERS: dict[str, tuple[Callable[[], nn.Module], Dense]] = {
    "GraphConv": (lambda: GraphConv(6, 4), graph_conv),
    "SAGEConv": (lambda: SAGEConv(6, 4), sage),
    "GCNConv": (lambda: GCNConv(6, 4), gcn),
    "EdgeConv": (lambda: EdgeConv(nn.Linear(12, 4)), edge_conv),
}


@pytest.mark.parametrize(("make", "dense"), LAYERS.values(), ids=LAYERS)
def test_layers_without_attention_equal_the_dense_computation(
    make: Callable[[], nn.Module], dense: Dense
) -> None:
    layer = seeded(make)
    policy = opened(layer, n_agents=N)
    observations, masks = states()
    with torch.no_grad():
        loc = policy.distribution(observations, masks).loc
        for s, (x, mask) in enumerate(zip(observations, masks, strict=True)):
            torch.testing.assert_close(loc[s], dense(layer, x, mask)[:, :2], rtol=1e-4, atol=1e-4)
    assert policy.row_wise
    with pytest.raises(InputError, match="has no attention layer"):
        policy.attention(observations)


class InPlace(OneLayer):
    """Normalises its input in place."""

    def forward(self, x: Tensor, edge_index: Tensor) -> Tensor:
        return super().forward(x.mul_(0.5).sub_(0.25), edge_index)


def test_a_network_that_works_in_place_changes_no_observation() -> None:
    policy = opened(InPlace(), n_agents=N)
    observations, masks = states()
    before = observations.clone()
    with torch.no_grad():
        first = policy.distribution(observations, masks).loc
        policy.distribution(observations)
        policy.attention(observations)
        policy(observations[0], policy.edges(observations[0]))
        assert torch.equal(observations, before)
        assert torch.equal(policy.distribution(observations, masks).loc, first)


class TwoGraphConvs(nn.Module):
    def __init__(self) -> None:
        super().__init__()
        self.first, self.second = GraphConv(6, 5), GraphConv(5, 4)

    def forward(self, x: Tensor, edge_index: Tensor) -> Tensor:
        out: Tensor = self.second(torch.tanh(self.first(x, edge_index)), edge_index)
        return out


@pytest.mark.parametrize("graph", GRAPHS.values(), ids=GRAPHS)
def test_two_layers_equal_the_dense_computation_on_every_graph(graph: Any) -> None:
    network: Any = seeded(TwoGraphConvs)
    policy = opened(network, n_agents=N, graph=graph)
    observations, masks = states()
    kept = masks * edges_of(policy, observations)
    with torch.no_grad():
        loc = policy.distribution(observations, masks).loc
        for s, (x, mask) in enumerate(zip(observations, kept, strict=True)):
            hidden = torch.tanh(graph_conv(network.first, x, mask))
            expected = graph_conv(network.second, hidden, mask)[:, :2]
            torch.testing.assert_close(loc[s], expected, rtol=1e-4, atol=1e-4)
    assert not policy.row_wise


class Relative(nn.Module):
    """TransformerConv whose edge features are the sender's offset from the receiver."""

    def __init__(self) -> None:
        super().__init__()
        self.layer = TransformerConv(6, 4, edge_dim=2)

    def forward(self, x: Tensor, edge_index: Tensor) -> Tensor:
        sender, receiver = edge_index
        out: Tensor = self.layer(x, edge_index, x[sender, :2] - x[receiver, :2])
        return out


def test_edge_features_in_the_message_are_masked_with_it() -> None:
    network: Any = seeded(Relative)
    policy, layer = opened(network, n_agents=N), network.layer
    observations, masks = states()
    with torch.no_grad():
        loc, attention = policy.distribution(observations, masks).loc, policy.attention(observations)
        for s, (x, mask) in enumerate(zip(observations, masks, strict=True)):
            features = layer.lin_edge(x[None, :, :2] - x[:, None, :2])
            score = (layer.lin_query(x)[:, None] * (layer.lin_key(x)[None] + features)).sum(dim=-1)
            alpha = torch.softmax(score / 4**0.5, dim=-1)
            heard = ((mask * alpha)[..., None] * (layer.lin_value(x)[None] + features)).sum(dim=1)
            torch.testing.assert_close(loc[s], (heard + layer.lin_skip(x))[:, :2], rtol=1e-4, atol=1e-4)
            torch.testing.assert_close(attention[s], alpha, rtol=1e-4, atol=1e-5)


class Custom(MessagePassing):  # type: ignore[misc]
    """A custom attention whose coefficients are the argument `alpha` of its messages."""

    def __init__(self) -> None:
        super().__init__()
        self.score, self.value = nn.Linear(12, 1), nn.Linear(6, 4)

    def coefficients(self, x: Tensor, edge_index: Tensor) -> Tensor:
        sender, receiver = edge_index
        score = self.score(torch.cat([x[receiver], x[sender]], dim=-1)).squeeze(-1)
        alpha: Tensor = softmax(score, receiver)
        return alpha

    def forward(self, x: Tensor, edge_index: Tensor) -> Any:
        alpha = self.coefficients(x, edge_index)
        return self.propagate(edge_index, x=self.value(x), alpha=alpha)

    def message(self, x_j: Tensor, alpha: Tensor) -> Tensor:
        return alpha[:, None] * x_j


class Returning(Custom):
    """The same, but returns its coefficients on request; `message` has no `alpha`."""

    def forward(self, x: Tensor, edge_index: Tensor, return_attention_weights: bool | None = None) -> Any:
        edge_index = edge_index.flip(1)
        weight = self.coefficients(x, edge_index)
        out = self.propagate(edge_index, x=self.value(x), weight=weight)
        return out if return_attention_weights is None else (out, (edge_index, weight))

    def message(self, x_j: Tensor, weight: Tensor) -> Tensor:
        return weight[:, None] * x_j


@pytest.mark.parametrize("make", [Custom, Returning])
@pytest.mark.parametrize("graph", GRAPHS.values(), ids=GRAPHS)
def test_a_custom_attention_is_found_and_masked(graph: Any, make: Callable[[], nn.Module]) -> None:
    layer: Any = seeded(make)
    policy = opened(layer, n_agents=N, graph=graph)
    observations, masks = states()
    there = edges_of(policy, observations)
    with torch.no_grad():
        loc, attention = policy.distribution(observations, masks).loc, policy.attention(observations)
        for s, (x, mask) in enumerate(zip(observations, masks, strict=True)):
            pairs = torch.cat([x[:, None].expand(N, N, -1), x[None].expand(N, N, -1)], dim=-1)
            weight = layer.score(pairs).squeeze(-1).exp() * there[s]
            alpha = weight / weight.sum(dim=-1, keepdim=True).clamp_min(1e-30)
            expected = ((mask * alpha) @ layer.value(x))[:, :2]
            torch.testing.assert_close(loc[s], expected, rtol=1e-4, atol=1e-4)
            torch.testing.assert_close(attention[s], alpha, rtol=1e-4, atol=1e-5)


def test_a_model_of_torch_geometric_with_its_defaults_is_accepted() -> None:
    """GAT adds loops in every layer to a graph that already has them."""
    policy = opened(seeded(lambda: GAT(6, 8, 2, 4, heads=2)), n_agents=N)
    observations, _ = states()
    mask = torch.zeros(6, N, N)
    mask[:, 1] = 1.0  # agent 1 hears all, also its own first layer
    with torch.no_grad():
        moved = policy.distribution(observations, mask).loc - policy.distribution(observations, 0 * mask).loc
        torch.testing.assert_close(policy.attention(observations).sum(dim=-1), torch.ones(6, N))
    assert (moved.abs().amax(dim=(0, 2)) > 1e-4).tolist() == [False, True, False, False]
