"""One Space per episode: an episode repeats bit for bit, whatever the others do."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from xmarl_envs.slotted_space import SlottedSpace
from xmarl_envs.task import Bools, Floats, Task


class SeparateSpaces:
    """The physics of `World` with one copy per Space.

    Can be copied and pickled. A copy plays every episode again from its beginning, because a pickled Space
    goes on with other contacts.
    """

    def __init__(self, task: Task, n_episodes: int) -> None:
        self._task = task
        self._spaces: list[SlottedSpace | None] = [None] * n_episodes
        self._forces = [bytearray() for _ in range(n_episodes)]  # (steps, N, 2) float64 since `place`

    def place(self, episodes: NDArray[np.intp], agents: Floats, velocity: Floats, walls: Floats) -> None:
        """Begin episodes (E,) with agents (E, N, 2), their velocity (E, N, 2) and walls (E, W, 2).

        Each gets a new Space, so that earlier episodes cannot influence it.
        """
        for row, episode in enumerate(episodes):
            space = self._spaces[episode]
            if space is None:
                self._spaces[episode] = space = SlottedSpace(self._task)
            else:
                space.renew()
            space.agents[0, :, :2] = agents[row]
            space.agents[0, :, 2:] = velocity[row]
            space.walls[0, :, :2] = walls[row]
            space.write()
            self._forces[episode].clear()

    def step(
        self, position: Floats, velocity: Floats, force: Floats, walls: Floats, live: Bools | None
    ) -> None:
        """Advance position and velocity (B, N, 2), in place, under force (B, N, 2)."""
        for k, space in enumerate(self._spaces):
            if space is not None and (live is None or live[k]):
                space.step(force[k])
                self._forces[k] += force[k].tobytes()
                position[k] = space.position
                velocity[k] = space.velocity

    def __getstate__(self) -> dict[str, Any]:
        starts = [None if each is None else (each.agents.copy(), each.walls.copy()) for each in self._spaces]
        return {"task": self._task, "starts": starts, "forces": self._forces}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self._task, self._forces = state["task"], state["forces"]
        self._spaces = []
        for start, forces in zip(state["starts"], self._forces, strict=True):
            space = None
            if start is not None:
                space = SlottedSpace(self._task)
                space.agents[:], space.walls[:] = start
                space.write()
                for force in np.frombuffer(bytes(forces)).reshape(-1, self._task.n_agents, 2):
                    space.step(force)
            self._spaces.append(space)
