"""Checks of a task of others: it can be scored, episodes repeat, and what its infos tell.

S is the number of timesteps, N agents, D observation entries.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from xmarl_bench.checks.findings import Failed, Finding, NotApplicable, run_checks
from xmarl_bench.counted import counted
from xmarl_bench.rollout.cell import Cell
from xmarl_bench.rollout.episodes import Episode, Floats, play
from xmarl_bench.rollout.reference_states import FIRST_FIT_SEED
from xmarl_bench.tasks.interface import TeamTask, random_actions

SEED: Final = 1


@dataclass(frozen=True)
class TaskSubject:
    """A task for a team, with whole episodes of random actions, which no score plays."""

    task: TeamTask
    n_episodes: int

    def played(self, parallel_episodes: int) -> list[Episode]:
        """The episodes. Actions depend on the seed of the episode and on the step alone."""
        episodes = []
        for first in range(0, self.n_episodes, parallel_episodes):
            last = min(first + parallel_episodes, self.n_episodes)
            seeds = range(FIRST_FIT_SEED + first, FIRST_FIT_SEED + last)
            rngs = [np.random.default_rng([SEED, seed]) for seed in seeds]

            def act(
                seen: Floats, slots: Sequence[int], rngs: list[np.random.Generator] = rngs
            ) -> tuple[NDArray[Any], Floats]:
                return np.concatenate([random_actions(self.task, 1, rng) for rng in rngs]), seen[..., :0]

            episodes += play(self.task, act, seeds)
        return episodes

    @cached_property
    def together(self) -> list[Episode]:
        return self.played(self.n_episodes)


def check_task(cell: Cell, *, episodes: int = 5) -> Iterator[Finding]:
    """Run every check on whole episodes of random actions."""
    yield from run_checks(CHECKS, TaskSubject(cell.make(), episodes))


def spaces(subject: TaskSubject) -> str:
    task = subject.task
    kind = "entries" if task.continuous_actions else "choices"
    action = f"{task.action_width} {kind} of an action"
    return f"{counted(task.n_agents, 'agent')}, {task.obs_dim} entries of an observation, {action}"


def ends(subject: TaskSubject) -> str:
    lengths = [episode.makespan for episode in subject.together]
    return f"{min(lengths)} to {max(lengths)} steps, at most {subject.task.default_max_cycles}"


def repeats(subject: TaskSubject) -> str:
    for one, other in zip(subject.together, subject.played(1), strict=True):
        same_reward = np.array_equal(one.reward, other.reward, equal_nan=True)
        same = same_reward and np.array_equal(one.observations, other.observations)
        if not same:
            raise Failed(
                f"episode {one.seed} differs when it is played alone and beside others: draw all random "
                f"numbers from a generator of the environment that reset(seed=...) seeds."
            )
    return f"{subject.n_episodes} whole episodes, alone and beside one another"


def differ(subject: TaskSubject) -> str:
    starts = {episode.observations[0].tobytes() for episode in subject.together}
    if len(starts) == 1:
        raise Failed("episodes with different seeds start alike: draw the start from the seed.")
    return f"{len(starts)} starts of {subject.n_episodes} seeds"


def rewarded(subject: TaskSubject) -> str:
    rewards = [episode.reward for episode in subject.together]
    if not np.isfinite(rewards).all():
        raise Failed("a reward is NaN or infinite: look for a division by zero or an overflow.")
    return f"{min(rewards):.2f} to {max(rewards):.2f} by random actions"


def told(metric: str) -> Callable[[TaskSubject], str]:
    """The check of a metric that infos may tell."""

    def check(subject: TaskSubject) -> str:
        values = np.array([getattr(episode, metric) for episode in subject.together])
        if np.isnan(values).all():
            raise NotApplicable("infos do not tell it: null in entries.")
        n_told = np.count_nonzero(~np.isnan(values))
        if n_told < values.size:
            raise Failed(
                f"told in {n_told} of {values.size} episodes, and means are over these: tell it in every "
                f"episode, whether True or False."
            )
        return f"{np.nanmean(values):.2f} by random actions"

    return check


CHECKS: Final[dict[str, Callable[[TaskSubject], str]]] = {
    "spaces": spaces,
    "episodes end": ends,
    "episodes repeat": repeats,
    "seeds differ": differ,
    "finite rewards": rewarded,
    "success": told("success_rate"),
    "no agent collision": told("no_agent_collision"),
    "no object collision": told("no_object_collision"),
}
