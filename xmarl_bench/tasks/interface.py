"""What the harness needs of a task. `xmarl_envs.Task` meets it, and so does `ParallelTask`.

B is the number of episodes that are stepped together, N of agents, D of observation entries.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray
from xmarl_envs import Step


class TeamEpisodes(Protocol):
    """B episodes of one task, stepped together."""

    def reset(self, seeds: Sequence[int], episodes: ArrayLike | None = None) -> NDArray[np.float32]:
        """Begin the given episodes (all by default), one seed each; returns all observations (B, N, D).

        An episode depends on the task, its seed and its actions only.
        """
        ...

    def step(self, action: NDArray[Any], live: NDArray[np.bool_] | None = None) -> Step:
        """Take actions: (B, N, A) in [-1, 1], or (B, N) numbers. live: (B,) episodes to advance."""
        ...


class TeamTask(Protocol):
    """A task for a team of `n_agents` equal agents."""

    @property
    def name(self) -> str: ...
    @property
    def n_agents(self) -> int: ...
    @property
    def obs_dim(self) -> int: ...
    @property
    def observation_names(self) -> tuple[str, ...]: ...  # one per entry of an observation; () if unknown
    @property
    def continuous_actions(self) -> bool: ...
    @property
    def action_width(self) -> int: ...  # numbers that a policy outputs: entries of an action, or actions
    @property
    def default_max_cycles(self) -> int: ...  # steps per episode
    @property
    def has_objects(self) -> bool: ...  # False: agents have nothing to collide with but one another

    def with_actions(self, continuous: bool) -> TeamTask:
        """The task with continuous or with discrete actions. Raises InputError if it has no such actions."""
        ...

    def vector_env(self, n_episodes: int, max_cycles: int | None = None) -> TeamEpisodes:
        """B episodes to step together. max_cycles: steps per episode; None: the task's own number."""
        ...


def random_actions(task: TeamTask, n_episodes: int, rng: np.random.Generator) -> NDArray[Any]:
    """Actions of B teams, uniform: (B, N, A) in [-1, 1], or (B, N) numbers."""
    if task.continuous_actions:
        return rng.uniform(-1, 1, (n_episodes, task.n_agents, task.action_width))
    return rng.integers(task.action_width, size=(n_episodes, task.n_agents))
