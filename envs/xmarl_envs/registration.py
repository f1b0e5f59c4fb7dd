"""Registers tasks with PettingZoo and Gymnasium: `xmarl/blind_navigation-v0` for `blind_navigation_v0`.

| | made by |
|---|---|
| `pettingzoo.make("parallel", id)`, `pettingzoo.make("aec", id)` | the module's `parallel_env`, `env` |
| `gymnasium.make(id)` | `team_env` |
| `gymnasium.make_vec(id, num_envs)` | `team_vector_env` |

All take n_agents=3, max_cycles and the task's options.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import gymnasium
import pettingzoo

from xmarl_envs.task import Task

if TYPE_CHECKING:
    from xmarl_envs.gymnasium_env import TeamEnv
    from xmarl_envs.gymnasium_vector_env import TeamVectorEnv


def registered_id(name: str) -> str:
    """The id of a task: `blind_navigation_v0` -> `xmarl/blind_navigation-v0`."""
    base, _, version = name.rpartition("_v")
    return f"xmarl/{base}-v{version}"


def register_tasks(tasks: Iterable[type[Task]]) -> None:
    """Register tasks; imports nothing but their names until one is made."""
    for task in tasks:
        name = registered_id(task.name)
        gymnasium.register(
            name,
            entry_point=f"{__name__}:team_env",
            vector_entry_point=f"{__name__}:team_vector_env",
            kwargs={"task": task.name},
        )
        pettingzoo.register("aec", name, entry_point=f"{task.__module__}:env")
        pettingzoo.register("parallel", name, entry_point=f"{task.__module__}:parallel_env")


def team_env(
    task: str,
    n_agents: int = 3,
    max_cycles: int | None = None,
    render_mode: str | None = None,
    **options: Any,
) -> TeamEnv:
    from xmarl_envs import make_task  # imports this module
    from xmarl_envs.gymnasium_env import TeamEnv

    return TeamEnv(make_task(task, n_agents, **options), max_cycles, render_mode)


def team_vector_env(
    task: str,
    num_envs: int = 1,
    n_agents: int = 3,
    max_cycles: int | None = None,
    copies_per_space: int = 1,
    autoreset_mode: str = "NextStep",
    **options: Any,
) -> TeamVectorEnv:
    from xmarl_envs import make_task  # imports this module
    from xmarl_envs.gymnasium_vector_env import TeamVectorEnv

    return TeamVectorEnv(
        make_task(task, n_agents, **options), num_envs, max_cycles, copies_per_space, autoreset_mode
    )
