"""Mask mass: how much of the graph a mask keeps. Not a score, but what FidDelta must be read beside.

Part of many a "better" FidDelta is a mask that keeps more: the mask of ones has mass 1.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def mask_mass(mask: NDArray[np.floating]) -> NDArray[np.float64]:
    """(..., N, N) -> (...): the mean of the mask over all edges, the agents' own among them."""
    return np.asarray(mask.astype(np.float64).mean(axis=(-2, -1)))
