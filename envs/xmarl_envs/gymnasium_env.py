"""A task as a Gymnasium environment of one team, for algorithms that control the whole team at once."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from xmarl_envs.actions import team_action_space
from xmarl_envs.parallel import TaskParallelEnv
from xmarl_envs.task import Task

Array = NDArray[np.float32]


class TeamEnv(gymnasium.Env[Array, NDArray[Any]]):
    """One team of N agents. `TeamVectorEnv` plays many at once, faster.

    Observations are (N, D) float32; actions (N, 2) in [-1, 1], or (N,) whole numbers with
    `continuous_actions=False`; the reward is the mean over agents. Infos hold `agent_reward` (N,) float64 and
    the infos of `TaskParallelEnv` as (N,) bool. It plays the same episodes after `reset` with the same seed.
    """

    metadata: dict[str, Any] = {**TaskParallelEnv.metadata, "render_fps": 20}  # noqa: RUF012  # as in Gymnasium

    def __init__(self, task: Task, max_cycles: int | None = None, render_mode: str | None = None) -> None:
        self.task = task
        self.render_mode = render_mode
        self._env = TaskParallelEnv(task, max_cycles, render_mode)
        self.observation_space = spaces.Box(-np.inf, np.inf, (task.n_agents, task.obs_dim), np.float32)
        self.action_space = team_action_space(task)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Array, dict[str, Any]]:
        super().reset(seed=seed)
        return _rows(self._env.reset(seed)[0]), {}

    def step(self, action: NDArray[Any]) -> tuple[Array, float, bool, bool, dict[str, Any]]:
        """Raises ValueError if the episode is over, or the actions are invalid."""
        agents = self._env.agents
        if not agents:
            raise ValueError("no episode is under way: call reset first.")
        actions = np.asarray(action)
        if actions.shape[:1] != (len(agents),):
            raise ValueError(f"a team of {len(agents)} needs as many actions, got shape {actions.shape}.")
        observations, rewards, terminated, truncated, infos = self._env.step(
            dict(zip(agents, actions, strict=True))
        )
        agent_reward = _rows(rewards)
        of_agents = {key: np.array([info[key] for info in infos.values()]) for key in infos[agents[0]]}
        return (
            _rows(observations),
            float(agent_reward.mean()),
            terminated[agents[0]],
            truncated[agents[0]],
            {"agent_reward": agent_reward, **of_agents},
        )

    def render(self) -> NDArray[np.uint8] | None:
        return self._env.render()

    def close(self) -> None:
        self._env.close()


def _rows(by_agent: dict[str, Any]) -> NDArray[Any]:
    return np.array(list(by_agent.values()))
