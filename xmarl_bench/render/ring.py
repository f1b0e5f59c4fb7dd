"""Where the agents of a task stand in a picture if the task tells no positions: on a ring."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from xmarl_envs import State

RADIUS: Final = 0.9  # m, of the ring


@dataclass(frozen=True)
class Ring:
    """A `Drawable`: N agents on a ring, the first on top, clockwise. What the environment draws is inside."""

    name: str
    n_agents: int
    radius: float = 0.08
    bound: float | None = None
    spawn_half_width: float = 1.0
    wall_size: tuple[float, float] = (0.0, 0.0)

    @property
    def state(self) -> State:
        """The state of one episode, which never changes."""
        angle = np.pi / 2 - 2 * np.pi * np.arange(self.n_agents) / self.n_agents
        position = RADIUS * np.stack([np.cos(angle), np.sin(angle)], axis=-1)[None]
        nothing = np.zeros((1, 0, 2))
        return State(position, np.zeros_like(position), nothing, nothing)
