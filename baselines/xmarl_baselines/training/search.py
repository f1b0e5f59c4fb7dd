"""What is paid for searching in discovery: the share of the arena that an agent is first to sense.

Without it weak seeds sweep a part of the arena and stand still (baselines/README.md).
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray
from xmarl_envs import BlindDiscovery

POINTS: Final = 16  # along each side of the square of points that stands for the arena


class Search:
    """Which points of the arena each of B teams has sensed in its episode."""

    def __init__(self, task: BlindDiscovery, n_teams: int) -> None:
        line = task.bound * ((2 * np.arange(POINTS) + 1) / POINTS - 1)
        self._points = np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2).astype(np.float32)
        self._reach = np.float32(task.sensing_range**2)
        self._sensed = np.zeros((n_teams, len(self._points)), dtype=np.bool_)

    def begin(self, teams: NDArray[np.integer] | slice) -> None:
        """Forget what these teams sensed: their episodes begin."""
        self._sensed[teams] = False

    def newly_sensed(self, position: NDArray[np.floating]) -> NDArray[np.float32]:
        """(B, N, 2) m -> (B, N): share of the arena that an agent senses, and nobody of its team had sensed.

        Agents that sense a point in the same step all get it.
        """
        place = position.astype(np.float32)
        dx, dy = (place[..., axis, None] - self._points[:, axis] for axis in (0, 1))
        new = (dx * dx + dy * dy <= self._reach) & ~self._sensed[:, None]
        self._sensed |= new.any(axis=1)
        return np.asarray(new.mean(axis=-1, dtype=np.float32))
