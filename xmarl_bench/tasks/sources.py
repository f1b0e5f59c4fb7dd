"""Finds tasks: those of xmarl_envs, those of installed packages, and those given as `module:factory`.

Entry points in group `xmarl_bench.tasks`, name -> a subclass of `xmarl_envs.Task` of the same name, or a
function that takes a team size and returns a PettingZoo ParallelEnv; the same as `module:factory` and
`path/to/file.py:factory`. A function gives its task its own name, or that of its entry point.

A task that is not of xmarl_envs is a stranger's code. `open_task` runs it, and only if it is trusted; from
then on the process knows it by its name, as a `Cell` and the card of a policy give it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from importlib.metadata import EntryPoint, entry_points
from typing import Any, Final

import numpy as np
from xmarl_envs import TASKS, Task

from xmarl_bench.errors import InputError, a_type, unknown
from xmarl_bench.origin.plugins import load_plugin, origin_of_plugin, plugins_by_name
from xmarl_bench.origin.references import Origin, check_named, is_reference, load_reference, origin_of
from xmarl_bench.records.field_types import is_file_name
from xmarl_bench.tasks.interface import TeamTask, random_actions
from xmarl_bench.tasks.parallel_task import ParallelTask, foreign_code
from xmarl_bench.tasks.parallel_trial import SEED, parallel_task

GROUP: Final = "xmarl_bench.tasks"
KEPT = 8  # tasks of a process, each with a team size, that are tried once only

_opened: dict[str, TaskSource] = {}


@dataclass(frozen=True)
class TaskSource:
    """What makes a task for a team size, and where it came from.

    factory: a subclass of `Task`, or a function of a team size that returns a ParallelEnv.
    origin: None for a task of xmarl_envs.
    """

    name: str
    factory: Callable[..., Any]
    origin: Origin | None

    def make(self, n_agents: int) -> TeamTask:
        """The task. Raises InputError for a team size that it does not take, and as `parallel_task` does."""
        factory = _task_class(self.factory)
        if factory is None:
            return _tried(self.name, self.factory, n_agents)
        if not 1 <= n_agents <= factory.max_agents:
            raise InputError(
                f"{self.name} takes 1 to {factory.max_agents} agents, got {n_agents}: choose a number in "
                f"that range."
            )
        if self.origin is None:
            return factory(n_agents=n_agents)
        return _tried_rules(self.name, factory, n_agents)

    def code_sha256(self) -> str | None:
        """Hash of the factory and its code; None if it has none."""
        from xmarl_bench.origin.code_hash import object_sha256  # imports torch

        return object_sha256(self.factory)

    @property
    def observation_names(self) -> tuple[str, ...]:
        """One per entry of an observation; () if unknown."""
        return getattr(self.factory, "observation_names", ())

    def environment(self, n_agents: int) -> Origin:
        """The origin of the environment that the factory wraps; of a subclass of Task its own."""
        task = self.make(n_agents)
        return origin_of(task.env_class if isinstance(task, ParallelTask) else type(task))


def _task_class(factory: object) -> type[Task] | None:
    """The factory, if it is a subclass of `Task`."""
    return factory if isinstance(factory, type) and issubclass(factory, Task) else None


_tried = lru_cache(maxsize=KEPT)(parallel_task)


@lru_cache(maxsize=KEPT)
def _tried_rules(name: str, factory: type[Task], n_agents: int) -> Task:
    """A task of one's own. Raises InputError if its first step fails."""
    with foreign_code(name, f"making a team of {n_agents}"):
        task = factory(n_agents=n_agents)
    with foreign_code(name, "its first step"):
        env = task.vector_env(1)
        seen = env.reset([SEED])
        env.step(random_actions(task, 1, np.random.default_rng(SEED)))
        expected = (n_agents, task.obs_dim)
    if seen.shape != (1, *expected):
        raise InputError(
            f"task {name!r} gave observations of shape {seen.shape[1:]}, expected {expected}: name every "
            f"entry of an observation in observation_names."
        )
    return task


