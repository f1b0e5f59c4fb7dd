"""Plays seeded episodes and hashes every bit of them: equal hashes mean equal episodes."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from copy import deepcopy
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from xmarl_envs.actions import nearest_actions
from xmarl_envs.task import Task
from xmarl_envs.vector_env import VectorEnv

HELD = 10  # steps for which an agent keeps its action; white noise would hardly move a body


class Pushes:
    """Random actions for each agent of a ParallelEnv, sampled from its action space and held for HELD steps.

    They depend only on the seed and the agent's place in `possible_agents`.
    at_bounds: sample bounded boxes at their bounds.
    """

    def __init__(self, env: Any, seed: int, at_bounds: bool = False) -> None:
        self._spaces: dict[Any, spaces.Space[Any]] = {}
        self._rngs: dict[Any, np.random.Generator] = {}
        for i, agent in enumerate(env.possible_agents):
            # A copy: sampling would advance the environment's own generator inside the space.
            self._spaces[agent] = deepcopy(env.action_space(agent))
            self._spaces[agent].seed(seed + i)
            self._rngs[agent] = np.random.default_rng([seed, i])
        self._at_bounds = at_bounds
        self._actions: dict[Any, Any] = {}
        self._cycle = 0

    def next(self, agents: list[Any]) -> dict[Any, Any]:
        """The actions of the live agents for the next step."""
        if self._cycle % HELD == 0:
            self._actions = {agent: self._draw(agent) for agent in self._spaces}
        self._cycle += 1
        return {agent: self._actions[agent] for agent in agents}

    def _draw(self, agent: Any) -> Any:
        space = self._spaces[agent]
        if self._at_bounds and isinstance(space, spaces.Box) and space.is_bounded():
            high = self._rngs[agent].random(space.shape) < 0.5
            return np.where(high, space.high, space.low).astype(space.dtype)
        return space.sample()


def play_env(env: Any, seed: int, max_steps: int, after_step: Callable[[], object] | None = None) -> str:
    """Play one episode of a ParallelEnv; returns the hash of everything `reset` and `step` return.

    The pushes are the same for every seed, so differences between seeds come from the environment.
    after_step: called after the reset and after each step.
    """
    digest = hashlib.sha256()
    pushes = Pushes(env, seed=0)
    feed(digest, env.reset(seed=seed))
    for _ in range(max_steps):
        if after_step is not None:
            after_step()
        if not env.agents:
            break
        feed(digest, env.step(pushes.next(env.agents)))
    return digest.hexdigest()


def feed(digest: Any, value: Any) -> None:
    """Add numbers, arrays and text to a hash, also in containers; mappings in sorted order of their keys."""
    if isinstance(value, Mapping):
        for key in sorted(value, key=str):
            digest.update(str(key).encode())
            feed(digest, value[key])
    elif isinstance(value, list | tuple):
        for part in value:
            feed(digest, part)
    elif isinstance(value, np.ndarray | np.generic):
        digest.update(f"{value.dtype}{value.shape}".encode() + value.tobytes())
    elif isinstance(value, bool | int | float | str):
        digest.update(repr(value).encode())  # exact, also for floats
    else:  # by type only: the text of an arbitrary object may hold its address
        digest.update(type(value).__name__.encode())


def play_task(task: Task, seed: int) -> str:
    """Play one episode of a task, alone in its batch; returns its hash. See `play`."""
    return play(VectorEnv(task), seed)[0]


def play(env: VectorEnv, seed: int, slot: int = 0, meddling: bool = False) -> tuple[str, int]:
    """Play the episode in `slot` of a batch; returns the hash of all its steps and its number of contacts.

    The team pushes at random and towards the middle of its goals (or away from a landmark, so that the
    episode lasts), which causes contacts with agents and walls.
    meddling: the other slots begin new episodes and drop out at random moments.
    """
    digest = hashlib.sha256()
    rng = np.random.default_rng([seed, 1])
    other_rng = np.random.default_rng([seed, slot, 2])
    others = [k for k in range(env.n_episodes) if k != slot]
    observation = env.reset([seed if k == slot else 1000 + k for k in range(env.n_episodes)])
    digest.update(observation[slot].tobytes())
    meeting = meeting_point(env, slot)
    n_contacts = 0
    while True:
        action = other_rng.uniform(-1, 1, (env.n_episodes, env.task.n_agents, 2))
        pull = meeting - env.state.position[slot]
        action[slot] = 2 * pull + rng.uniform(-1, 1, (env.task.n_agents, 2))
        live = np.ones(env.n_episodes, dtype=np.bool_)
        if meddling and others:
            live[others] = other_rng.random(len(others)) < 0.9
        step = env.step(nearest_actions(env.task, action), live)
        for part in step:
            digest.update(part[slot].tobytes())
        n_contacts += int((step.agent_collision[slot] | step.object_collision[slot]).sum())
        if step.terminated[slot] or step.truncated[slot]:
            return digest.hexdigest(), n_contacts
        if meddling and others and other_rng.random() < 0.05:
            other = int(other_rng.choice(others))
            env.reset([int(other_rng.integers(1000))], [other])


def meeting_point(env: VectorEnv, slot: int) -> NDArray[np.float64]:
    """(2,) m: the point to which the team is pushed."""
    targets = env.state.targets[slot]
    if len(targets) == env.task.n_agents:
        return np.asarray(targets.mean(axis=0))
    return -targets[0] if len(targets) else np.zeros(2)
