"""A PettingZoo ParallelEnv as a task: one environment for each episode, made anew.

The agents must be equal: the same observation space, a Box of one dimension, and the same action space, a
bounded Box of one dimension or a Discrete. All of them play to the end of the episode. Policies act in
[-1, 1], which is scaled to the Box.

Success is what an agent's info says when the episode ends, under the first of SUCCESS_KEYS that it has.
Collisions are what infos say at any step. What infos do not say is not measured.
"""

from __future__ import annotations

import weakref
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, suppress
from dataclasses import dataclass, field
from typing import Any, Final, TypeAlias

import numpy as np
from gymnasium import spaces
from numpy.typing import ArrayLike, NDArray
from xmarl_envs import Step

from xmarl_bench.errors import InputError, failures_named

SUCCESS_KEYS: Final = ("at_goal", "found", "is_success")
AGENT_COLLISION, OBJECT_COLLISION = "agent_collision", "object_collision"
Parallel: TypeAlias = Any  # a pettingzoo.ParallelEnv, which has no types


@dataclass(frozen=True)
class ParallelTask:
    """A `TeamTask` of any environment. `parallel_task` makes it, and checks the environment.

    make_env: makes a new environment for a team of that size.
    """

    name: str
    n_agents: int
    make_env: Callable[[int], Parallel] = field(repr=False)
    obs_dim: int
    action_space: spaces.Box | spaces.Discrete = field(compare=False)
    default_max_cycles: int
    env_class: type = field(compare=False)  # of the innermost environment
    observation_names: tuple[str, ...] = ()
    has_objects: bool = True  # the infos decide

    @property
    def continuous_actions(self) -> bool:
        return isinstance(self.action_space, spaces.Box)

    @property
    def action_width(self) -> int:
        """Entries of an action, or the number of actions."""
        space = self.action_space
        return int(space.n) if isinstance(space, spaces.Discrete) else int(space.shape[0])

    def with_actions(self, continuous: bool) -> ParallelTask:
        """The task itself. Raises InputError if its actions are of the other kind."""
        if continuous != self.continuous_actions:
            ours, theirs = (
                ("continuous", "discrete") if self.continuous_actions else ("discrete", "continuous")
            )
            raise InputError(
                f"task {self.name!r} takes {ours} actions and the policy chooses {theirs} ones: choose a "
                f"policy trained for it, or make the environment with {theirs} actions."
            )
        return self

    def vector_env(self, n_episodes: int, max_cycles: int | None = None) -> ParallelEpisodes:
        """B episodes, each in an environment of its own."""
        return ParallelEpisodes(
            self, n_episodes, self.default_max_cycles if max_cycles is None else max_cycles
        )

    def env_action(self, action: NDArray[Any]) -> Any:
        """One agent's action, an entry of [-1, 1] or a number, as its environment takes it."""
        space = self.action_space
        if isinstance(space, spaces.Discrete):
            return int(space.start) + int(action)
        low, high = space.low, space.high
        scaled = (low + high) / 2 + (high - low) / 2 * np.clip(action, -1.0, 1.0)
        return np.clip(scaled, low, high).astype(space.dtype)

    def of_team(self, observations: Mapping[str, Any], agents: Sequence[str]) -> NDArray[np.float32]:
        """(N, D). Raises InputError if an agent's observation is missing, of another shape or not finite."""
        rows = np.zeros((len(agents), self.obs_dim), dtype=np.float32)
        for row, agent in zip(rows, agents, strict=True):
            seen = np.asarray(observations.get(agent, ()), dtype=np.float32)
            if seen.shape != row.shape or not np.isfinite(seen).all():
                what = "NaN or infinity" if seen.shape == row.shape else f"shape {seen.shape}"
                raise InputError(
                    f"task {self.name!r} gave {agent} an observation with {what}: make it return "
                    f"{self.obs_dim} finite numbers for each agent at every step."
                )
            row[:] = seen
        return rows


