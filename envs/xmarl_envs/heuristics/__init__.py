"""One heuristic per task that sees the whole state: it shows that the task can be solved."""

from __future__ import annotations

from xmarl_envs.blind_discovery_v0 import BlindDiscovery
from xmarl_envs.blind_navigation_v0 import BlindNavigation
from xmarl_envs.blind_passage_v0 import BlindPassage
from xmarl_envs.heuristics.discovery import search
from xmarl_envs.heuristics.navigation import drive
from xmarl_envs.heuristics.passage import queue
from xmarl_envs.task import Floats, State, Task

__all__ = ["heuristic"]


def heuristic(task: Task, state: State) -> Floats:
    """(B, N, 2) actions in [-1, 1] of the task's heuristic. Raises TypeError if the task has none."""
    if isinstance(task, BlindNavigation):
        return drive(task, state)
    if isinstance(task, BlindPassage):
        return queue(task, state)
    if isinstance(task, BlindDiscovery):
        return search(task, state)
    raise TypeError(f"{task.name} has no heuristic: there is one for each task of xmarl_envs.TASKS.")
