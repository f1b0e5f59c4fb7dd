"""One Space per episode: an episode repeats bit for bit, whatever the others do."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from xmarl_envs.chamber import Chamber
from xmarl_envs.task import Bools, Floats, Task


class SeparateSpaces:
    """The physics of `World` with one copy per Space."""

    def __init__(self, task: Task, n_episodes: int) -> None:
        self._task = task
        self._chambers: list[Chamber | None] = [None] * n_episodes

    def place(self, episodes: NDArray[np.intp], agents: Floats, walls: Floats) -> None:
        """Begin episodes (E,) with agents (E, N, 2) at rest and walls (E, W, 2).

        Each gets a new Space, so that earlier episodes cannot influence it.
        """
        for row, episode in enumerate(episodes):
            chamber = self._chambers[episode]
            if chamber is None:
                self._chambers[episode] = chamber = Chamber(self._task)
            else:
                chamber.renew()
            chamber.agents[0, :, :2] = agents[row]
            chamber.agents[0, :, 2:] = 0.0
            chamber.walls[0, :, :2] = walls[row]
            chamber.write()

    def step(
        self, position: Floats, velocity: Floats, force: Floats, walls: Floats, live: Bools | None
    ) -> None:
        """Advance position and velocity (B, N, 2), in place, under force (B, N, 2)."""
        for k, chamber in enumerate(self._chambers):
            if chamber is not None and (live is None or live[k]):
                chamber.step(force[k])
                position[k] = chamber.position
                velocity[k] = chamber.velocity
