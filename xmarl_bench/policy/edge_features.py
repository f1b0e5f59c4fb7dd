"""What a graph layer gets with each edge beside its sender and receiver, computed from their observations."""

from __future__ import annotations

import torch
from torch import Tensor
from torch_geometric.utils import scatter

from xmarl_bench.policy.architecture import EdgeFeatures


def edge_features(record: EdgeFeatures, x: Tensor, edge_index: Tensor) -> Tensor:
    """(n, D) observations, (2, edges) -> (edges, width), see `EdgeFeatures`."""
    sender, receiver = edge_index
    parts = []
    if record.position:
        place = x[:, list(record.position)]
        offset = place[sender] - place[receiver]
        parts += [offset, torch.linalg.vector_norm(offset, dim=1, keepdim=True)]
    if record.velocity:
        velocity = x[:, list(record.velocity)]
        parts.append(velocity[sender] - velocity[receiver])
    features = torch.cat(parts, dim=1)
    if record.own == "zero":
        return features
    other = sender != receiver
    mean = scatter(features[other], receiver[other], dim=0, dim_size=len(x), reduce="mean")
    return torch.where(other[:, None], features, mean[receiver])
