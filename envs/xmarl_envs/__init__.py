"""The blind tasks of Kailas, Jain and Ravichandar (ICML 2025) on rigid-body physics, for PettingZoo."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from xmarl_envs.blind_discovery_v0 import BlindDiscovery
from xmarl_envs.blind_navigation_v0 import BlindNavigation
from xmarl_envs.blind_passage_v0 import BlindPassage
from xmarl_envs.registration import register_tasks
from xmarl_envs.task import Layout, Outcome, State, Step, Task

if TYPE_CHECKING:
    from xmarl_envs.parallel import TaskParallelEnv
    from xmarl_envs.vector_env import VectorEnv

TASKS: dict[str, type[Task]] = {task.name: task for task in (BlindNavigation, BlindPassage, BlindDiscovery)}
register_tasks(TASKS.values())

# Loaded on first use: rules need no physics.
_MODULES = {"TaskParallelEnv": "parallel", "VectorEnv": "vector_env"}

__all__ = [
    "TASKS", "BlindDiscovery", "BlindNavigation", "BlindPassage", "Layout", "Outcome", "State", "Step",
    "Task", "TaskParallelEnv", "VectorEnv", "make_task",
]  # fmt: skip


def make_task(name: str, n_agents: int = 3, **options: Any) -> Task:
    """The rules of a task by name. Raises ValueError if the name is not in `TASKS`."""
    if name not in TASKS:
        raise ValueError(f"unknown task {name!r}: choose one of {', '.join(TASKS)}.")
    return TASKS[name](n_agents=n_agents, **options)


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module 'xmarl_envs' has no attribute {name!r}")
    value = getattr(import_module(f"xmarl_envs.{_MODULES[name]}"), name)
    globals()[name] = value
    return value
