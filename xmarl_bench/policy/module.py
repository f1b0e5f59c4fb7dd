"""Policies of any torch_geometric layers: several layers or heads, GATConv, TransformerConv, ...

The generic way to compute F(m): all timesteps and masks become one block-diagonal graph, and every layer
scales the message on each edge, see xmarl_bench.policy.messages. Blocks share no edge, so the gradient with
respect to a timestep's mask depends on that timestep only.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor, nn

from xmarl_bench.errors import InputError
from xmarl_bench.policy.architecture import DistributionKind, ScaleKind, raw_width
from xmarl_bench.policy.attention import attention_on
from xmarl_bench.policy.distribution import ActionDistribution, action_distribution
from xmarl_bench.policy.graph import CompleteGraph, FixedGraph, Graph, complete_graph, edge_index_of
from xmarl_bench.policy.interface import Policy
from xmarl_bench.policy.interventions import random_teams
from xmarl_bench.policy.messages import followed, row_major
from xmarl_bench.policy.opening import Trial
from xmarl_bench.policy.recurrent import initial_state, run


class PreparedGraphs(NamedTuple):
    """Observations and graph: everything after the first layer depends on the mask."""

    observation: Tensor  # (S, N, D)
    adjacency: Tensor | None  # (S, N, N); None: the complete graph


class ModulePolicy(Policy):
    """A policy made of any module `network(x (n, D), edge_index (2, edges)) -> (n, 2A)`.

    The output holds the location of each action's Normal, then its scale before the biased softplus of
    `action_distribution`; for a deterministic policy only the locations, for a categorical one a logit for
    each of `action_dim` actions. Agents may interact in PyG's message-passing layers only, which pass one
    message for each edge of `graph`, in any order. A network with memory declares it as in
    xmarl_bench.policy.recurrent; `obs_dim` does not count the memory.

    n_agents: team size to test the network with; a FixedGraph has its own. Raises InputError for a network
    that masks cannot explain, see xmarl_bench.policy.opening.
    """

    def __init__(
        self,
        network: nn.Module,
        obs_dim: int,
        action_dim: int = 2,
        *,
        distribution: DistributionKind = "tanh_normal",
        scale: ScaleKind = "softplus",
        graph: Graph | None = None,
        n_agents: int = 3,
    ) -> None:
        super().__init__()
        self.network = network
        self.obs_dim, self.action_dim = obs_dim, action_dim
        self.distribution_kind: DistributionKind = distribution
        self.continuous_actions = distribution != "categorical"
        self.scale_kind: ScaleKind = scale
        self.graph = CompleteGraph() if graph is None else graph
        self.eval()
        if isinstance(self.graph, FixedGraph):
            n_agents = self.graph.n_agents
        self.graph.check(n_agents, obs_dim)
        teams = random_teams(2, n_agents, obs_dim).to(next(network.parameters(), torch.empty(0)).dtype)
        self.memory_dim = initial_state(network, n_agents).shape[1]
        self.row_wise = self._check_network(teams) == 1

    def act(self, x: Tensor, edge_index: Tensor, weight: Tensor | None = None) -> Tensor:
        """(n, D), (2, edges) in any order -> (n, A): F(m)."""
        edge_index, weight = row_major(edge_index, len(x), weight)
        with followed(self.network, edge_index, len(x), weight):
            return self._head(run(self.network, x, edge_index))[0].action

    def prepare(self, observation: Tensor) -> PreparedGraphs:
        """(S, N, D) -> the observations and their adjacency."""
        return PreparedGraphs(observation, self.adjacency(observation))

    def decode(self, prepared: PreparedGraphs, mask: Tensor | None = None) -> ActionDistribution:
        """F(m); see `Policy.decode`."""
        return self._answer(prepared, mask)[0]

    def initial_state(self, n_agents: int) -> Tensor:
        """(N, H), as the network declares it."""
        return initial_state(self.network, n_agents)

    def step(self, observation: Tensor, mask: Tensor | None = None) -> tuple[ActionDistribution, Tensor]:
        """(S, N, D) -> F(m), and (S, N, H): what agents remember at the next timestep."""
        return self._answer(self.prepare(observation), mask)

    def _answer(self, prepared: PreparedGraphs, mask: Tensor | None) -> tuple[ActionDistribution, Tensor]:
        observation, adjacency = prepared
        n_agents = observation.shape[-2]
        leading = observation.shape[:-2] if mask is None else mask.shape[:-2]
        shape = torch.broadcast_shapes(leading, observation.shape[:-2])
        x = observation.expand(*shape, n_agents, -1).reshape(math.prod(shape) * n_agents, -1)
        applied = None if mask is None else mask.expand(*shape, n_agents, n_agents)
        if adjacency is None:
            edge_index = block_diagonal(math.prod(shape), n_agents)
            applied = None if applied is None else applied.reshape(-1)
        else:
            there = adjacency.expand(*shape, n_agents, n_agents)
            edge_index = edge_index_of(there.reshape(-1, n_agents, n_agents))
            applied = None if applied is None else applied[there]
        with followed(self.network, edge_index, len(x), applied):
            raw = run(self.network, x, edge_index)
        return self._head(raw.view(*shape, n_agents, -1))

    def attention(self, observation: Tensor) -> Tensor:
        """(S, N, D) -> (S, N, N): the mean of the coefficients over heads and layers.

        See xmarl_bench.policy.attention for how they are read. Raises NoAttentionError if no layer has.
        """
        adjacency = self.adjacency(observation)
        n_steps, n_agents, _ = observation.shape
        there = torch.ones(n_steps, n_agents, n_agents, dtype=torch.bool) if adjacency is None else adjacency
        alpha = attention_on(self.network, observation.flatten(0, 1), edge_index_of(there))
        matrix = alpha.new_zeros(there.shape)
        matrix[there] = alpha
        return matrix

    def layer_edges(self, x: Tensor) -> Tensor:
        """(N, D) -> (2, edges), in the order in which all layers receive them.

        Raises InputError if layers receive them in different orders.
        """
        edge_index = self.edges(x)
        with torch.no_grad(), followed(self.network, edge_index, len(x)) as calls:
            run(self.network, x, edge_index)
        places = calls[0].places
        if not all(torch.equal(call.places, places) for call in calls):
            raise InputError(
                f"the layers of {type(self.network).__name__} receive edges in different orders, and "
                f"torch_geometric's explainers support one order only: choose another explainer."
            )
        return edge_index[:, places]

    def _head(self, raw: Tensor) -> tuple[ActionDistribution, Tensor]:
        """What `run` returns -> the actions, and what is remembered next."""
        output, memory = raw.split([raw.shape[-1] - self.memory_dim, self.memory_dim], dim=-1)
        return action_distribution(output, self.distribution_kind, self.scale_kind), memory

    def _check_network(self, teams: Tensor) -> int:
        """(2, N, D) -> how often the network passes messages. Raises InputError, see `Trial.check`."""
        width = raw_width(self.distribution_kind, self.action_dim)
        holds = {"categorical": "a logit for each", "deterministic": "location"}.get(
            self.distribution_kind, "location and raw scale"
        )
        of_what = "action entries" if self.continuous_actions else "actions"
        adjacency = self.adjacency(teams)
        together = block_diagonal(*teams.shape[:2]) if adjacency is None else edge_index_of(adjacency)
        trial = Trial(self.network, teams, (self.edges(teams[0]), self.edges(teams[1])), together)
        return trial.check(width, f"{holds} of {self.action_dim} {of_what}")


def block_diagonal(n_graphs: int, n_agents: int) -> Tensor:
    """(2, n_graphs * N * N) edges of complete graphs with loops, each in the order of our mask."""
    first = torch.arange(n_graphs)[:, None] * n_agents
    return (complete_graph(n_agents)[:, None] + first).reshape(2, -1)
