"""Masks in the form of torch_geometric's models: a weight for each edge, and the team of each agent.

Libraries written for such models call `model(x, edge_index, edge_weight=..., batch=...)`.
"""

from __future__ import annotations

import torch
from torch import Tensor

from xmarl_bench.errors import InputError


def checked_weights(
    edge_index: Tensor,
    n_agents: int,
    edge_weight: Tensor | None,
    edge_attr: Tensor | None,
    batch: Tensor | None,
) -> Tensor | None:
    """(edges,): the mask on each edge; None if neither weights nor attributes are given.

    edge_weight or edge_attr: (edges,) or (edges, 1). batch: (n,) the number of each agent's team. Raises
    InputError for other shapes, for both at once, for weights of an edge listed twice, and for an edge
    between two teams.
    """
    if batch is not None:
        _check_batch(edge_index, n_agents, batch)
    if edge_weight is not None and edge_attr is not None:
        raise InputError("the policy got both edge_weight and edge_attr: give the mask as one of them.")
    name, weight = ("edge_weight", edge_weight) if edge_attr is None else ("edge_attr", edge_attr)
    if weight is None:
        return None
    n_edges = edge_index.shape[1]
    if not weight.is_floating_point():
        raise InputError(
            f"{name} has dtype {weight.dtype}: give floating-point numbers, and teams by name, as batch=..."
        )
    if tuple(weight.shape) not in ((n_edges,), (n_edges, 1)):
        raise InputError(
            f"{name} has shape {tuple(weight.shape)} on {n_edges} edges: give one number for each edge, "
            f"({n_edges},) or ({n_edges}, 1)."
        )
    sender, receiver = edge_index
    if len(torch.unique(receiver * n_agents + sender)) < n_edges:
        raise InputError(f"edge_index lists an edge twice, each with its own {name}: list every edge once.")
    return weight.view(n_edges)


def _check_batch(edge_index: Tensor, n_agents: int, batch: Tensor) -> None:
    if tuple(batch.shape) != (n_agents,) or batch.is_floating_point():
        raise InputError(
            f"batch has shape {tuple(batch.shape)} of {batch.dtype} for {n_agents} agents: give the number "
            f"of each agent's team, ({n_agents},) integers."
        )
    sender, receiver = edge_index
    if not torch.equal(batch[sender], batch[receiver]):
        raise InputError("batch puts the ends of an edge into different teams: give edges within teams.")
