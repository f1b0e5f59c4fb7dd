"""Do two masks rank the senders alike? Used between seeds, and between a policy and one of random weights.

Spearman's correlation of the senders' ranks within each receiver's row (ties share their mean rank), pooled
over receivers and timesteps as a ratio of sums: a row that ranks nothing weighs nothing, instead of making
the whole undefined.

Sources: Adebayo et al., "Sanity Checks for Saliency Maps" (NeurIPS 2018), for the comparison with randomised
weights; Agarwal et al. (GraphXAI, 2023) for stability.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def rank_correlation(
    one: NDArray[np.floating], other: NDArray[np.floating], edges: NDArray[np.bool_] | None = None
) -> float:
    """Two arrays (..., N) of rows to [-1, 1]; NaN where either ranks nothing in any row, or holds NaN.

    edges: (..., N), which senders there are, None for all: the others have no rank.
    """
    if np.isnan(one).any() or np.isnan(other).any():
        return float("nan")
    a, b = (_centred_ranks(x, edges) for x in (one, other))
    scale = np.sqrt((a * a).sum() * (b * b).sum())
    return float((a * b).sum() / scale) if scale > 0 else float("nan")


def _centred_ranks(x: NDArray[np.floating], edges: NDArray[np.bool_] | None) -> NDArray[np.float64]:
    """(..., N): rank less the mean rank of the row, 0 for senders that are not there."""
    from scipy.stats import rankdata  # a second to import, and most that import metrics rank nothing

    if edges is None:
        return np.asarray(rankdata(x, axis=-1) - (x.shape[-1] + 1) / 2)
    ranks = rankdata(np.where(edges, x, np.inf), axis=-1)  # absent ones come last
    return np.where(edges, ranks - (edges.sum(axis=-1, keepdims=True) + 1) / 2, 0.0)
