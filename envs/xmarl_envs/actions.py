"""Action spaces, and the conversion of actions to pushes.

A push is (x, y), each in [-1, 1]; times the task's `u_mult` it is a force in newton. Continuous actions are
pushes. Discrete ones, those of a task with `continuous_actions=False`, are numbers, in MPE2's order:

| 0 | 1 | 2 | 3 | 4 |
|---|---|---|---|---|
| nothing | left, (-1, 0) | right, (1, 0) | down, (0, -1) | up, (0, 1) |

B is the number of episodes, N of agents.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from xmarl_envs.task import PUSHES, Task

N_ACTIONS = len(PUSHES)


def action_space(task: Task) -> spaces.Space[Any]:
    """The action space of one agent."""
    if task.continuous_actions:
        return spaces.Box(-1.0, 1.0, (2,), np.float32)
    return spaces.Discrete(N_ACTIONS)


def team_action_space(task: Task) -> spaces.Space[Any]:
    """The action space of a whole team: arrays of `action_shape`."""
    if task.continuous_actions:
        return spaces.Box(-1.0, 1.0, action_shape(task), np.float32)
    return spaces.MultiDiscrete([N_ACTIONS] * task.n_agents)


def action_shape(task: Task) -> tuple[int, ...]:
    """The shape of a team's actions: (N, 2), or (N,) if they are discrete."""
    return (task.n_agents, 2) if task.continuous_actions else (task.n_agents,)


def pushes(task: Task, actions: NDArray[Any]) -> NDArray[Any]:
    """(B, N, 2), or (B, N) if they are discrete -> (B, N, 2) pushes, clipped to [-1, 1].

    Raises ValueError for NaN and infinity, and for discrete actions that are not whole numbers from 0 to 4.
    """
    if not task.continuous_actions:
        whole = np.issubdtype(actions.dtype, np.integer)
        if not whole or actions.min() < 0 or actions.max() >= N_ACTIONS:
            got = f"{actions.min()} to {actions.max()}" if whole else f"numbers of type {actions.dtype}"
            raise ValueError(
                f"actions of {task.name} with continuous_actions=False must be whole numbers from 0 to "
                f"{N_ACTIONS - 1}, got {got}."
            )
        return PUSHES.take(actions, axis=0)
    size = np.abs(actions)
    largest = size.item(size.argmax())  # NaN counts as largest
    if not math.isfinite(largest):
        raise ValueError(f"actions of {task.name} must be finite numbers, got NaN or infinity.")
    return np.clip(actions, -1.0, 1.0) if largest > 1.0 else actions


def nearest_actions(task: Task, wanted: NDArray[np.floating]) -> NDArray[Any]:
    """(..., N, 2) pushes -> the team's nearest actions: the pushes themselves, or numbers."""
    if task.continuous_actions:
        return wanted
    apart = wanted[..., None, :] - PUSHES
    return np.asarray(np.square(apart).sum(axis=-1).argmin(axis=-1))


def random_actions(task: Task, n_episodes: int, rng: np.random.Generator) -> NDArray[Any]:
    """Actions of B teams, uniform over the action space."""
    shape = (n_episodes, *action_shape(task))
    if task.continuous_actions:
        return rng.uniform(-1, 1, shape)
    return rng.integers(N_ACTIONS, size=shape)
