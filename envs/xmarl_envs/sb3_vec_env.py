"""A task as a stable-baselines3 VecEnv with one entry per agent and scalar rewards.

Any algorithm of stable-baselines3 trains on it unchanged; PPO then is independent PPO with shared parameters
(de Witt et al. 2020, "Is Independent Learning All You Need in the StarCraft Multi-Agent Challenge?").
`AgentVecEnv` needs no other library; `SuperSuitVecEnv` is for those who need SuperSuit's wrappers.

No other file of `xmarl_envs` imports stable-baselines3 or this module.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv
from stable_baselines3.common.vec_env.base_vec_env import VecEnvIndices

from xmarl_envs.actions import action_space
from xmarl_envs.episode_seeds import EpisodeSeeds
from xmarl_envs.parallel import TaskParallelEnv, task_of
from xmarl_envs.task import Task
from xmarl_envs.vector_env import VectorEnv

StepReturn = tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.bool_], list[dict[str, Any]]]


class OneObjectVecEnv(VecEnv):
    """A VecEnv whose entries are rows of one object's arrays and share its attributes and methods."""

    render_mode: str | None = None  # SB3 warns if it is missing

    def __init__(
        self, team_sizes: Sequence[int], observation_space: spaces.Space[Any], action_space: spaces.Space[Any]
    ) -> None:
        """team_sizes: how many entries each team (or copy) has. They come one after another."""
        super().__init__(sum(team_sizes), observation_space, action_space)
        self._team_sizes = team_sizes

    def step_async(self, actions: NDArray[Any]) -> None:
        self._actions = actions

    def close(self) -> None:
        return None

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        return [getattr(self, attr_name) for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:
        setattr(self, attr_name, value)

    def env_method(
        self, method_name: str, *method_args: Any, indices: VecEnvIndices = None, **method_kwargs: Any
    ) -> list[Any]:
        result = getattr(self, method_name)(*method_args, **method_kwargs)
        return [result for _ in self._get_indices(indices)]

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        """Seed the next `reset()`: team k with seed + k. Returns the seed of each entry's team."""
        if seed is None:
            seed = EpisodeSeeds().draw()
        self._seeds = [seed + k for k, n_agents in enumerate(self._team_sizes) for _ in range(n_agents)]
        return self._seeds

    def env_is_wrapped(self, wrapper_class: type[Any], indices: VecEnvIndices = None) -> list[bool]:
        return [False for _ in self._get_indices(indices)]


class AgentVecEnv(OneObjectVecEnv):
    """`n_episodes` teams of N agents with auto-reset, of a task or of `parallel_env(...)`.

    Entry e is agent e % N of team e // N.

    Observations (n_episodes * N, D) float32, actions (n_episodes * N, 2) in [-1, 1], or (n_episodes * N,) of
    0 to 4 where the task has `continuous_actions=False` (xmarl_envs.actions), rewards (n_episodes * N,)
    float32: each agent's own, as the task pays it. A team's agents are done together.

    infos, per entry: `at_goal` (discovery: `found`), `agent_collision` and `object_collision` of the step
    just taken, and `TimeLimit.truncated`; where an episode ended also `terminal_observation` (D,) and
    `is_success`, which SB3 logs. Wrap it in `VecMonitor` for returns and lengths.

    After `seed(s)` (or `PPO(seed=s)`, or `seed=s` here) and a `reset()`, team k plays the same episodes as
    `TaskParallelEnv` after `reset(seed=s + k)` and later `reset()` calls without a seed.

    copies_per_space: with 1, an episode depends only on its seed and actions, bit for bit. With more (64)
    steps are much faster, for training, and agree up to rounding until the first contact. See `VectorEnv`.
    """

    def __init__(
        self,
        task: Task | TaskParallelEnv,
        n_episodes: int = 1,
        *,
        seed: int | None = None,
        max_cycles: int | None = None,
        copies_per_space: int = 1,
    ) -> None:
        task, max_cycles = task_of(task, max_cycles)
        self.task = task
        self._env = VectorEnv(task, n_episodes, max_cycles, copies_per_space)
        self._episode_seeds = [EpisodeSeeds() for _ in range(n_episodes)]
        self._begun = False
        super().__init__(
            [task.n_agents] * n_episodes,
            spaces.Box(-np.inf, np.inf, (task.obs_dim,), np.float32),
            action_space(task),
        )
        if seed is not None:
            self.seed(seed)

    def reset(self) -> NDArray[np.float32]:
        for k, seed in enumerate(self._seeds[:: self.task.n_agents]):
            if seed is not None:
                self._episode_seeds[k] = EpisodeSeeds(seed)
        self._reset_seeds()  # SB3's rule: seeds and options are used once
        self._reset_options()
        self._begun = True
        return self._by_entry(self._env.reset([seeds.draw() for seeds in self._episode_seeds]))

    def step_wait(self) -> StepReturn:
        if not self._begun:
            raise ValueError("no episode is under way: call reset first.")
        n_agents = self.task.n_agents
        step = self._env.step(np.asarray(self._actions).reshape(self._env.action_shape))
        done = step.terminated | step.truncated
        infos: list[dict[str, Any]] = [
            {
                self.task.success_key: success,
                "agent_collision": agent_collision,
                "object_collision": object_collision,
                "TimeLimit.truncated": truncated,
            }
            for success, agent_collision, object_collision, truncated in zip(
                step.success.ravel().tolist(),
                step.agent_collision.ravel().tolist(),
                step.object_collision.ravel().tolist(),
                np.repeat(step.truncated, n_agents).tolist(),
                strict=True,
            )
        ]
        observation = step.observation
        ended = np.flatnonzero(done)
        if ended.size:
            for k in ended:
                for i in range(n_agents):
                    info = infos[k * n_agents + i]
                    info["terminal_observation"] = observation[k, i].copy()
                    info["is_success"] = info[self.task.success_key]
            observation = self._env.reset([self._episode_seeds[k].draw() for k in ended], ended)
        reward = step.reward.astype(np.float32).ravel()
        return self._by_entry(observation), reward, np.repeat(done, n_agents), infos

    def _by_entry(self, observation: NDArray[np.float32]) -> NDArray[np.float32]:
        """(n_episodes, N, D) -> (n_episodes * N, D)"""
        return observation.reshape(self.num_envs, -1)


class SuperSuitVecEnv(OneObjectVecEnv):
    """Makes a VecEnv that stable-baselines3 can seed of SuperSuit's `concat_vec_envs_v1`.

    SuperSuit 3.11's own, `base_class="stable_baselines3"`, raises AttributeError for `seed()`, `reset(seed=)`
    and `PPO(seed=)`, and leaves out `TimeLimit.truncated`, so algorithms treat truncated episodes as
    terminated.

    Args:
        venv: `concat_vec_envs_v1(pettingzoo_env_to_vec_env_v1(env), n)`, in one process (`num_cpus=0`, the
            default): SuperSuit gives several processes the same seeds, so they would play the same episodes.

    Entry e is agent e % N of copy e // N; `seed(s)` seeds copy k with s + k.
    """

    def __init__(self, venv: Any) -> None:
        copies = getattr(venv, "vec_envs", None)
        if copies is None:
            raise ValueError(
                f"SuperSuitVecEnv takes what supersuit.concat_vec_envs_v1 makes with num_cpus=0 and "
                f'base_class="gymnasium", got {type(venv).__name__}.'
            )
        self.venv = venv
        self.render_mode = venv.render_mode
        super().__init__([copy.num_envs for copy in copies], venv.observation_space, venv.action_space)

    def reset(self) -> NDArray[np.float32]:
        observation, infos = self.venv.reset(seed=self._seeds[0])
        self.reset_infos = list(infos)  # SuperSuit's are a list, one per entry
        self._reset_seeds()
        self._reset_options()
        return np.asarray(observation)

    def step_wait(self) -> StepReturn:
        observation, reward, terminated, truncated, infos = self.venv.step(self._actions)
        terminated, truncated = terminated.astype(np.bool_), truncated.astype(np.bool_)
        entries = [
            {**info, "TimeLimit.truncated": bool(over)}
            for info, over in zip(infos, truncated & ~terminated, strict=True)
        ]
        return observation, reward, terminated | truncated, entries

    def close(self) -> None:
        self.venv.close()
