"""Plays episodes of a team that acts by some rule, and measures them."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from xmarl_envs import State, Task, VectorEnv
from xmarl_envs.task import Floats

Act = Callable[[Task, State], Floats]


class Played(NamedTuple):
    """Means over episodes."""

    success: float  # fraction of agents at goal when the episode ends
    touched: float  # fraction of episodes in which an agent touches another or an object


def play(task: Task, act: Act, n_episodes: int, *, copies_per_space: int = 1) -> Played:
    env = VectorEnv(task, n_episodes, copies_per_space=copies_per_space)
    env.reset(range(n_episodes))
    live, success = np.ones(n_episodes, dtype=bool), np.zeros(n_episodes)
    touched = np.zeros(n_episodes, dtype=bool)
    while live.any():
        step = env.step(act(task, env.state), live)
        touched |= live & (step.agent_collision | step.object_collision).any(axis=-1)
        ended = live & (step.terminated | step.truncated)
        success[ended] = step.success[ended].mean(axis=-1)
        live &= ~ended
    return Played(float(success.mean()), float(touched.mean()))


def noisy(act: Callable[..., Floats], noise: float) -> Act:
    """`act` plus normal noise of that standard deviation; each call of `noisy` gives the same noise."""
    rng = np.random.default_rng(0)

    def disturbed(task: Task, state: State) -> Floats:
        action = act(task, state)
        return action + noise * rng.standard_normal(action.shape)

    return disturbed
