"""The constructors of a task's PettingZoo module, which import PettingZoo and the physics when called."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

from xmarl_envs.task import Task

if TYPE_CHECKING:
    from pettingzoo import AECEnv

    from xmarl_envs.parallel import Array, TaskParallelEnv


class Constructors(NamedTuple):
    """The three constructors of a PettingZoo module."""

    parallel_env: Callable[..., TaskParallelEnv]
    env: Callable[..., AECEnv[str, Array, Any]]
    raw_env: Callable[..., AECEnv[str, Array, Any]]


def make_constructors(task_class: type[Task]) -> Constructors:
    """`parallel_env`, `env` and `raw_env` of a task, as PettingZoo names them.

    Each takes n_agents=3, max_cycles=None (the task's own), render_mode=None, continuous_actions=True and
    the task's options.
    """

    def parallel_env(
        n_agents: int = 3, max_cycles: int | None = None, render_mode: str | None = None, **options: Any
    ) -> TaskParallelEnv:
        from xmarl_envs.parallel import TaskParallelEnv

        return TaskParallelEnv(task_class(n_agents=n_agents, **options), max_cycles, render_mode)

    def raw_env(**kwargs: Any) -> AECEnv[str, Array, Any]:
        from pettingzoo.utils import parallel_to_aec

        return parallel_to_aec(parallel_env(**kwargs))

    def env(**kwargs: Any) -> AECEnv[str, Array, Any]:
        from pettingzoo.utils import wrappers

        return wrappers.OrderEnforcingWrapper(raw_env(**kwargs))

    for constructor in (parallel_env, raw_env, env):
        constructor.__doc__ = f"{constructor.__name__} of {task_class.__name__}; see the module's docstring."
    return Constructors(parallel_env, env, raw_env)
