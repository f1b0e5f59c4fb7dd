"""The graph on which a policy passes messages, as data and as edges.

Every agent hears itself, by a loop i -> i, unless the graph has no `loops`. Entries of a mask without an edge
in the graph are ignored.

Records are read without torch, which is imported only to make edges of them.

S is the number of timesteps (or any batch), N agents, D observation entries.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

from xmarl_bench.errors import InputError

if TYPE_CHECKING:
    from torch import Tensor

MAX_AGENTS = 1024
Agent = Annotated[int, Field(ge=0, lt=MAX_AGENTS)]


class _Graph(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)

    # Whether every agent hears itself. Not written if True, so that records without this field keep their
    # hash.
    loops: Annotated[bool, Field(exclude_if=lambda loops: loops)] = True


class CompleteGraph(_Graph):
    """Every agent hears every agent."""

    kind: Literal["complete"] = "complete"

    def check(self, n_agents: int, obs_dim: int) -> None:
        """Accepts any team."""

    def adjacency(self, observation: Tensor) -> Tensor:
        """(S, N, D) -> (S, N, N), all True, except loops if the graph has none."""
        import torch

        n_steps, n_agents, _ = observation.shape
        between = ~torch.eye(n_agents, dtype=torch.bool)
        return (between | self.loops).expand(n_steps, -1, -1)


class RadiusGraph(_Graph):
    """An agent hears agents at most `radius` away. The edges change with every timestep."""

    kind: Literal["radius"] = "radius"
    radius: Annotated[float, Field(gt=0)]  # metres
    # The entries of an observation that hold the agent's position.
    position: Annotated[tuple[Annotated[int, Field(ge=0)], ...], Field(min_length=1, max_length=3)] = (0, 1)

    def check(self, n_agents: int, obs_dim: int) -> None:
        """Raise InputError if observations have no such entries."""
        if max(self.position) >= obs_dim:
            raise InputError(
                f"the graph's position is entry {max(self.position)} of an observation of {obs_dim} entries: "
                f"give entries from 0 to {obs_dim - 1}."
            )

    def adjacency(self, observation: Tensor) -> Tensor:
        """(S, N, D) -> (S, N, N): j -> i is an edge if j is at most `radius` away from i."""
        import torch

        position = observation[..., list(self.position)].detach()
        distance = (position[:, :, None] - position[:, None, :]).square().sum(dim=-1).sqrt()
        own = torch.eye(observation.shape[1], dtype=torch.bool)
        return (distance <= self.radius) | own if self.loops else (distance <= self.radius) & ~own


class FixedGraph(_Graph):
    """A given adjacency for teams of one size, the same at every timestep.

    Without `loops` the graph has only the edges given.
    """

    kind: Literal["fixed"] = "fixed"
    n_agents: Annotated[int, Field(ge=1, le=MAX_AGENTS)]
    # (sender, receiver). With `loops`, the edges i -> i may be omitted.
    edges: Annotated[tuple[tuple[Agent, Agent], ...], Field(max_length=65536)]

    def check(self, n_agents: int, obs_dim: int) -> None:
        """Raise InputError for a team of another size, or for an edge of an agent outside the team."""
        if n_agents != self.n_agents:
            raise InputError(
                f"the policy's graph is for {self.n_agents} agents, not for {n_agents}: "
                f"choose a team of {self.n_agents}."
            )
        last = max((agent for edge in self.edges for agent in edge), default=0)
        if last >= n_agents:
            raise InputError(
                f"the policy's graph has an edge of agent {last} in a team of {n_agents}: "
                f"number agents from 0 to {n_agents - 1}."
            )

    def adjacency(self, observation: Tensor) -> Tensor:
        """(S, N, D) -> (S, N, N), the same at every timestep."""
        import torch

        n_steps, n_agents, obs_dim = observation.shape
        self.check(n_agents, obs_dim)
        matrix = torch.eye(n_agents, dtype=torch.bool) & self.loops
        for sender, receiver in self.edges:
            matrix[receiver, sender] = True
        return matrix.expand(n_steps, -1, -1)


Graph = Annotated[CompleteGraph | RadiusGraph | FixedGraph, Field(discriminator="kind")]


def complete_graph(n_agents: int) -> Tensor:
    """(2, N * N) edges of the complete graph with self loops, row-major by receiver.

    Edge number i * N + j is j -> i, so PyG's edge mask reshaped to (N, N) is our mask.
    """
    import torch

    receiver, sender = torch.meshgrid(torch.arange(n_agents), torch.arange(n_agents), indexing="ij")
    return torch.stack([sender.reshape(-1), receiver.reshape(-1)])


def edge_index_of(adjacency: Tensor) -> Tensor:
    """(B, N, N) bool -> (2, E) edges of one block-diagonal graph, ordered as `mask[adjacency]`."""
    import torch

    n_agents = adjacency.shape[-1]
    block, receiver, sender = adjacency.nonzero(as_tuple=True)
    return torch.stack([block * n_agents + sender, block * n_agents + receiver])
