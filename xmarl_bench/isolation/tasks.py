"""Tasks of others, asked over a pipe: each steps its episodes in a process of its own.

B is the number of episodes that are stepped together, N of agents, D of observation entries.
"""

from __future__ import annotations

import secrets
import weakref
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any, NoReturn

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import BaseModel, ConfigDict, Field
from xmarl_envs import TASKS, Step

from xmarl_bench.errors import InputError
from xmarl_bench.isolation.conversation import (
    Isolation,
    Source,
    conversation,
    is_running,
    reading_answer,
    sendable,
)
from xmarl_bench.origin.plugins import origin_of_plugin
from xmarl_bench.origin.references import Origin, located, origin_of
from xmarl_bench.records.field_types import Name, Text
from xmarl_bench.tasks.sources import (
    TaskSource,
    known_task,
    open_task,
    opened_tasks,
    place_of,
    register,
)

KEPT = 16  # tasks of a process, each with a team size
Width = Annotated[int, Field(ge=1, le=4096)]


class _Told(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class ToldOrigin(_Told):
    distribution: Text | None
    version: Text | None
    entry_point: Text
    code_sha256: Text | None


class ToldSource(_Told):
    """What a process tells of what makes the task."""

    name: Name
    origin: ToldOrigin
    key: Text | None
    observation_names: tuple[Text, ...]


class ToldTask(_Told):
    """What a process tells of the task for a team."""

    obs_dim: Width
    observation_names: tuple[Text, ...]
    continuous_actions: bool
    action_width: Annotated[int, Field(ge=1, le=64)]
    default_max_cycles: Annotated[int, Field(ge=1, le=10**6)]
    has_objects: bool
    environment: ToldOrigin


def ask_task(
    task: str | Callable[..., Any], isolation: Isolation | None, *, trust_code: bool = False
) -> TaskSource:
    """As `open_task`, but a task that is not of xmarl_envs runs in a process of its own.

    isolation: None: in this process. Raises InputError as `open_task` does, and if the process fails.
    """
    if isolation is None:
        return open_task(task, trust_code=trust_code)
    if not isinstance(task, str):
        if task in TASKS.values():
            return open_task(task)
        name = str(getattr(task, "__name__", type(task).__name__))
        return ask_pickled(sendable(f"task {name!r}", task), name, isolation, origin_of(task))
    plugin = place_of(task, trust_code=trust_code)
    if isinstance(plugin, TaskSource):
        return plugin
    if plugin is not None:
        known = opened_tasks().get(task)
        if (
            isinstance(known, AskedSource)
            and known.source.isolation == isolation
            and is_running(known.source)
        ):
            return known
        asked = {"plugin": (plugin.name, plugin.value, plugin.group)}
        source = Source(f"task {task}", {"what": "task", **asked}, isolation)
        return _opened(source, origin_of_plugin(plugin), task)
    task, readable, origin = located(task)
    load = {"what": "task", "reference": task}
    return _opened(Source(f"task {Path(task).name}", load, isolation, readable), origin, None)


def ask_pickled(factory: bytes, name: str, isolation: Isolation, origin: Origin | None) -> TaskSource:
    """A task by its pickled factory, which is not loaded here. name: for messages."""
    return _opened(Source(f"task {name}", {"what": "task", "pickled": factory}, isolation), origin, None)


def _opened(source: Source, origin: Origin | None, name: str | None) -> TaskSource:
    """Start the process and register its task. name: that it must have."""
    declared = conversation(source).declared
    with reading_answer(source):
        told = ToldSource.model_validate(declared)
    if told.name in TASKS:
        return known_task(told.name)
    if name not in (None, told.name):
        raise InputError(f"task plugin {name!r} calls itself {told.name!r}: use one name for both.")
    found = AskedSource(
        told.name,
        _not_here,
        origin or Origin(**vars(told.origin)),
        replace(source, key=told.key),
        told.key or secrets.token_hex(),
        told.observation_names,
    )
    register(found)
    return found


def _not_here(*_: object) -> NoReturn:
    raise InputError("this task runs in a process of its own: make it by `TaskSource.make`.")


@dataclass(frozen=True)
class AskedSource(TaskSource):
    """See `TaskSource`."""

    source: Source
    key: str
    names: tuple[str, ...]

    def make(self, n_agents: int) -> AskedTask:
        return _made(self, n_agents, None)

    def code_sha256(self) -> str:
        return f"elsewhere {self.key}"

    @property
    def observation_names(self) -> tuple[str, ...]:
        return self.names

    def environment(self, n_agents: int) -> Origin:
        return self.make(n_agents).environment


@lru_cache(maxsize=KEPT)
def _made(source: AskedSource, n_agents: int, continuous: bool | None) -> AskedTask:
    """continuous: with such actions; None: with its own."""
    question = {"what": "make", "n_agents": n_agents, "continuous": continuous}
    header, _ = conversation(source.source).ask(question)
    with reading_answer(source.source):
        told = ToldTask.model_validate(header)
    if len(told.observation_names) not in (0, told.obs_dim):
        raise InputError(f"{source.source.name} names another number of observation entries: correct it.")
    environment = Origin(**vars(told.environment))
    return AskedTask(source, n_agents, continuous, **{**vars(told), "environment": environment})


@dataclass(frozen=True)
class AskedTask:
    """See `TeamTask`."""

    source: AskedSource
    n_agents: int
    continuous: bool | None  # asked for; None: its own actions
    obs_dim: int
    observation_names: tuple[str, ...]
    continuous_actions: bool
    action_width: int
    default_max_cycles: int
    has_objects: bool
    environment: Origin

    @property
    def name(self) -> str:
        return self.source.name

    def with_actions(self, continuous: bool) -> AskedTask:
        if continuous == self.continuous_actions:
            return self
        return _made(self.source, self.n_agents, continuous)

    def vector_env(self, n_episodes: int, max_cycles: int | None = None) -> AskedEpisodes:
        return AskedEpisodes(self, n_episodes, max_cycles)


class AskedEpisodes:
    """See `TeamEpisodes`. All of them take a step in one question."""

    def __init__(self, task: AskedTask, n_episodes: int, max_cycles: int | None) -> None:
        self.task, self.source = task, task.source.source
        self.teams = n_episodes, task.n_agents
        number = secrets.token_hex()
        self.whose = {
            "number": number, "n_agents": task.n_agents, "continuous": task.continuous,
            "n_episodes": n_episodes, "max_cycles": max_cycles,
        }  # fmt: skip
        weakref.finalize(self, _ended.setdefault(self.source.token, []).append, number)

    def reset(self, seeds: Sequence[int], episodes: ArrayLike | None = None) -> NDArray[np.float32]:
        which = None if episodes is None else np.atleast_1d(np.asarray(episodes)).tolist()
        (observation,) = self._ask("reset", [self._seen], seeds=[int(each) for each in seeds], episodes=which)
        return self._checked(observation)

    def step(self, action: NDArray[Any], live: NDArray[np.bool_] | None = None) -> Step:
        each, told = ("<f8", self.teams), ("?", self.teams[:1])
        kinds = [self._seen, each, told, told, each, each, each]
        step = Step(*self._ask("step_task", kinds, action=action, live=live))
        self._checked(step.observation)
        return step

    @property
    def _seen(self) -> tuple[str, tuple[int, ...]]:
        return "<f4", (*self.teams, self.task.obs_dim)

    def _checked(self, observation: NDArray[np.float32]) -> NDArray[np.float32]:
        if not np.isfinite(observation).all():
            raise InputError(f"{self.source.name} gave observations that are NaN or infinite: correct it.")
        return observation

    def _ask(self, what: str, kinds: Sequence[tuple[str, tuple[int, ...]]], **more: object) -> list[Any]:
        """The process's arrays, of the given types and shapes. Raises InputError if they are not that."""
        process, ended = conversation(self.source), _ended.setdefault(self.source.token, [])
        gone = [ended.pop() for _ in range(len(ended))]  # finalisers hold the list itself
        _, payload = process.ask({"what": what, "ended": gone, **self.whose, **more})
        expected = np.dtype([("", *kind) for kind in kinds])
        if len(payload) != expected.itemsize:
            raise InputError(f"{self.source.name} answered with other shapes than its own: correct it.")
        return [array.copy() for array in np.frombuffer(payload, expected)[0]]


_ended: dict[str, list[str]] = {}  # by token: numbers of episodes that nobody plays any more
