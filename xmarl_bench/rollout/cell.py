"""Which states are scored: a task with a team size, its episodes, and the timesteps of each."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from xmarl_bench.errors import InputError, whole_number
from xmarl_bench.reproducible import episode_seeds
from xmarl_bench.tasks.interface import TeamTask
from xmarl_bench.tasks.sources import TaskSource, known_task

BLOCK = 10  # episodes in a unit of work: a killed run loses at most so many per worker


@dataclass(frozen=True)
class Cell:
    """A task with a team size. Raises InputError for an unknown task or a team size that it does not take."""

    task: str
    n_agents: int
    source: TaskSource = field(init=False, repr=False, compare=False)  # a worker process knows no names

    def __post_init__(self) -> None:
        object.__setattr__(self, "n_agents", whole_number("n_agents", self.n_agents))
        object.__setattr__(self, "source", known_task(self.task))
        self.make()

    def make(self) -> TeamTask:
        """The task for this team. Raises InputError as `TaskSource.make` does."""
        return self.source.make(self.n_agents)


@dataclass(frozen=True)
class Sampling:
    """Which states are scored. Entries with different sampling do not share a table."""

    episodes: int = 50
    timesteps: int | None = None  # at most so many of each episode, evenly spaced; None: all
    max_cycles: int | None = None  # steps per episode; None: the task's default
    seed: int = 0  # of the episodes, and of the explainers' randomness
    given: tuple[int, ...] | None = None  # environment seeds in place of those of `seed`

    def __post_init__(self) -> None:
        for name in ("episodes", "seed"):
            object.__setattr__(self, name, whole_number(name, getattr(self, name)))
        episode_seeds(self.seed, self.episodes)
        if self.given is not None and len(self.given) != self.episodes:
            raise InputError(f"got {len(self.given)} seeds for {self.episodes} episodes: give one for each.")
        for name in ("timesteps", "max_cycles"):
            value = getattr(self, name)
            if value is None:
                continue
            object.__setattr__(self, name, whole_number(name, value))
            if value < 1:
                raise InputError(
                    f"{name} must be at least 1, got {value}: choose a larger one, or leave it out."
                )

    @property
    def seeds(self) -> list[int]:
        return episode_seeds(self.seed, self.episodes) if self.given is None else list(self.given)


def check_parallel(parallel_episodes: int) -> None:
    """Raise InputError if parallel_episodes is no whole number from 1 on."""
    if whole_number("parallel_episodes", parallel_episodes) < 1:
        raise InputError(
            f"parallel_episodes must be at least 1, got {parallel_episodes}: "
            f"give the number of episodes to step in parallel."
        )


def spaced_timesteps(length: int, timesteps: int | None) -> NDArray[np.int64]:
    """Indices of at most `timesteps` evenly spaced steps of `length`: the middles of equal intervals."""
    if timesteps is None or timesteps >= length:
        return np.arange(length)
    return np.asarray((2 * np.arange(timesteps) + 1) * length // (2 * timesteps))
