"""A task as a stable-baselines3 VecEnv with one entry per team, not per agent.

Observations (B, N, D), actions (B, N, 2) and rewards (B, N). SB3's VecMonitor does not take rewards per
agent, so this class itself puts `episode`, `truncated_observation` and `TimeLimit.truncated` into the infos.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from xmarl_envs import BlindDiscovery, Task, VectorEnv
from xmarl_envs.sb3_vec_env import OneObjectVecEnv

from xmarl_baselines.training.search import Search
from xmarl_baselines.training.shaping import Shaping, training_reward


class TeamVecEnv(OneObjectVecEnv):
    """`n_envs` teams with auto-reset. Copies share pymunk Spaces: fast, and equal up to rounding.

    Every info of an ended episode holds `episode`: r, the task's own return, mean over agents; l, its length;
    `is_success`, the fraction of agents at goal, which the info holds, too; `no_agent_collision`.
    """

    def __init__(
        self,
        task: Task,
        n_envs: int,
        *,
        seed: int,
        shaping: Shaping | None = None,
        max_cycles: int | None = None,
        copies_per_space: int = 64,
    ) -> None:
        observation_space = spaces.Box(-np.inf, np.inf, (task.n_agents, task.obs_dim), np.float32)
        action_space = spaces.Box(-1.0, 1.0, (task.n_agents, 2), np.float32)
        super().__init__([1] * n_envs, observation_space, action_space)
        self.task = task
        self.shaping = shaping or Shaping()
        self.caution = 1.0  # multiplies the penalties for touching and for being near
        self._env = VectorEnv(task, n_envs, max_cycles, copies_per_space)
        self._rng = np.random.default_rng(seed)
        self._actions: NDArray[np.float32] = np.zeros((n_envs, task.n_agents, 2), np.float32)
        self._search: Search | None = None
        if isinstance(task, BlindDiscovery) and self.shaping.search_reward:
            self._search = Search(task, n_envs)
        self._return = np.zeros(n_envs)
        self._collided = np.zeros(n_envs, dtype=bool)

    def reset(self) -> NDArray[np.float32]:
        observation = self._env.reset(training_seeds(self._rng, self.num_envs))
        # First episodes start at random cycles, so that they are not all truncated at once.
        self._env.cycles[:] = self._rng.integers(0, self._env.max_cycles, self.num_envs)
        self._begin(slice(None))
        return observation

    def step_wait(
        self,
    ) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.bool_], list[dict[str, Any]]]:
        before = self._env.world.position.copy()
        step = self._env.step(self._actions)
        shaping = self.shaping.with_caution(self.caution)
        reward = training_reward(self.task, shaping, before, self._env.state, step).astype(np.float32)
        if self._search is not None:
            searching = np.float32(shaping.scale * shaping.search_reward)
            reward += searching * self._search.newly_sensed(self._env.state.position)
        self._return += step.reward.mean(axis=-1)
        self._collided |= step.agent_collision.any(axis=-1)
        done = step.terminated | step.truncated
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        ended = np.flatnonzero(done)
        observation = step.observation
        for k in ended:
            success = float(step.success[k].mean())
            infos[k] = {
                "episode": {
                    "r": float(self._return[k]),
                    "l": int(self._env.cycles[k]),
                    "is_success": success,
                    "no_agent_collision": float(not self._collided[k]),
                },
                "is_success": success,
                "truncated_observation": step.observation[k],
                "TimeLimit.truncated": bool(step.truncated[k]),
            }  # fmt: skip
        if ended.size:
            observation = self._env.reset(training_seeds(self._rng, ended.size), ended)
            self._begin(ended)
        return observation, reward, done, infos

    def _begin(self, teams: NDArray[np.integer] | slice) -> None:
        self._return[teams] = 0.0
        self._collided[teams] = False
        if self._search is not None:
            self._search.begin(teams)


def training_seeds(rng: np.random.Generator, n: int) -> list[int]:
    """Seeds of n training episodes, below 2**31; those of validation and scoring are larger."""
    return [int(seed) for seed in rng.integers(0, 2**31, n)]
