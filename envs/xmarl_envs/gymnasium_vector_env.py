"""A task as a Gymnasium vector environment with one entry per team.

For algorithms that control a whole team at once. The agents' own rewards are in the infos.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode
from gymnasium.vector import VectorEnv as GymnasiumVectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import ArrayLike, NDArray

from xmarl_envs.actions import team_action_space
from xmarl_envs.episode_seeds import EpisodeSeeds
from xmarl_envs.parallel import TaskParallelEnv, task_of
from xmarl_envs.task import Bools, Floats, Step, Task
from xmarl_envs.vector_env import VectorEnv

Array = NDArray[np.float32]
Infos = dict[str, Any]


class TeamVectorEnv(GymnasiumVectorEnv[Array, NDArray[Any], NDArray[Any]]):
    """`num_envs` teams of N agents, with auto-reset in any of Gymnasium's three modes.

    task: or `parallel_env(...)` of one.

    | | shape | |
    |---|---|---|
    | observations | (num_envs, N, D) float32 | what each agent sees |
    | actions | (num_envs, N, 2) float32 | in [-1, 1] |
    | with `continuous_actions=False` | (num_envs, N) int64 | 0 to 4, see xmarl_envs.actions |
    | rewards | (num_envs,) float64 | the mean over a team's agents |
    | terminations, truncations | (num_envs,) bool | done; max_cycles reached and not done |
    | infos["agent_reward"] | (num_envs, N) float64 | each agent's own reward |
    | infos["at_goal"] (discovery: "found") | (num_envs, N) bool | |
    | infos["agent_collision"], ["object_collision"] | (num_envs, N) bool | in the step just taken |

    As everywhere in Gymnasium, infos["_<key>"] (num_envs,) marks the entries in which `key` is valid. In mode
    SAME_STEP, "final_obs" and "final_info" hold the last observation and infos of episodes that ended. Modes
    and shapes are those of Gymnasium's `SyncVectorEnv` over single teams.

    `reset(seed=s)` begins entry k with seed s + k; a sequence gives each entry its own. An entry plays the
    same episodes as `TaskParallelEnv` after `reset(seed=s + k)` and later `reset()` calls without a seed.
    `reset(options={"reset_mask": mask})` begins only the entries of a (num_envs,) bool mask.

    copies_per_space: with 1, an episode depends only on its seed and actions, bit for bit. With more (64)
    steps are much faster, for training, and agree up to rounding until the first contact. See `VectorEnv`.
    """

    def __init__(
        self,
        task: Task | TaskParallelEnv,
        num_envs: int = 1,
        max_cycles: int | None = None,
        copies_per_space: int = 1,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
    ) -> None:
        task, max_cycles = task_of(task, max_cycles)
        self.task = task
        self.num_envs = num_envs
        self.autoreset_mode = AutoresetMode(autoreset_mode)
        self.metadata = {"name": task.name, "render_modes": [], "autoreset_mode": self.autoreset_mode}
        self.single_observation_space = spaces.Box(-np.inf, np.inf, (task.n_agents, task.obs_dim), np.float32)
        self.single_action_space = team_action_space(task)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._env = VectorEnv(task, num_envs, max_cycles, copies_per_space)
        self._episode_seeds = [EpisodeSeeds() for _ in range(num_envs)]
        self._over: Bools = np.zeros(num_envs, dtype=np.bool_)
        self._begun: Bools = np.zeros(num_envs, dtype=np.bool_)

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Array, Infos]:
        begin = self._reset_mask(options or {})
        if seed is None or isinstance(seed, int | np.integer):
            seed = [None if seed is None else seed + k for k in range(self.num_envs)]
        if len(seed) != self.num_envs:
            raise ValueError(f"each entry needs one seed: got {len(seed)} seeds for {self.num_envs} entries.")
        for k, given in enumerate(seed):
            if begin[k] and given is not None:
                self._episode_seeds[k] = EpisodeSeeds(given)
        return self._begin(begin), {}

    def step(self, actions: ArrayLike) -> tuple[Array, Floats, Bools, Bools, Infos]:
        """Also lists and torch's tensors are actions. Those of entries that reset instead are ignored."""
        if not self._begun.all():
            raise ValueError("no episode is under way: call reset first.")
        if self.autoreset_mode is AutoresetMode.DISABLED and self._over.any():
            raise ValueError(
                f"the episodes of entries {np.flatnonzero(self._over).tolist()} are over: begin new ones "
                f'with reset(options={{"reset_mask": ...}}) before the next step.'
            )
        beginning = self._over.copy()  # these reset instead of stepping; none outside mode NEXT_STEP
        played = ~beginning
        actions = np.asarray(actions)
        if beginning.any() and actions.shape == self._env.action_shape:
            actions = np.where(np.expand_dims(played, tuple(range(1, actions.ndim))), actions, 0)
        step = self._env.step(actions, played)
        terminated, truncated = step.terminated & played, step.truncated & played
        ended = terminated | truncated
        observation = step.observation
        infos: Infos = {}
        reward = np.where(played, step.reward.mean(axis=-1), 0.0)
        if self.autoreset_mode is AutoresetMode.SAME_STEP:
            beginning, played = ended, ~ended
            if ended.any():
                last = np.full(self.num_envs, None, dtype=object)
                for k in np.flatnonzero(ended):
                    last[k] = observation[k].copy()
                infos = {"final_obs": last, "_final_obs": ended, "_final_info": ended}
                infos["final_info"] = self._infos(step, ended)
        if beginning.any():
            observation = self._begin(beginning)
        self._over = ended & ~beginning
        return observation, reward, terminated, truncated, {**infos, **self._infos(step, played)}

    def _begin(self, entries: Bools) -> Array:
        which = np.flatnonzero(entries)
        self._over[which] = False
        self._begun[which] = True
        return self._env.reset([self._episode_seeds[k].draw() for k in which], which)

    def _infos(self, step: Step, entries: Bools) -> Infos:
        """An array and a mask for every key, as in Gymnasium; the array is 0 where the mask is False."""
        if not entries.any():
            return {}
        values = {
            "agent_reward": step.reward,
            self.task.success_key: step.success,
            "agent_collision": step.agent_collision,
            "object_collision": step.object_collision,
        }
        infos: Infos = {}
        for key, value in values.items():
            infos[key] = np.where(entries[:, None], value, np.zeros_like(value))
            infos[f"_{key}"] = entries.copy()
        return infos

    def _reset_mask(self, options: dict[str, Any]) -> Bools:
        mask = options.get("reset_mask")
        if mask is None:
            return np.ones(self.num_envs, dtype=np.bool_)
        if not isinstance(mask, np.ndarray) or mask.dtype != np.bool_ or mask.shape != (self.num_envs,):
            raise ValueError(
                f'options["reset_mask"] must be a boolean array of shape ({self.num_envs},), got {mask!r}.'
            )
        return mask
