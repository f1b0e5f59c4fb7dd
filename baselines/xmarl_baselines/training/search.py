"""How much of the arena agents sense for the first time: what is paid for searching in discovery.

Without it a team is paid for a landmark only, and learns to sweep the part in which most are found.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray
from xmarl_envs import BlindDiscovery
from xmarl_envs.task import Floats

SPACING: Final = 0.125  # m between the points at which the arena is measured


class Search:
    """Which points of the arena each of B teams has sensed in its episode."""

    def __init__(self, task: BlindDiscovery, n_teams: int) -> None:
        points = round(2 * task.bound / SPACING)
        line = task.bound * ((2 * np.arange(points) + 1) / points - 1)
        self._points = np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2).astype(np.float32)
        self._reach = np.float32(task.sensing_range**2)
        self._sensed = np.zeros((n_teams, len(self._points)), dtype=np.bool_)

    def begin(self, teams: NDArray[np.integer] | slice) -> None:
        """Episodes of these teams begin."""
        self._sensed[teams] = False

    def newly_sensed(self, position: Floats) -> NDArray[np.float32]:
        """(B, N, 2) m -> (B, N): share of the arena that each agent senses, and nobody of its team had.

        Agents that sense a point at the same time all get it.
        """
        place = position.astype(np.float32)
        dx, dy = (place[..., axis, None] - self._points[:, axis] for axis in (0, 1))
        new = (dx * dx + dy * dy <= self._reach) & ~self._sensed[:, None]
        self._sensed |= new.any(axis=1)
        return np.asarray(new.mean(axis=-1, dtype=np.float32))