class ParallelEpisodes:
    """See `TeamEpisodes`."""

    def __init__(self, task: ParallelTask, n_episodes: int, max_cycles: int) -> None:
        self.task = task
        self.max_cycles = max_cycles
        self.envs: list[Parallel | None] = [None] * n_episodes
        weakref.finalize(self, _close_all, self.envs)
        self._cycles = [0] * n_episodes
        self._observation = np.zeros((n_episodes, task.n_agents, task.obs_dim), dtype=np.float32)

    def reset(self, seeds: Sequence[int], episodes: ArrayLike | None = None) -> NDArray[np.float32]:
        """Begin episodes in new environments. Raises InputError if an environment fails."""
        which = range(len(self.envs)) if episodes is None else np.atleast_1d(np.asarray(episodes)).tolist()
        for k, seed in zip(which, seeds, strict=True):
            self._close(k)
            with foreign_code(self.task.name, f"reset(seed={seed})"):
                self.envs[k] = env = self.task.make_env(self.task.n_agents)
                observations, _ = env.reset(seed=int(seed))
                self._observation[k] = self.task.of_team(observations, env.possible_agents)
            self._cycles[k] = 0
        return self._observation.copy()

    def picture(self, episode: int) -> NDArray[np.uint8] | None:
        """(H, W, 3), what the environment draws; None if it was not made with render_mode="rgb_array"."""
        env = self.envs[episode]
        if env is None or getattr(env, "render_mode", None) != "rgb_array":
            return None
        with foreign_code(self.task.name, "render"):
            return np.asarray(env.render(), dtype=np.uint8)

    def step(self, action: NDArray[Any], live: NDArray[np.bool_] | None = None) -> Step:
        """Step the live episodes. Raises InputError if an environment fails or an agent leaves early."""
        n_episodes, n_agents, _ = self._observation.shape
        told = [np.full((n_episodes, n_agents), np.nan) for _ in range(3)]
        success, agent_collision, object_collision = told
        reward = np.zeros((n_episodes, n_agents))
        terminated, truncated = np.zeros(n_episodes, dtype=np.bool_), np.zeros(n_episodes, dtype=np.bool_)
        for k, env in enumerate(self.envs):
            if env is None or not (live is None or live[k]):
                continue
            agents = env.possible_agents
            chosen = {
                agent: self.task.env_action(each) for agent, each in zip(agents, action[k], strict=True)
            }
            with foreign_code(self.task.name, "step"):
                observations, rewards, terminations, truncations, infos = env.step(chosen)
                reward[k] = [float(rewards[agent]) for agent in agents]
                ended = [bool(terminations[agent]) for agent in agents]
                over = [bool(truncations[agent]) for agent in agents]
            self._cycles[k] += 1
            with foreign_code(self.task.name, "what step returns"):
                self._check_together(env, ended, over, self._cycles[k])
                self._observation[k] = self.task.of_team(observations, agents)
                success[k] = _told(infos, agents, SUCCESS_KEYS)
                agent_collision[k] = _told(infos, agents, (AGENT_COLLISION,))
                object_collision[k] = _told(infos, agents, (OBJECT_COLLISION,))
            terminated[k] = all(ended)
            truncated[k] = not terminated[k] and (any(over) or self._cycles[k] >= self.max_cycles)
        return Step(self._observation.copy(), reward, terminated, truncated, *told)

    def _check_together(self, env: Parallel, ended: Sequence[bool], over: Sequence[bool], cycle: int) -> None:
        """Raise InputError if some agents have left, and not all."""
        out = [
            e or o or agent not in env.agents
            for agent, e, o in zip(env.possible_agents, ended, over, strict=True)
        ]
        if any(out) and not all(e or o for e, o in zip(ended, over, strict=True)):
            first = env.possible_agents[out.index(True)]
            raise InputError(
                f"in task {self.task.name!r} {first} left at step {cycle}, before the others: keep every "
                f"agent in the episode until it ends for all."
            )

    def _close(self, k: int) -> None:
        env, self.envs[k] = self.envs[k], None
        if env is not None:
            with foreign_code(self.task.name, "close"):
                env.close()


def _close_all(envs: Sequence[Parallel | None]) -> None:
    """Close the environments of episodes that nobody plays any more."""
    for env in envs:
        with suppress(Exception):
            if env is not None:
                env.close()


def foreign_code(task: str, call: str) -> AbstractContextManager[None]:
    """Raises InputError, with the task's name, for anything that goes wrong in an environment."""
    return failures_named(f"task {task!r} failed in {call}", "correct its environment")


def _told(infos: Mapping[str, Any], agents: Sequence[str], keys: Sequence[str]) -> list[float]:
    """What each agent's info says under the first of the keys that it has; NaN without one."""
    found = []
    for agent in agents:
        info = infos.get(agent) or {}
        key = next((key for key in keys if key in info), None)
        found.append(np.nan if key is None else float(bool(info[key])))
    return found
