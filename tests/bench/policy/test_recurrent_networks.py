"""Networks with memory given as code: accepted with correct results, or refused with one sentence."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
import torch
from torch import Tensor, nn
from torch_geometric.nn import GATv2Conv

from tests.bench.policy.test_networks_refused import opened, team_attention
from tests.helpers.policies import random_masks, random_observations
from tests.helpers.recurrent_policies import AttentionThenGru, LstmThenAttention
from xmarl_bench import RadiusGraph
from xmarl_bench.errors import InputError
from xmarl_bench.policy import complete_graph

N = 3


@pytest.mark.parametrize("make", [AttentionThenGru, LstmThenAttention])
def test_a_rollout_equals_that_of_plain_torch(make: Callable[[], Any]) -> None:
    network = make()
    policy = opened(network)
    assert policy.row_wise
    plain, memory = network.initial_state(N), policy.initial_state(N)
    with torch.no_grad():
        for x in random_observations(5, N, 6):
            output, plain = network.step(x, complete_graph(N), plain)
            distribution, (memory,) = policy.step(torch.cat([x, memory], dim=-1)[None])
            torch.testing.assert_close(distribution.loc[0], output[:, :2], rtol=0, atol=1e-6)
            parts = plain if isinstance(plain, tuple) else (plain,)
            torch.testing.assert_close(memory, torch.cat(parts, dim=-1), rtol=0, atol=1e-6)


def test_a_timestep_is_explained_with_its_recorded_memory() -> None:
    """An agent that acts on its old memory does not react to this timestep's messages, but remembers them."""

    class ActsOnTheLast(AttentionThenGru):
        def step(self, x: Tensor, edge_index: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
            return self.decoder(state), super().step(x, edge_index, state)[1]

    policy = opened(ActsOnTheLast())
    observations, masks = random_observations(4, N, 6 + policy.memory_dim), random_masks(4, N)
    with torch.no_grad():
        full, masked = policy.step(observations), policy.step(observations, masks)
    assert torch.equal(full[0].loc, masked[0].loc)
    assert (full[1] - masked[1]).abs().max() > 1e-3


def test_memory_on_a_changing_graph() -> None:
    policy = opened(LstmThenAttention(), graph=RadiusGraph(radius=1.0))
    observations = random_observations(4, N, 6 + policy.memory_dim)
    adjacency = policy.adjacency(observations)
    assert adjacency is not None
    place = observations[..., :2]
    assert torch.equal(adjacency, torch.cdist(place, place) <= 1.0)
    with torch.no_grad():
        attention = policy.attention(observations)
    torch.testing.assert_close(attention.sum(dim=-1), torch.ones(4, N))


class Recurrent(nn.Module):
    """Attention, then a step that a test gives."""

    def __init__(self, step: Callable[[Recurrent, Tensor, Tensor, Any], Any], start: Any = None) -> None:
        super().__init__()
        self.does, self.start, self.calls = step, start, list[int]()
        self.layer = GATv2Conv(6, 4, add_self_loops=False)

    def initial_state(self, n: int) -> Any:
        return torch.zeros(n, 4) if self.start is None else self.start(n)

    def step(self, x: Tensor, edge_index: Tensor, state: Any) -> Any:
        return self.does(self, x, edge_index, state)


def rolls(network: Recurrent, x: Tensor, edges: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
    """Gives every agent the memory of the one before it, without effect on its present action."""
    heard = network.layer(x, edges)
    return heard + torch.tanh(state), state.view(-1, N, 4).roll(1, dims=1).view(-1, 4) + heard


def averages(network: Recurrent, x: Tensor, edges: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
    """Averages memories over the rows of all teams."""
    heard = network.layer(x, edges)
    return heard + state, heard + state.mean(dim=0)


def meets(network: Recurrent, x: Tensor, edges: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
    heard = network.layer(x, edges)
    return heard + team_attention(state), torch.tanh(heard)


def counts(network: Recurrent, x: Tensor, edges: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
    network.calls.append(len(x))
    return network.layer(x, edges) + len(network.calls), state


def still(network: Recurrent, x: Tensor, edges: Tensor, state: Any) -> tuple[Tensor, Any]:
    return network.layer(x, edges), state


def raising(n: int) -> Tensor:
    raise RuntimeError("not trained")


REFUSED: dict[str, tuple[Recurrent, str]] = {
    "memories handed round": (Recurrent(rolls), "agent 0 reacts to what others observe"),
    "memories of a batch mixed": (Recurrent(averages), "mixes the graphs of a batch"),
    "dense attention to memories": (Recurrent(meets), "agent 0 reacts to what others observe"),
    "another state beside": (Recurrent(counts), "keeps a state between calls"),
    "no pair": (
        Recurrent(lambda self, x, edges, state: self.layer(x, edges)),
        "did not return an output",
    ),
    "no output": (
        Recurrent(lambda self, x, edges, state: (state[:2], state)),
        "did not return an output",
    ),
    "another width of the output": (
        Recurrent(lambda self, x, edges, state: (self.layer(x, edges)[:, :3], state)),
        r"returned shape \(3, 3\) for 3 agents: return \(3, 4\)",
    ),
    "another width of the state": (
        Recurrent(lambda self, x, edges, state: (self.layer(x, edges), state[:, :2])),
        r"step of Recurrent returned a state of widths \[2\], but initial_state of \[4\]",
    ),
    "no state": (
        Recurrent(lambda self, x, edges, state: (self.layer(x, edges), None)),
        "returned a NoneType as",
    ),
    "infinite in time": (
        Recurrent(lambda self, x, edges, state: (self.layer(x, edges) + state, state + torch.inf)),
        "returned NaN or infinity",
    ),
    "random at the start": (
        Recurrent(still, lambda n: torch.rand(n, 4)),
        "draws random numbers in initial_state",
    ),
    "integers": (
        Recurrent(still, lambda n: torch.zeros(n, 4, dtype=torch.int64)),
        r"returned \(3, 4\) of torch.int64",
    ),
    "layers first": (
        Recurrent(still, lambda n: torch.zeros(1, n, 4)),
        r"returned \(1, 3, 4\) of torch.float32",
    ),
    "stops at the start": (Recurrent(still, raising), "initial_state of Recurrent failed .* not trained"),
    "takes no state": (
        Recurrent(lambda self, x, edges, state: (self.layer(x, edges), state.cell)),
        r"make its step take \(x \(n, 6\), edge_index \(2, edges\), state\)",
    ),
}


@pytest.mark.parametrize(("network", "said"), REFUSED.values(), ids=REFUSED)
def test_refused_with_the_cause(network: nn.Module, said: str) -> None:
    with pytest.raises(InputError, match=said) as refused:
        opened(network)
    assert "\n" not in str(refused.value)


def test_a_state_may_be_a_tuple() -> None:
    def two(n: int) -> tuple[Tensor, Tensor]:
        return torch.ones(n, 2), torch.zeros(n, 3)

    def step(network: Recurrent, x: Tensor, edges: Tensor, state: Any) -> tuple[Tensor, Any]:
        first, second = state
        assert first.shape[1:] == (2,)
        assert second.shape[1:] == (3,)
        return network.layer(x, edges), (first + 1.0, second + first.sum(dim=1, keepdim=True))

    policy = opened(Recurrent(step, two))
    assert policy.initial_state(2).tolist() == [[1.0, 1.0, 0.0, 0.0, 0.0]] * 2
    x = torch.cat([random_observations(1, 2, 6), policy.initial_state(2)[None]], dim=-1)
    with torch.no_grad():
        assert policy.step(x)[1].tolist() == [[[2.0, 2.0, 2.0, 2.0, 2.0]] * 2]
