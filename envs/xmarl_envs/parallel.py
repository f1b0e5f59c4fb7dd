"""A task as a PettingZoo ParallelEnv: a vector environment of one episode."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from gymnasium import spaces
from numpy.typing import ArrayLike, NDArray
from pettingzoo import ParallelEnv

from xmarl_envs.actions import action_space
from xmarl_envs.episode_seeds import EpisodeSeeds
from xmarl_envs.scene import Track
from xmarl_envs.task import Task
from xmarl_envs.vector_env import VectorEnv

if TYPE_CHECKING:
    from xmarl_envs.render import Renderer

Array = NDArray[np.float32]


class TaskParallelEnv(ParallelEnv[str, Array, Any]):  # type: ignore[misc]  # no py.typed in pettingzoo
    """One episode of `task` at a time, with PettingZoo's Parallel API.

    Observations are float32 (obs_dim,); actions Box(-1, 1, (2,)), or Discrete(5) where the task has
    `continuous_actions=False` (xmarl_envs.actions); `state()` is all observations in agent order,
    (N * obs_dim,), for centralised critics. Each agent's info holds `at_goal` (discovery: `found`),
    `agent_collision` and `object_collision` of the step just taken; after `reset` it is empty.

    Copies (`copy.deepcopy`, pickle) go on bit for bit as the original does, given the same actions.

    `step` raises ValueError if actions are missing, of another shape, not finite, or no numbers of actions.
    """

    metadata: ClassVar[dict[str, Any]] = {"render_modes": ["human", "rgb_array"], "is_parallelizable": True}

    def __init__(self, task: Task, max_cycles: int | None = None, render_mode: str | None = None) -> None:
        modes = self.metadata["render_modes"]
        if render_mode is not None and render_mode not in modes:
            raise ValueError(f"render_mode must be one of {modes} or None, got {render_mode!r}.")
        self.metadata = {**self.metadata, "name": task.name, "render_fps": 20}  # type: ignore[misc]
        self.task = task
        self.render_mode = render_mode
        self._vector = VectorEnv(task, n_episodes=1, max_cycles=max_cycles)
        self._renderer: Renderer | None = None
        self._track: Track | None = None  # for pictures; None without a render mode
        self._seeds = EpisodeSeeds()
        self.possible_agents = [f"agent_{i}" for i in range(task.n_agents)]
        self.agents: list[str] = []
        box = spaces.Box(-np.inf, np.inf, (task.obs_dim,), np.float32)
        self.observation_spaces = {agent: box for agent in self.possible_agents}
        self.action_spaces = {agent: action_space(task) for agent in self.possible_agents}
        self.state_space = spaces.Box(-np.inf, np.inf, (task.n_agents * task.obs_dim,), np.float32)

    @property
    def max_cycles(self) -> int:
        return self._vector.max_cycles

    @max_cycles.setter
    def max_cycles(self, cycles: int) -> None:  # PettingZoo's parallel_api_test sets it
        self._vector.max_cycles = cycles

    def observation_space(self, agent: str) -> spaces.Space[Any]:
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> spaces.Space[Any]:
        return self.action_spaces[agent]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Array], dict[str, dict[str, Any]]]:
        """Begin an episode. The same seed gives the same episode; without one, a seed is drawn."""
        if seed is not None:
            self._seeds = EpisodeSeeds(seed)
        observation = self._vector.reset([self._seeds.draw()])[0]
        self.agents = list(self.possible_agents)
        if self.render_mode is not None:
            self._track = Track(self._vector.state)
        if self.render_mode == "human":
            self.render()
        # Empty infos: SuperSuit overwrites the infos of the previous episode's last step with them.
        return self._by_agent(observation), {agent: {} for agent in self.agents}

    def step(
        self, actions: dict[str, Any]
    ) -> tuple[
        dict[str, Array], dict[str, float], dict[str, bool], dict[str, bool], dict[str, dict[str, Any]]
    ]:
        if not self.agents:
            return {}, {}, {}, {}, {}
        agents = self.agents
        step = self._vector.step(self._in_order(actions))
        terminated, truncated = bool(step.terminated[0]), bool(step.truncated[0])
        key = self.task.success_key
        (success,), (reward,) = step.success.tolist(), step.reward.tolist()
        (of_agents,), (of_objects,) = step.agent_collision.tolist(), step.object_collision.tolist()
        each = zip(agents, success, of_agents, of_objects, strict=True)
        infos = {
            agent: {key: reached, "agent_collision": touched, "object_collision": hit}
            for agent, reached, touched, hit in each
        }
        result = (
            self._by_agent(step.observation[0]),
            dict(zip(agents, reward, strict=True)),
            dict.fromkeys(agents, terminated),
            dict.fromkeys(agents, truncated),
            infos,
        )
        if terminated or truncated:
            self.agents = []
        if self._track is not None:
            self._track.add(self._vector.state, step)
        if self.render_mode == "human":
            self.render()
        return result

    def state(self) -> Array:
        return np.asarray(self._vector.observe()[0].reshape(-1))

    def render(self, mask: ArrayLike | None = None) -> NDArray[np.uint8] | None:
        """(H, W, 3) uint8 with render_mode="rgb_array"; draws in a window with "human".

        mask: (N, N) in [0, 1], an explanation to draw over the team: `mask[i, j]` is the message from j to i.
        Raises ValueError without a render mode, before the first `reset`, and if the mask is invalid.
        """
        if self.render_mode is None:
            raise ValueError(
                'nothing to render: make the environment with render_mode="human" or "rgb_array".'
            )
        if self._track is None:
            raise ValueError("nothing to render yet: call reset first.")
        if self._renderer is None:
            # Imported lazily: pygame is slow to import and prints a greeting.
            from xmarl_envs.render import Renderer

            self._renderer = Renderer(self.task, window=self.render_mode == "human")
        return self._renderer.draw(self._track.scene(), mask)

    def close(self) -> None:
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None

    def __getstate__(self) -> dict[str, Any]:
        """Everything but the window: a copy opens its own."""
        return {**self.__dict__, "_renderer": None}

    def _in_order(self, actions: dict[str, Any]) -> NDArray[Any]:
        """(1, N, 2) or (1, N): the agents' actions. Raises ValueError that names the first invalid one."""
        dtype = np.float64 if self.task.continuous_actions else None
        try:
            action = np.array([[actions[agent] for agent in self.agents]], dtype)
        except (KeyError, ValueError):
            action = np.empty(0)  # missing or of different shapes: reported below
        expected = self._vector.action_shape
        if action.shape != expected:
            missing = [agent for agent in self.agents if agent not in actions]
            if missing:
                raise ValueError(
                    f"every live agent needs an action, none was given for {', '.join(missing)}."
                )
            for agent in self.agents:
                shape = np.asarray(actions[agent], dtype).shape
                if shape != expected[2:]:
                    raise ValueError(f"the action of {agent} must have shape {expected[2:]}, got {shape}.")
        return action

    def _by_agent(self, observation: Array) -> dict[str, Array]:
        return {agent: observation[i] for i, agent in enumerate(self.possible_agents)}


def task_of(source: Task | TaskParallelEnv, max_cycles: int | None) -> tuple[Task, int | None]:
    """The task, and max_cycles: those of `parallel_env(...)` by default.

    Raises TypeError for anything else, such as a wrapped environment, whose wrappers would have no effect,
    and ValueError if `parallel_env(...)` has a render mode, which would have none.
    """
    if isinstance(source, TaskParallelEnv):
        if source.render_mode is not None:
            raise ValueError(
                f"a vector environment draws nothing, got render_mode={source.render_mode!r}: make "
                f"parallel_env(...) without it."
            )
        return source.task, source.max_cycles if max_cycles is None else max_cycles
    if not isinstance(source, Task):
        raise TypeError(
            f"a vector environment takes a task or parallel_env(...), got {type(source).__name__}: give one "
            f"of these, without wrappers."
        )
    return source, max_cycles
