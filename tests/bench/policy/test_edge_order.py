"""Networks that reorder their edges: masks, attention and PyG's explainers follow."""

from __future__ import annotations

from collections.abc import Callable

import pytest
import torch
from torch import Tensor, nn
from torch_geometric.explain import AttentionExplainer, CaptumExplainer, DummyExplainer, ExplainerAlgorithm
from torch_geometric.explain.algorithm.utils import clear_masks, set_masks
from torch_geometric.nn import GATv2Conv, TransformerConv
from torch_geometric.utils import add_self_loops, remove_self_loops, sort_edge_index, to_undirected

from tests.helpers.gatv2 import OneLayer, dense_attention, dense_location
from tests.helpers.policies import random_masks, random_observations
from xmarl_bench import PolicyModule
from xmarl_bench.errors import InputError
from xmarl_bench.explain.pyg import PygExplain
from xmarl_bench.origin.references import origin_of
from xmarl_bench.plugins.code_policies import open_module
from xmarl_bench.policy import ModulePolicy, complete_graph

N = 3
TASK = "blind_navigation_v0"
ALL = torch.ones(N, N, dtype=torch.bool)


def opened(network: nn.Module) -> ModulePolicy:
    policy, _ = open_module(PolicyModule("mine", network, TASK, N), origin_of(network))
    return policy


def source_major(edge_index: Tensor, n: int) -> Tensor:
    """The network's own list of all edges, team by team."""
    first = torch.arange(0, n, N)[:, None]
    sender, receiver = complete_graph(N).flip(0)
    return torch.stack([(first + sender).flatten(), (first + receiver).flatten()])


REWIRED = {
    "sorted": OneLayer(lambda edges, n: sort_edge_index(edges)),
    "undirected": OneLayer(lambda edges, n: to_undirected(edges)),
    "own list": OneLayer(source_major),
    "loops last": OneLayer(lambda edges, n: add_self_loops(remove_self_loops(edges)[0], num_nodes=n)[0]),
    "from last to first": OneLayer(lambda edges, n: edges.flip(1)),
    "the layer's own loops": OneLayer(add_self_loops=True),
    "turned round": OneLayer(lambda edges, n: edges.flip(0)),
}
rewired = pytest.mark.parametrize("network", REWIRED.values(), ids=REWIRED)


@rewired
def test_the_layer_gets_edges_in_another_order(network: OneLayer) -> None:
    seen: list[Tensor] = []
    hook = network.layer.register_propagate_forward_pre_hook(lambda layer, inputs: seen.append(inputs[0]))
    network(random_observations(1, N, 6)[0], complete_graph(N))
    hook.remove()
    assert not torch.equal(seen[0], complete_graph(N))


@rewired
def test_masks_reach_the_right_edges(network: OneLayer) -> None:
    policy = opened(network)
    observations, masks = random_observations(5, N, 6), random_masks(5, N)
    with torch.no_grad():
        loc = policy.distribution(observations, masks).loc
        attention = policy.attention(observations)
        for s in range(5):
            expected = dense_location(network, observations[s], ALL, masks[s])
            torch.testing.assert_close(loc[s], expected, rtol=1e-4, atol=1e-4)
            weights = dense_attention(network, observations[s], ALL)
            torch.testing.assert_close(attention[s], weights, rtol=1e-4, atol=1e-5)
    assert policy.row_wise


@rewired
def test_a_message_moves_only_its_receiver(network: OneLayer) -> None:
    policy, observations = opened(network), random_observations(1, N, 6)
    mask = torch.ones(1, N, N)
    mask[0, 0, 1] = 0.0
    with torch.no_grad():
        moved = policy.distribution(observations, mask).loc - policy.distribution(observations).loc
    assert (moved[0].abs().amax(dim=-1) > 1e-4).tolist() == [True, False, False]


@rewired
def test_pyg_s_masks_by_place_reach_the_right_edges_too(network: OneLayer) -> None:
    policy = opened(network)
    observations, masks = random_observations(4, N, 6), random_masks(4, N)
    with torch.no_grad():
        ours = policy.distribution(observations, masks).action
        for x, mask, action in zip(observations, masks, ours, strict=True):
            edge_index = policy.layer_edges(x)
            sender, receiver = edge_index
            set_masks(policy.network, mask[receiver, sender], edge_index, apply_sigmoid=False)
            theirs = policy(x, edge_index)
            clear_masks(policy.network)
            torch.testing.assert_close(action, theirs, rtol=0, atol=1e-5)


@rewired
@pytest.mark.parametrize("algorithm", [AttentionExplainer, lambda: CaptumExplainer("Saliency")])
def test_explainers_of_pyg_give_the_same_mask_for_every_order(
    network: OneLayer, algorithm: Callable[[], ExplainerAlgorithm]
) -> None:
    explain = PygExplain(algorithm, effect=algorithm is not AttentionExplainer)
    observations = random_observations(2, N, 6)
    masks = [
        explain(opened(each), observations, torch.Generator().manual_seed(0))
        for each in (OneLayer(), network)
    ]
    torch.testing.assert_close(masks[1], masks[0], rtol=1e-4, atol=1e-5)
    assert not torch.allclose(masks[0], masks[0].mT, atol=1e-2)


class TwoOrders(nn.Module):
    """A layer that puts loops last, and one that keeps the order."""

    def __init__(self) -> None:
        super().__init__()
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(0)
            self.first, self.second = GATv2Conv(6, 6), TransformerConv(6, 4)

    def forward(self, x: Tensor, edge_index: Tensor) -> Tensor:
        out: Tensor = self.second(self.first(x, edge_index), edge_index)
        return out


def test_layers_of_two_orders_are_masked_but_not_by_place() -> None:
    policy, observations = opened(TwoOrders()), random_observations(2, N, 6)
    mask = torch.zeros(2, N, N)
    mask[:, 0, 1] = 1.0
    with torch.no_grad():
        heard = policy.distribution(observations, mask).loc - policy.distribution(observations, 0 * mask).loc
    assert (heard.abs().amax(dim=(0, 2)) > 1e-4).tolist() == [True, False, False]
    torch.testing.assert_close(policy.attention(observations).sum(dim=-1), torch.ones(2, N))
    with pytest.raises(InputError, match="TwoOrders receive edges in different orders"):
        PygExplain(DummyExplainer)(policy, observations, torch.Generator())


def test_the_order_of_edges_given_does_not_matter() -> None:
    policy, x = opened(REWIRED["sorted"]), random_observations(1, N, 6)[0]
    shuffled = complete_graph(N)[:, torch.tensor([4, 0, 8, 2, 6, 1, 3, 7, 5])]
    with torch.no_grad():
        assert torch.equal(policy(x, shuffled), policy(x, complete_graph(N)))
