"""The entropy of attention: how widely it spreads over senders."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

TOLERANCE: Final = 1e-4  # far above the rounding of a sum of coefficients in float32


def are_shares(attention: NDArray[np.floating]) -> NDArray[np.bool_]:
    """(..., N, N) -> (...): whether every receiver's coefficients sum to 1, or to 0 if it hears nobody.

    Coefficients of gates, or of heads that are added up, do not.
    """
    total = attention.astype(np.float64).sum(axis=-1)
    whole = (np.abs(total - 1.0) < TOLERANCE) | (np.abs(total) < TOLERANCE)
    return np.asarray(whole.all(axis=-1) & (attention >= 0).all(axis=(-2, -1)))


def attention_entropy(attention: NDArray[np.floating]) -> NDArray[np.float64]:
    """(S, N, N) attention -> (S,) entropy in nats, mean over receivers; NaN where rows do not sum to 1.

    0 if every agent attends to one sender only (possibly itself), log N if attention is uniform. H of Kailas
    et al. (ICML 2025), equation 1; 0 log 0 is 0.
    """
    alpha = attention.astype(np.float64)
    terms = -alpha * np.log(np.where(alpha > 0, alpha, 1.0))
    return np.where(are_shares(attention), terms.sum(axis=-1).mean(axis=-1), np.nan)
