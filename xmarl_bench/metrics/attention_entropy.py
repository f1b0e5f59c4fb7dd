"""The entropy of attention: how widely it spreads over senders."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def attention_entropy(attention: NDArray[np.floating]) -> NDArray[np.float64]:
    """(S, N, N) attention, rows sum to 1 -> (S,) entropy in nats, mean over receivers.

    0 if every agent attends to one sender only (possibly itself), log N if attention is uniform. H of Kailas
    et al. (ICML 2025), equation 1; 0 log 0 is 0.
    """
    alpha = attention.astype(np.float64)
    terms = -alpha * np.log(np.where(alpha > 0, alpha, 1.0))
    return np.asarray(terms.sum(axis=-1).mean(axis=-1))
