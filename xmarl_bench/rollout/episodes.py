"""Deterministic episodes of a policy: the observations that explainers explain, and the task metrics."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from xmarl_envs import Step

from xmarl_bench.metrics.table import Group, Need, metrics_of
from xmarl_bench.policy import Policy
from xmarl_bench.policy.teams_apart import step_teams
from xmarl_bench.reproducible import one_thread, torch_defaults
from xmarl_bench.rollout.cell import Cell, check_parallel
from xmarl_bench.tasks.interface import TeamTask

Floats = NDArray[np.float32]


@dataclass(frozen=True)
class Episode:
    """One episode: what the team observed at each of its T steps, and its task metrics.

    Metrics as in Kailas et al. (ICML 2025), appendix "Metrics for Task Performance"; NaN for what the task
    does not tell.
    """

    seed: int
    # (T, N, D + H), before each action: what agents saw and, of a policy with memory, what they remembered
    observations: NDArray[np.float32]
    reward: float  # mean over agents of the return
    success_rate: float  # fraction of agents at goal when the episode ends; discovery: 1 if found
    no_agent_collision: float  # 1 if no two agents collided in the episode
    no_object_collision: float  # 1 if nobody touched a wall
    makespan: int  # steps until done, max_cycles if never


def mean_metrics(task: TeamTask, episodes: Sequence[Episode]) -> dict[str, float | None]:
    """Means of the task metrics over episodes; None for a metric that the task does not have or not tell."""
    means: dict[str, float | None] = {}
    for metric in metrics_of(Group.TASK):
        told = [value for each in episodes if not math.isnan(value := getattr(each, metric.name))]
        measured = told and (task.has_objects or Need.WALLS not in metric.needs)
        means[metric.name] = float(np.mean(told)) if measured else None
    return means


class Act(Protocol):
    """Chooses the actions of a batch of teams."""

    def __call__(self, observation: Floats, slots: Sequence[int], /) -> tuple[NDArray[Any], Floats]:
        """(B, N, D + H) of all slots, the slots still playing -> actions, (B, N, H) what is remembered next.

        Actions are (B, N, 2), or (B, N) numbers. Those of other slots are ignored. H is 0 where nothing is
        remembered.
        """


@torch_defaults()
def roll_out(
    task: TeamTask,
    policy: Policy,
    seeds: Sequence[int],
    *,
    parallel_episodes: int = 50,
    max_cycles: int | None = None,
    mask: Tensor | None = None,
) -> list[Episode]:
    """Play one episode per seed with the deterministic action, in the order of `seeds`.

    Of discrete actions the likeliest is played. The task is played with the actions that the policy chooses.

    mask: (N, N), the team acts on F(mask) throughout; the identity removes all messages between agents.

    Each episode has a physics or an environment of its own, and teams act apart (`policy.teams_apart`). An
    episode depends on (task, N, seed, policy) alone: the result is the same, bit for bit, for any
    `parallel_episodes`. Raises InputError if that is no whole number from 1 on, and for a policy of another
    task.
    """
    check_parallel(parallel_episodes)
    start, choose = initial_state(policy, task.n_agents), chooser(policy, mask)

    def act(observation: Floats, slots: Sequence[int]) -> tuple[NDArray[Any], Floats]:
        chosen = choose(observation[slots])
        action, memory = (np.zeros((len(observation), *part.shape[1:]), part.dtype) for part in chosen)
        action[slots], memory[slots] = chosen
        return action, memory

    return play(
        task.with_actions(policy.continuous_actions),
        act,
        seeds,
        start=start,
        parallel_episodes=parallel_episodes,
        max_cycles=max_cycles,
    )


def play(
    task: TeamTask,
    act: Act,
    seeds: Sequence[int],
    *,
    start: Floats | None = None,
    parallel_episodes: int = 50,
    max_cycles: int | None = None,
) -> list[Episode]:
    """Play one episode per seed with the actions of `act`, in the order of `seeds`.

    start: (N, H), what agents remember before their first step; None is nothing.
    With as many parallel episodes as seeds, slot k plays seed k from its first step to its last.
    """
    width = min(parallel_episodes, len(seeds))
    if width < 1:
        return []
    env = task.vector_env(width, max_cycles)
    playing = list(range(width))  # slot -> index of the seed it plays; -1: no seed is left
    observation = env.reset([seeds[k] for k in playing])
    start = np.zeros((task.n_agents, 0), dtype=np.float32) if start is None else start
    memory = np.repeat(start[None], width, axis=0)
    recorders = [_Recorder(seeds[k]) for k in playing]
    finished: dict[int, Episode] = {}
    waiting = iter(range(width, len(seeds)))
    while len(finished) < len(seeds):
        live = np.array([k >= 0 for k in playing])
        slots = [slot for slot in range(width) if playing[slot] >= 0]
        seen = np.concatenate([observation, memory], axis=-1)
        action, memory = act(seen, slots)
        for slot in slots:
            recorders[slot].observations.append(seen[slot])
        step = env.step(action, live)
        observation = step.observation
        for slot in slots:
            recorders[slot].add(step, slot)
            if step.terminated[slot] or step.truncated[slot]:
                finished[playing[slot]] = recorders[slot].episode(step, slot)
                playing[slot] = next(waiting, -1)
                if playing[slot] >= 0:
                    seed = seeds[playing[slot]]
                    recorders[slot] = _Recorder(seed)
                    observation = env.reset([seed], [slot])
                    memory[slot] = start
    return [finished[k] for k in range(len(seeds))]


def chooser(policy: Policy, mask: Tensor | None = None) -> Callable[[Floats], tuple[NDArray[Any], Floats]]:
    """(B, N, D + H) -> the deterministic actions of B teams, and what they remember next (B, N, H).

    Actions are (B, N, A), or (B, N) numbers. Those of a team do not depend on the other teams.
    """
    step = step_teams(policy)

    @torch.inference_mode()
    def choose(observation: Floats) -> tuple[NDArray[Any], Floats]:
        choice, memory = step(torch.tensor(observation), mask)  # a copy, not a view: torch aligns its memory
        return np.asarray(choice.numpy()), np.asarray(memory.numpy())

    return choose


def initial_state(policy: Policy, n_agents: int) -> Floats:
    """(N, H): what agents remember before their first step."""
    return np.asarray(policy.initial_state(n_agents).float().numpy())


@dataclass(frozen=True)
class Rollout:
    """Episodes to play in parallel in one process: the unit of work of a worker."""

    policy: Policy
    cell: Cell
    seeds: tuple[int, ...]
    max_cycles: int | None
    messages: bool = True  # False: every agent hears itself only
    parallel_episodes: int | None = None  # None: all of them

    def play(self) -> list[Episode]:
        with one_thread():
            return roll_out(
                self.cell.make(),
                self.policy,
                self.seeds,
                parallel_episodes=self.parallel_episodes or max(1, len(self.seeds)),
                max_cycles=self.max_cycles,
                mask=None if self.messages else torch.eye(self.cell.n_agents),
            )


class _Recorder:
    def __init__(self, seed: int) -> None:
        self.seed = seed
        self.observations: list[NDArray[np.float32]] = []
        self._return = 0.0
        self._agent_collision = self._object_collision = 0.0  # 1: there was one; NaN: the task does not tell

    def add(self, step: Step, slot: int) -> None:
        self._return += float(step.reward[slot].mean())
        self._agent_collision = _collided(self._agent_collision, step.agent_collision[slot])
        self._object_collision = _collided(self._object_collision, step.object_collision[slot])

    def episode(self, last: Step, slot: int) -> Episode:
        return Episode(
            seed=self.seed,
            observations=np.stack(self.observations),
            reward=self._return,
            success_rate=float(last.success[slot].mean()),
            no_agent_collision=1.0 - self._agent_collision,
            no_object_collision=1.0 - self._object_collision,
            makespan=len(self.observations),
        )


def _collided(before: float, told: NDArray[Any]) -> float:
    """1 if a collision was told, of anybody at any step so far; else NaN if somebody told nothing, else 0."""
    return 1.0 if before == 1.0 or (told == 1.0).any() else float(np.maximum(before, told.max()))
