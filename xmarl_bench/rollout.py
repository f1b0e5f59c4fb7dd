"""Deterministic episodes of a policy: what explainers explain, and the task metrics."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from xmarl_envs import Step, Task, VectorEnv

from xmarl_bench.policy import GraphPolicy


@dataclass(frozen=True)
class Episode:
    """One episode: what the team saw at each of its T steps, and how it went.

    Metrics as in Kailas et al. (ICML 2025), appendix "Metrics for Task Performance".
    """

    seed: int
    observations: NDArray[np.float32]  # (T, N, D), before each action
    reward: float  # mean over agents of the return
    success_rate: float  # fraction of agents at goal when the episode ends; discovery: 1 if found
    no_agent_collision: float  # 1 if no two agents collided in the episode
    no_object_collision: float  # 1 if nobody touched a wall
    makespan: int  # steps until done, max_cycles if never


def roll_out(
    task: Task,
    policy: GraphPolicy,
    seeds: Sequence[int],
    *,
    parallel_episodes: int = 50,
    max_cycles: int | None = None,
    mask: Tensor | None = None,
) -> list[Episode]:
    """Play one episode per seed with the deterministic action, in the order of `seeds`.

    mask: (N, N), the team acts on F(mask) throughout; the identity removes all messages between agents.

    Each episode has a pymunk Space and a forward pass of its own: matrix products round differently in
    batches of different size, and an episode may depend on nothing but (task, N, seed, policy). So the
    result is the same, to the bit, whatever `parallel_episodes` is.
    """
    width = min(parallel_episodes, len(seeds))
    if width < 1:
        return []
    env = VectorEnv(task, width, max_cycles)
    playing = list(range(width))  # slot -> which seed it plays; -1 when nothing is left
    observation = env.reset([seeds[k] for k in playing])
    recorders = [_Recorder(seeds[k]) for k in playing]
    finished: dict[int, Episode] = {}
    waiting = iter(range(width, len(seeds)))
    action = np.zeros((width, task.n_agents, 2), dtype=np.float32)
    while len(finished) < len(seeds):
        live = np.array([k >= 0 for k in playing])
        slots = [slot for slot in range(width) if playing[slot] >= 0]
        for slot in slots:
            action[slot] = act(policy, observation[slot], mask)
            recorders[slot].observations.append(observation[slot])
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
    return [finished[k] for k in range(len(seeds))]


@torch.inference_mode()
def act(
    policy: GraphPolicy, observation: NDArray[np.float32], mask: Tensor | None = None
) -> NDArray[np.float32]:
    """(N, D) -> (N, A): the deterministic action of one team at one moment."""
    # A copy, not a view: matrix products also round differently by the alignment of their memory,
    # and torch aligns what it allocates itself.
    x = torch.tensor(observation)[None]
    return np.asarray(policy.distribution(x, mask).action[0].numpy())


class _Recorder:
    def __init__(self, seed: int) -> None:
        self.seed = seed
        self.observations: list[NDArray[np.float32]] = []
        self._return = 0.0
        self._agent_collision = self._object_collision = False

    def add(self, step: Step, slot: int) -> None:
        self._return += float(step.reward[slot].mean())
        self._agent_collision |= bool(step.agent_collision[slot].any())
        self._object_collision |= bool(step.object_collision[slot].any())

    def episode(self, last: Step, slot: int) -> Episode:
        return Episode(
            seed=self.seed,
            observations=np.stack(self.observations),
            reward=self._return,
            success_rate=float(last.success[slot].mean()),
            no_agent_collision=float(not self._agent_collision),
            no_object_collision=float(not self._object_collision),
            makespan=len(self.observations),
        )
