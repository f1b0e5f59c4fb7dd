"""Makes masks of importances of nodes: [s, i, j] is then how much agent j matters, to every receiver i.

S is the number of timesteps, N agents.
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch_geometric.explain import Explanation

from xmarl_bench.errors import InputError


def as_edge_masks(
    name: str, returned: object, mask_shape: tuple[int, ...], declared: bool | None = None
) -> object:
    """What an explainer returned as a mask, if it is importances of nodes or explanations; else unchanged.

    returned: importances (S, N), or (N,) of one timestep; an `Explanation` of torch_geometric for one
        timestep, or a list with one for each timestep; anything else.
    mask_shape: (S, N, N), or (N, N) where one timestep is explained.
    declared: whether tensors are importances of nodes; None: not declared, so their shape tells. An (S, N)
        that could be the mask of one timestep, because S = N, has to be declared.

    Raises InputError, naming the explainer, for a shape that contradicts the declaration or is ambiguous, and
    for explanations without a mask of edges or nodes.
    """
    n_agents = mask_shape[-1]
    if isinstance(returned, Explanation):
        if len(mask_shape) == 3:
            raise InputError(
                f"explainer {name!r} returned one Explanation for {mask_shape[0]} timesteps: declare "
                f"batched = False, or return a list with one for each timestep."
            )
        return mask_of_explanation(name, returned, n_agents)
    if isinstance(returned, list | tuple) and any(isinstance(each, Explanation) for each in returned):
        return torch.stack([mask_of_explanation(name, each, n_agents) for each in returned])
    if not isinstance(returned, Tensor):
        return returned
    shape, node_shape = tuple(returned.shape), mask_shape[:-1]
    if declared and shape != node_shape:
        raise InputError(
            f"explainer {name!r} declares node_importance but returned shape {shape}: return {node_shape}, "
            f"or leave the declaration out."
        )
    if shape != node_shape or declared is False:
        return returned
    if declared is None and len(shape) == 2 and shape == mask_shape[1:]:
        raise InputError(
            f"explainer {name!r} returned shape {shape} for {shape[0]} timesteps of {shape[0]} agents, which "
            f"could be the mask of one timestep: declare node_importance = True, or return {mask_shape}."
        )
    return returned[..., None, :].expand(mask_shape)


def mask_of_explanation(name: str, explanation: Explanation, n_agents: int) -> Tensor:
    """(N, N): the edge mask of an explanation, 0 where there is no edge; without one, its node mask.

    A node mask with a column for each feature counts by its mean. Raises InputError if there is neither.
    """
    edges, nodes = explanation.get("edge_mask"), explanation.get("node_mask")
    if edges is not None:
        sender, receiver = explanation.edge_index
        matrix: Tensor = edges.new_zeros(n_agents, n_agents)
        matrix[receiver, sender] = edges.detach()
        return matrix
    if nodes is None or len(nodes) != n_agents:
        got = "no mask" if nodes is None else f"only a node mask of shape {tuple(nodes.shape)}"
        raise InputError(
            f"explainer {name!r} returned an Explanation with {got}: give one with an edge_mask, or with a "
            f"node_mask of {n_agents} rows (node_mask_type='object')."
        )
    importance: Tensor = nodes.detach().float().reshape(n_agents, -1).mean(dim=-1)
    return importance.expand(n_agents, -1)
