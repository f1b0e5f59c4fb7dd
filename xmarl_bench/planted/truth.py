"""How well a mask finds the relevant messages: its ranking against a planted truth.

Both metrics rank the other agents within a receiver's row and average over receivers and timesteps. AUROC
counts ties half. Definitions as in scikit-learn. N is the number of agents, S of timesteps.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from xmarl_bench.metrics import other_senders

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]


def auroc(mask: NDArray[np.floating], relevant: Bools, counted: Bools) -> float:
    """(S, N, N), (S, N, N), (S, N) -> area under the ROC curve: 0.5 for a random ranking, 1 for the truth.

    The probability that a relevant message ranks above an irrelevant one.
    """
    value, matters = _rows(mask, relevant, counted)
    above = np.sign(value[:, :, None] - value[:, None, :]) / 2 + 0.5
    pairs = matters[:, :, None] & ~matters[:, None, :]
    return float(((above * pairs).sum(axis=(1, 2)) / pairs.sum(axis=(1, 2))).mean())


def average_precision(mask: NDArray[np.floating], relevant: Bools, counted: Bools) -> float:
    """(S, N, N), (S, N, N), (S, N) -> mean precision at the relevant messages; 1 for the truth."""
    value, matters = _rows(mask, relevant, counted)
    at_least = value[:, None, :] >= value[:, :, None]  # [row, j, k]: k ranks at least as high as j
    precision = (at_least & matters[:, None, :]).sum(axis=2) / at_least.sum(axis=2)
    return float(((precision * matters).sum(axis=1) / matters.sum(axis=1)).mean())


def _rows(mask: NDArray[np.floating], relevant: Bools, counted: Bools) -> tuple[Floats, Bools]:
    """Values and relevance, each (rows, N - 1), of the receivers counted."""
    value = other_senders(mask.astype(np.float64))[counted]
    return value, other_senders(relevant)[counted]
