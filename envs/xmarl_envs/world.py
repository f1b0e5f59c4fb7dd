"""Rigid-body physics of many episodes at once.

With `copies_per_space` 1, which scoring uses, each episode has its own pymunk Space and repeats bit for bit.
With more, which training uses, episodes share Spaces, and only those with contacts are in one: many times
faster. Until its first contact an episode then has the same bits. Afterwards it agrees up to rounding, which
a crowd amplifies, because there the order of contacts matters.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from xmarl_envs.separate_spaces import SeparateSpaces
from xmarl_envs.shared_spaces import SharedSpaces
from xmarl_envs.slotted_space import COPY_SPACING, MOVE, TIME_STEP, TOP_SPEED, VELOCITY_KEPT
from xmarl_envs.task import Bools, Floats, Task

__all__ = ["MOVE", "TIME_STEP", "VELOCITY_KEPT", "World", "most_cycles"]


def most_cycles(task: Task) -> float:
    """The most cycles in a shared Space: in a longer episode agents could meet those of another copy."""
    if task.bound is not None:
        return math.inf
    return float((COPY_SPACING / 2 - task.spawn_half_width) / (TOP_SPEED * task.u_mult * TIME_STEP))


class World:
    """Discs (and walls) of `n_episodes` copies of one task.

    position, velocity: (B, N, 2) float64, m and m/s, in each copy's own frame; refreshed by `step`.
    """

    def __init__(self, task: Task, n_episodes: int, copies_per_space: int = 1) -> None:
        if n_episodes < 1 or copies_per_space < 1:
            raise ValueError(
                f"n_episodes and copies_per_space must be at least 1, got {n_episodes}, {copies_per_space}."
            )
        copies_per_space = min(copies_per_space, n_episodes)
        self.position: Floats = np.zeros((n_episodes, task.n_agents, 2))
        self.velocity: Floats = np.zeros((n_episodes, task.n_agents, 2))
        self._walls: Floats = np.zeros((n_episodes, task.n_walls, 2))
        self._spaces: SeparateSpaces | SharedSpaces
        if copies_per_space == 1:
            self._spaces = SeparateSpaces(task, n_episodes)
        else:
            self._spaces = SharedSpaces(task, n_episodes, copies_per_space)

    def place(
        self, episodes: NDArray[np.intp], agents: Floats, walls: Floats, velocity: Floats | None = None
    ) -> None:
        """Put the agents (E, N, 2) and walls (E, W, 2) of the given episodes.

        velocity: (E, N, 2), of the agents; None is at rest.
        """
        self.position[episodes] = agents
        self.velocity[episodes] = 0.0 if velocity is None else velocity
        self._walls[episodes] = walls
        self._spaces.place(episodes, agents, self.velocity[episodes], walls)

    def step(self, force: Floats, live: Bools | None = None) -> Bools:
        """Advance by TIME_STEP under constant forces (B, N, 2) in newton.

        live: (B,) episodes to advance; the others may stay as they are.

        Returns (B,): False where no two agents are within `collision_gap` of each other.
        """
        return self._spaces.step(self.position, self.velocity, force, self._walls, live)
