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
from scipy.stats import rankdata


def rank_correlation(one: NDArray[np.floating], other: NDArray[np.floating]) -> float:
    """Two arrays (..., N) of rows to [-1, 1]; NaN where either ranks nothing in any row, or holds NaN."""
    if np.isnan(one).any() or np.isnan(other).any():
        return float("nan")
    a, b = (rankdata(x, axis=-1) - (x.shape[-1] + 1) / 2 for x in (one, other))
    scale = np.sqrt((a * a).sum() * (b * b).sum())
    return float((a * b).sum() / scale) if scale > 0 else float("nan")
