"""Mask mass: how much of the graph a mask keeps. Not a score: read it together with FidDelta.

A mask that keeps more often has a higher FidDelta: the mask of ones has mass 1.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def mask_mass(mask: NDArray[np.floating], edges: NDArray[np.bool_] | None = None) -> NDArray[np.float64]:
    """(..., N, N) -> (...): the mean of the mask over all edges, including the agents' own.

    edges: (..., N, N), the edges of the graph, None for all. NaN if the graph has no edge.
    """
    kept = mask.astype(np.float64)
    if edges is None:
        return np.asarray(kept.mean(axis=(-2, -1)))
    count = edges.sum(axis=(-2, -1))
    total = kept.sum(axis=(-2, -1), where=edges)
    return np.asarray(np.divide(total, count, out=np.full(total.shape, np.nan), where=count > 0))
