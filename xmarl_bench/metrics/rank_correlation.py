"""Do two masks rank the senders alike? Compares seeds, and a policy with one of random weights.

Spearman's correlation of the senders' ranks within each receiver's row (ties share their mean rank), pooled
over receivers and timesteps as a ratio of sums: a row that is constant in both masks has weight 0, instead of
making the whole undefined. One that is constant in one mask lowers the correlation.

Sources: Adebayo et al., "Sanity Checks for Saliency Maps" (NeurIPS 2018), for the comparison with randomised
weights; Agarwal et al. (GraphXAI, 2023) for stability.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

DECIMALS: Final = 6  # of metrics and effects that are ranked: a smaller difference is the rounding of float32


def rank_correlation(
    one: NDArray[np.floating], other: NDArray[np.floating], edges: NDArray[np.bool_] | None = None
) -> float:
    """Two arrays (..., N) of rows -> [-1, 1]; NaN if one of them holds NaN or constant rows only.

    edges: (..., N), the senders that exist, None for all: the others have no rank.
    """
    if np.isnan(one).any() or np.isnan(other).any():
        return float("nan")
    a, b = (_centred_ranks(x, edges) for x in (one, other))
    scale = np.sqrt((a * a).sum() * (b * b).sum())
    return float((a * b).sum() / scale) if scale > 0 else float("nan")


def _centred_ranks(x: NDArray[np.floating], edges: NDArray[np.bool_] | None) -> NDArray[np.float64]:
    """(..., N): rank less the mean rank of the row, ties at their mean; 0 for absent senders.

    That is half of how many senders rank lower, less half of how many rank higher.
    """
    mine, others = x[..., :, None], x[..., None, :]
    ahead = (mine > others).astype(np.int8) - (mine < others)
    if edges is not None:
        ahead *= edges[..., :, None] & edges[..., None, :]
    return np.asarray(ahead.sum(axis=-1) / 2)
