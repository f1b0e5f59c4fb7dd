"""The reward that the trainer optimises. Shaping does not change the reward that the task reports."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from xmarl_envs import BlindDiscovery, BlindNavigation, BlindPassage, State, Step, Task
from xmarl_envs.task import Floats, distance


@dataclass(frozen=True)
class Shaping:
    """Changes of a task's reward for training. The defaults change nothing."""

    scale: float = 1.0  # multiplies the whole reward
    agent_penalty: float | None = None  # per colliding partner and step; None: the task's own
    wall_penalty: float | None = None  # per step in contact with a wall; None: the task's own
    proximity_penalty: float = 0.0  # per partner and step, at contact; falls linearly to 0 at proximity_range
    proximity_range: float = 0.0  # m between surfaces
    individual_progress: bool = False  # navigation: each agent is paid for its own distance
    through_gap: bool = False  # passage: distance is measured through the gap, not through the wall
    landmark_progress: float = 0.0  # discovery: per metre nearer to the landmark while anyone senses it
    search_reward: float = 0.0  # discovery: for the whole arena; an agent gets the share it is first to sense
    arrival_bonus: float = 0.0  # to every agent when the team is done
    time_penalty: float = 0.0  # per step to an agent away from its goal

    def with_caution(self, factor: float) -> Shaping:
        """A copy with `agent_penalty` (if it is set) and `proximity_penalty` multiplied by `factor`."""
        agent = None if self.agent_penalty is None else factor * self.agent_penalty
        return replace(self, agent_penalty=agent, proximity_penalty=factor * self.proximity_penalty)


def training_reward(task: Task, shaping: Shaping, before: Floats, state: State, step: Step) -> Floats:
    """(B, N) reward of the step that led from positions `before` (B, N, 2) to `state`.

    `TeamVecEnv` adds `search_reward`, which depends on earlier steps.
    """
    reward = _shaped(task, shaping, before, state, step)
    reward = reward + shaping.arrival_bonus * step.terminated[:, None]
    reward = reward - shaping.time_penalty * ~step.success
    if shaping.proximity_penalty:
        reward = reward - shaping.proximity_penalty * _proximity(task, shaping, state)
    return shaping.scale * reward


def _shaped(task: Task, shaping: Shaping, before: Floats, state: State, step: Step) -> Floats:
    if isinstance(task, BlindNavigation):
        gained = distance(before, state.targets) - distance(state.position, state.targets)
        if not shaping.individual_progress:
            gained = gained.sum(axis=-1, keepdims=True)
        penalty = task.collision_penalty if shaping.agent_penalty is None else shaping.agent_penalty
        arrived = task.all_at_goal_reward * step.terminated[:, None]
        return gained + arrived - penalty * _contacts(task, state)
    penalties = shaping.agent_penalty, shaping.wall_penalty
    if isinstance(task, BlindPassage) and (shaping.through_gap or penalties != (None, None)):
        if shaping.through_gap:
            gained = distance_through_gap(task, before, state) - distance_through_gap(
                task, state.position, state
            )
        else:
            gained = distance(before, state.targets) - distance(state.position, state.targets)
        agent = task.collision_penalty if shaping.agent_penalty is None else shaping.agent_penalty
        wall = task.collision_penalty if shaping.wall_penalty is None else shaping.wall_penalty
        return task.distance_reward * gained - agent * _contacts(task, state) - wall * step.object_collision
    if isinstance(task, BlindDiscovery) and shaping.landmark_progress:
        gained = distance(before, state.targets) - distance(state.position, state.targets)
        sensed = (distance(before, state.targets) <= task.sensing_range).any(axis=-1, keepdims=True)
        return step.reward + shaping.landmark_progress * gained * sensed
    return step.reward


def distance_through_gap(task: BlindPassage, position: Floats, state: State) -> Floats:
    """(B, N, 2) -> (B, N) m: length of the path to the goal through the middle of the gap."""
    # Below the entrance: agents that touch the wall. Above it: agents inside the gap.
    depth = np.array([0.0, task.wall_thickness / 2 + 0.6 * task.radius])
    entrance, leave = task.gap(state) - depth, task.gap(state) + depth
    beyond = distance(leave, state.targets)
    below = distance(position, entrance) + distance(entrance, leave) + beyond
    inside = distance(position, leave) + beyond
    y = position[..., 1]
    way = np.where(
        y < entrance[..., 1], below, np.where(y < leave[..., 1], inside, distance(position, state.targets))
    )
    return np.asarray(way)


def _surface_gaps(task: Task, state: State) -> Floats:
    """(B, N, N) m between surfaces; infinite on the diagonal."""
    gaps = distance(state.position[:, :, None], state.position[:, None, :]) - 2 * task.radius
    gaps[:, np.arange(task.n_agents), np.arange(task.n_agents)] = np.inf
    return gaps


def _contacts(task: Task, state: State) -> Floats:
    return np.asarray((_surface_gaps(task, state) <= task.collision_gap).sum(axis=-1), dtype=np.float64)


def _proximity(task: Task, shaping: Shaping, state: State) -> Floats:
    """(B, N): sum over partners of 1 at contact, falling to 0 at proximity_range."""
    nearness = 1.0 - _surface_gaps(task, state) / shaping.proximity_range
    return np.asarray(np.clip(nearness, 0.0, 1.0).sum(axis=-1))
