"""The interface of a policy for explainers and metrics, independent of its network.

S is the number of timesteps (or any batch), N agents, D observation entries, A action entries.
Of a policy with memory, the last H observation entries are what the agent remembers at that timestep.
`mask[s, i, j]` scales the message on edge j -> i (sender j, receiver i) in every layer that passes messages.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from xmarl_bench.errors import InputError
from xmarl_bench.policy.distribution import ActionDistribution
from xmarl_bench.policy.edge_weights import checked_weights
from xmarl_bench.policy.graph import CompleteGraph, Graph, complete_graph, edge_index_of


class NoAttentionError(InputError):
    """No layer of the policy has attention."""


class Policy(nn.Module, ABC):
    """A policy shared by all agents of a team, on a graph.

    `GraphPolicy` computes one attention layer on the complete graph in closed form, fast; `ModulePolicy`
    takes any network of torch_geometric layers, on any graph. Both give the same numbers where both apply.
    """

    graph: Graph = CompleteGraph()  # which agents hear which
    continuous_actions: bool = True  # False: it chooses a numbered action, see xmarl_envs.actions
    memory_dim: int = 0  # H, numbers that each agent remembers from one timestep to the next
    row_wise: bool  # whether F_i depends on row i of the mask only, as with a single message-passing layer

    def forward(
        self,
        x: Tensor,
        edge_index: Tensor,
        edge_weight: Tensor | None = None,
        batch: Tensor | None = None,
        *,
        edge_attr: Tensor | None = None,
    ) -> Tensor:
        """(n, D), (2, edges) -> (n, A): F(m) as torch_geometric's models are called.

        edge_weight: (edges,) or (edges, 1), m on each edge, also under the name edge_attr; None: ones.
        batch: (n,) the number of each agent's team, where n agents are several teams. An action depends on
        the agent's own team, so it is only checked. Raises InputError as `checked_weights` does.
        """
        return self.act(x, edge_index, checked_weights(edge_index, len(x), edge_weight, edge_attr, batch))

    @abstractmethod
    def act(self, x: Tensor, edge_index: Tensor, weight: Tensor | None = None) -> Tensor:
        """(n, D), (2, edges) -> (n, A): F(m), by PyG's message passing on any graph.

        weight: (edges,), m on each edge, each of which is listed once; None: ones.
        """

    @abstractmethod
    def prepare(self, observation: Tensor) -> Any:
        """(S, N, D) -> the part of the forward pass that does not depend on the mask, for `decode`."""

    @abstractmethod
    def decode(self, prepared: Any, mask: Tensor | None = None) -> ActionDistribution:
        """F(m). mask: (..., S, N, N) in [0, 1], any leading axes; None: the mask of ones.

        Entries without an edge in the graph are ignored.
        """

    @abstractmethod
    def attention(self, observation: Tensor) -> Tensor:
        """(S, N, D) -> (S, N, N): the mean of the coefficients over heads and layers.

        Rows sum to 1 if a layer's coefficients do; those of gates do not. 0 where the graph has no edge, so a
        receiver without edges has a row of zeros. Raises NoAttentionError if no layer has attention.
        """

    def why_no_attention(self, observation: Tensor) -> str | None:
        """(S, N, D) -> why `attention` has no answer; None if it has one."""
        try:
            self.attention(observation)
        except NoAttentionError as error:
            return str(error)
        return None

    def adjacency(self, observation: Tensor) -> Tensor | None:
        """(S, N, D) -> (S, N, N) bool, [s, i, j] for the edge j -> i; None: the complete graph with loops."""
        return None if self.graph == CompleteGraph() else self.graph.adjacency(observation)

    def edges(self, x: Tensor) -> Tensor:
        """(N, D) observations of one team -> (2, edges) of the graph, in the order of our mask."""
        adjacency = self.adjacency(x[None])
        return complete_graph(len(x)) if adjacency is None else edge_index_of(adjacency)

    def layer_edges(self, x: Tensor) -> Tensor:
        """(N, D) -> (2, edges): `edges` in the order in which the network's layers receive them.

        torch_geometric's explainers identify edges by position: entry k of their masks scales message k.
        """
        return self.edges(x)

    def distribution(self, observation: Tensor, mask: Tensor | None = None) -> ActionDistribution:
        """(S, N, D) observations -> the action distributions under the mask."""
        return self.decode(self.prepare(observation), mask)

    def initial_state(self, n_agents: int) -> Tensor:
        """(N, H): what agents remember at the first timestep of an episode."""
        return torch.zeros(n_agents, self.memory_dim)

    def step(self, observation: Tensor, mask: Tensor | None = None) -> tuple[ActionDistribution, Tensor]:
        """(S, N, D) -> F(m), and (S, N, H): what agents remember at the next timestep, had they acted so."""
        if self.memory_dim:
            raise NotImplementedError(f"{type(self).__name__} answers for single timesteps only")
        return self.distribution(observation, mask), observation[..., :0]


def existing_edges(policy: Policy, observation: Tensor) -> NDArray[np.bool_] | None:
    """`Policy.adjacency` as an array, for the metrics."""
    adjacency = policy.adjacency(observation)
    return None if adjacency is None else np.asarray(adjacency.numpy())
