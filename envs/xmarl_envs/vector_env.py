"""Many episodes of one task, stepped together. Training and scoring run on `VectorEnv`; the PettingZoo
environment is one with a single episode.
"""

from __future__ import annotations

from collections.abc import Sequence
from operator import index
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from xmarl_envs.actions import action_shape, pushes
from xmarl_envs.task import Bools, Floats, State, Step, Task, distance
from xmarl_envs.world import World, most_cycles


class VectorEnv:
    """B episodes of `task`. The caller resets each of them.

    With one copy per Space, copies (`copy.deepcopy`, pickle) go on bit for bit as the original does.

    Args:
        task: the rules, e.g. `BlindNavigation(n_agents=3)`.
        n_episodes: B.
        max_cycles: steps until truncation; the task's own number by default.
        copies_per_space: 1 (own physics for each episode, repeats bit for bit) or more (faster: training).
    """

    def __init__(
        self, task: Task, n_episodes: int = 1, max_cycles: int | None = None, copies_per_space: int = 1
    ) -> None:
        self.task = task
        self.n_episodes = n_episodes
        self.max_cycles = task.default_max_cycles if max_cycles is None else index(max_cycles)
        if self.max_cycles < 1:
            raise ValueError(f"max_cycles must be at least 1, got {max_cycles}.")
        if copies_per_space > 1 and self.max_cycles > (most := most_cycles(task)):
            raise ValueError(
                f"episodes of {task.name} with copies_per_space above 1 may have at most {int(most)} cycles, "
                f"in which agents cannot reach another copy, got max_cycles={self.max_cycles}: choose fewer, "
                f"or copies_per_space=1."
            )
        self.world = World(task, n_episodes, copies_per_space)
        self.cycles: NDArray[np.int64] = np.zeros(n_episodes, dtype=np.int64)
        n_agents = task.n_agents
        probe = task.spawn(np.random.default_rng(0))
        self._targets: Floats = np.zeros((n_episodes, *probe.targets.shape))
        self._walls: Floats = np.zeros((n_episodes, *probe.walls.shape))
        # 0-d arrays: numpy takes longer to convert a Python float than to compute a small team.
        self._contact_distance = np.array(2 * task.radius + task.collision_gap)
        self._u_mult, self._one = np.array(task.u_mult), np.array(1)
        self.action_shape = (n_episodes, *action_shape(task))  # of what `step` takes
        self._first, self._second = np.triu_indices(n_agents, k=1)
        pairs = np.arange(self._first.size)
        # (pairs, N): 1 for both agents of a pair; contacts (B, pairs) @ it counts each agent's partners.
        self._incidence: Floats = np.zeros((self._first.size, n_agents))
        self._incidence[pairs, self._first] = 1.0
        self._incidence[pairs, self._second] = 1.0
        # Views, not copies: the next step overwrites positions and velocities.
        self.state = State(self.world.position, self.world.velocity, self._targets, self._walls)

    def reset(self, seeds: Sequence[int], episodes: ArrayLike | None = None) -> NDArray[np.float32]:
        """Begin the given episodes (all by default), one seed each; returns all observations (B, N, D).

        With one copy per Space, an episode depends only on its seed and on the actions taken in it.
        """
        which = np.arange(self.n_episodes) if episodes is None else np.atleast_1d(np.asarray(episodes))
        whole = which.size == 0 or np.issubdtype(which.dtype, np.integer)
        if not whole or (which.size and not 0 <= which.min() <= which.max() < self.n_episodes):
            raise ValueError(
                f"episodes must be whole numbers from 0 to {self.n_episodes - 1}, got {which.tolist()}."
            )
        if len(seeds) != which.size:
            raise ValueError(
                f"each episode needs one seed: got {len(seeds)} seeds for {which.size} episodes."
            )
        if which.size:
            layouts = [self.task.spawn(np.random.default_rng(seed)) for seed in seeds]
            self._targets[which] = [layout.targets for layout in layouts]
            self._walls[which] = [layout.walls for layout in layouts]
            agents = np.array([layout.agents for layout in layouts])
            self.world.place(which, agents, self._walls[which])
            self.cycles[which] = 0
        return self.observe()

    def restart(self, seed: int, position: Floats, velocity: Floats) -> NDArray[np.float32]:
        """Begin all episodes in the middle of the one with this seed; returns all observations (B, N, D).

        position, velocity: (B, N, 2), m and m/s, of the agents. Targets and walls are those of the seed;
        cycles count from here.
        """
        layout = self.task.spawn(np.random.default_rng(seed))
        self._targets[:], self._walls[:] = layout.targets, layout.walls
        self.world.place(np.arange(self.n_episodes), position, self._walls, velocity)
        self.cycles[:] = 0
        return self.observe()

    def observe(self) -> NDArray[np.float32]:
        return self.task.observe(self.state).astype(np.float32)

    def step(self, action: NDArray[Any], live: Bools | None = None) -> Step:
        """Apply actions (B, N, 2), or (B, N) where they are discrete, for one cycle of 0.1 s.

        See xmarl_envs.actions.

        live: (B,) episodes to advance. The others may stay as they are; ignore their results.
        """
        if action.shape != self.action_shape:
            raise ValueError(f"actions must have shape {self.action_shape}, got {action.shape}.")
        push = pushes(self.task, action)
        before = self.world.position.copy()
        close = self.world.step(push * self._u_mult, live)  # float64, whatever dtype the actions have
        self.cycles += self._one
        contacts = np.zeros(before.shape[:2])
        (which,) = close.nonzero()
        if which.size:
            # `take`: indexing is several times slower.
            position = self.world.position.take(which, axis=0)
            apart = distance(position.take(self._first, axis=1), position.take(self._second, axis=1))
            touching = apart <= self._contact_distance
            if np.count_nonzero(touching):
                contacts[which] = touching.astype(np.float64) @ self._incidence
        reward, done, success, object_collision = self.task.judge(before, self.state, contacts)
        truncated = (self.cycles >= self.max_cycles) > done  # and not done
        collision = contacts.astype(np.bool_)
        return Step(self.observe(), reward, done, truncated, success, collision, object_collision)
