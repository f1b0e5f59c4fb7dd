"""Fidelity: does keeping the explanation preserve the action, and does dropping it change the action?

Source: Amara et al. (LoG 2022), as used for actions by Kailas et al. (ICML 2025). With F_i the
deterministic action of agent i and d_i(m) = mean over action entries of |F_i(1) - F_i(m)|; or with F_i the
probabilities of its discrete actions and d_i(m) the total variation distance of F_i(1) and F_i(m):

    Fid- = mean_i d_i(m),    Fid+ = mean_i d_i(1 - m),    FidDelta = Fid+ - Fid-.

Units are those of the action, in [-1, 1]; so Fid- and Fid+ are in [0, 2], and FidDelta in [-2, 2]. For
discrete actions they are in [0, 1], and FidDelta in [-1, 1].
FidDelta alone can be gamed: the mask of ones attains nearly all of it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


class Fidelity(NamedTuple):
    """One number per leading index of the actions."""

    plus: Floats  # (...) how much the action changes without the explanation: higher is better
    minus: Floats  # (...) how much it changes with the explanation alone: lower is better
    delta: Floats  # (...) plus - minus


def prediction_change(
    full: NDArray[np.floating], other: NDArray[np.floating], divisor: int | None = None
) -> Floats:
    """(..., N, A), (..., N, A) -> (..., N): d_i, how far agent i's action changes.

    divisor: of the sum over entries of the absolute change. None is A, for the mean; 2 makes it the total
    variation distance of probabilities.
    """
    change = np.abs(full.astype(np.float64) - other.astype(np.float64)).sum(axis=-1)
    return np.asarray(change / (full.shape[-1] if divisor is None else divisor))


def fidelity(
    full: NDArray[np.floating],
    kept: NDArray[np.floating],
    dropped: NDArray[np.floating],
    divisor: int | None = None,
) -> Fidelity:
    """F(1), F(m) and F(1 - m), each (..., N, A), to the three fidelities, each (...)."""
    plus = prediction_change(full, dropped, divisor).mean(axis=-1)
    minus = prediction_change(full, kept, divisor).mean(axis=-1)
    return Fidelity(np.asarray(plus), np.asarray(minus), np.asarray(plus - minus))
