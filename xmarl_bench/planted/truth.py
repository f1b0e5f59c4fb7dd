"""How well a mask finds the messages that matter: ranking quality against a planted truth.

Both are within a receiver's row, over the other agents, ties counted half, and averaged over receivers and
timesteps; scikit-learn's definitions. N is the number of agents, S of timesteps.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from xmarl_bench.metrics import other_senders

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]


def auroc(mask: NDArray[np.floating], relevant: Bools, counted: Bools) -> float:
    """(S, N, N), (S, N, N), (S, N) -> area under the ROC curve: 0.5 is a random ranking, 1 the truth.

    The chance that a message that matters stands above one that does not.
    """
    value, matters = _rows(mask, relevant, counted)
    above = np.sign(value[:, :, None] - value[:, None, :]) / 2 + 0.5
    pairs = matters[:, :, None] & ~matters[:, None, :]
    return float(((above * pairs).sum(axis=(1, 2)) / pairs.sum(axis=(1, 2))).mean())


def average_precision(mask: NDArray[np.floating], relevant: Bools, counted: Bools) -> float:
    """(S, N, N), (S, N, N), (S, N) -> mean precision at the messages that matter; 1 is the truth."""
    value, matters = _rows(mask, relevant, counted)
    at_least = value[:, None, :] >= value[:, :, None]  # [row, j, k]: k stands where j does, or above
    precision = (at_least & matters[:, None, :]).sum(axis=2) / at_least.sum(axis=2)
    return float(((precision * matters).sum(axis=1) / matters.sum(axis=1)).mean())


def _rows(mask: NDArray[np.floating], relevant: Bools, counted: Bools) -> tuple[Floats, Bools]:
    """(rows, N - 1) of the receivers that count."""
    value = other_senders(mask.astype(np.float64))[counted]
    return value, other_senders(relevant)[counted]
