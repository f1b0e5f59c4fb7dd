"""Small arrays for tests that compute by hand."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

NO_WALLS: Floats = np.zeros((1, 0, 2))


def row(*points: Sequence[float]) -> Floats:
    """(1, len(points), 2): a batch of one."""
    return np.array([points], dtype=np.float64)


def closest_pair(points: Floats) -> float:
    """(P, 2) -> m."""
    first, second = np.triu_indices(len(points), k=1)
    return float(np.linalg.norm(points[first] - points[second], axis=-1).min())