def task_names() -> list[str]:
    """Tasks of xmarl_envs, of installed packages, and those opened in this process. Loads nothing."""
    return list(dict.fromkeys([*TASKS, *task_plugins(), *_opened]))


def opened_tasks() -> dict[str, TaskSource]:
    """The tasks of others that this process has opened, by name."""
    return dict(_opened)


def task_plugins() -> dict[str, EntryPoint]:
    """The tasks of installed packages by name. Loads nothing. Raises InputError if two share a name."""
    return plugins_by_name(entry_points(group=GROUP), "task", dict.fromkeys(TASKS, "a shipped task"))


def open_task(task: str | Callable[..., Any], *, trust_code: bool = False) -> TaskSource:
    """A task by its name, by `module:factory` or `path/to/file.py:factory`, or the factory itself.

    Raises InputError if there is no such task, and for code that is not trusted.
    """
    if not isinstance(task, str):
        return open_factory(task, origin_of(task), None)
    place = place_of(task, trust_code=trust_code)
    if isinstance(place, TaskSource):
        return place
    if place is None:
        return open_factory(*load_reference(task), None)
    return open_factory(load_plugin(place), origin_of_plugin(place), task)


def place_of(task: str, *, trust_code: bool) -> TaskSource | EntryPoint | None:
    """A known task, or the entry point of one to open; None for a reference. Loads nothing.

    Raises InputError if there is no such task, and for code that is not trusted.
    """
    plugin = None if task in TASKS or is_reference(task) else task_plugins().get(task)
    if plugin is None and not is_reference(task):
        check_named(task)
        return known_task(task)
    check_trust(task, trust_code)
    return plugin


def known_task(name: str) -> TaskSource:
    """A task of xmarl_envs, or one that was opened. Raises InputError for any other."""
    if name in TASKS:
        return TaskSource(name, TASKS[name], None)
    if name in _opened:
        return _opened[name]
    if name in task_plugins():
        check_trust(name, False)
    raise unknown("task", name, task_names(), "or give path/to/file.py:factory or module:factory")


def open_factory(factory: object, origin: Origin, name: str | None) -> TaskSource:
    """Register a factory. name: of its entry point, if it has one. Raises InputError for anything else."""
    own = _task_class(factory)
    if own and not isinstance(getattr(own, "name", None), str):
        raise InputError(f"task {own.__name__} ({origin.entry_point}) has no name: give its class a `name`.")
    chosen = str(own.name if own else name or getattr(factory, "__name__", type(factory).__name__))
    if not callable(factory) or (isinstance(factory, type) and own is None):
        raise InputError(
            f"task {chosen!r} ({origin.entry_point}) is {a_type(factory)}: give a subclass of "
            f"xmarl_envs.Task, or a function of a team size that returns a PettingZoo ParallelEnv."
        )
    try:
        hash(factory)  # what was tried is kept by it
    except TypeError as error:
        raise InputError(
            f"task {chosen!r} ({origin.entry_point}) cannot be hashed ({error}): give a function."
        ) from None
    if name is not None and chosen != name:
        raise InputError(
            f"task plugin {name!r} ({origin.entry_point}) calls itself {chosen!r}: use one name for both."
        )
    if not is_file_name(chosen):
        raise InputError(f"task name {chosen!r} cannot be part of a file name: use a-z, 0-9, . _ and -.")
    if chosen in TASKS and own is not TASKS[chosen]:
        raise InputError(f"task {chosen!r} ({origin.entry_point}) has the name of a shipped task: rename it.")
    source = TaskSource(chosen, factory, origin)
    if chosen not in TASKS:
        register(source)
        return source
    return TaskSource(chosen, factory, None)


def register(source: TaskSource) -> None:
    """From now on, this process knows the task by its name."""
    _opened[source.name] = source


def check_trust(name: str, trust_code: bool) -> None:
    """Raise InputError unless the code of the task is trusted."""
    if not trust_code:
        raise InputError(
            f"task {name!r} runs its own code: read it, and add --trust-code (trust_code=True) if you trust "
            f"it."
        )
