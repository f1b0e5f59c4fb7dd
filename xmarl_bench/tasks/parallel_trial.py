"""Tries an environment before it becomes a task: its agents, its spaces, and whether episodes repeat.

An episode must depend on its seed and its actions only. So a few steps are played twice, alone and in turns
with another episode, and must give the same bits. This finds clocks and global random numbers.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import zip_longest
from typing import Any, Final

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from pettingzoo import ParallelEnv

from xmarl_bench.errors import InputError, a_type
from xmarl_bench.reproducible import FRESH_SEEDS
from xmarl_bench.tasks.interface import random_actions
from xmarl_bench.tasks.parallel_task import Parallel, ParallelTask, foreign_code

TRIAL_STEPS: Final = 5
SEED, OTHER_SEED = FRESH_SEEDS.start - 2, FRESH_SEEDS.start - 1  # no score plays these, but as large ones
MAX_ACTIONS = 64  # as many as a policy's record holds


def parallel_task(name: str, make_env: Callable[[int], Any], n_agents: int) -> ParallelTask:
    """The task of the environments that `make_env` makes, for a team of `n_agents`.

    Raises InputError if it makes no ParallelEnv, if agents differ or spaces are unsupported, if the number of
    steps is unknown, or if episodes with the same seed differ.
    """
    with foreign_code(name, f"making a team of {n_agents}"):
        env = make_env(n_agents)
    if not isinstance(env, ParallelEnv):
        raise InputError(
            f"task {name!r} is {a_type(env)}: make its function return a PettingZoo ParallelEnv."
        )
    try:
        task = _described(name, make_env, n_agents, env)
    finally:
        with foreign_code(name, "close"):
            env.close()
    _check_repeats(task)
    return task


def _described(name: str, make_env: Callable[[int], Any], n_agents: int, env: Parallel) -> ParallelTask:
    """The task, as its environment says."""
    agents = list(getattr(env, "possible_agents", None) or ())
    if len(agents) != n_agents:
        raise InputError(
            f"task {name!r} made a team of {len(agents)} agents, asked for {n_agents}: give that team size, "
            f"or make it use the number that it is given."
        )
    with foreign_code(name, "its spaces"):
        observed = [env.observation_space(agent) for agent in agents]
        acted = [env.action_space(agent) for agent in agents]
    _check_equal(name, "observation", agents, observed)
    _check_equal(name, "action", agents, acted)
    return ParallelTask(
        name, n_agents, make_env, _obs_dim(name, observed[0]), _action_space(name, acted[0]),
        _max_cycles(name, env), type(env.unwrapped),
    )  # fmt: skip


def _check_equal(name: str, kind: str, agents: list[str], found: list[spaces.Space[Any]]) -> None:
    for agent, space in zip(agents, found, strict=True):
        if not isinstance(space, spaces.Space):
            raise InputError(
                f"task {name!r} has {kind}s of {agent} that are {type(space).__module__}."
                f"{type(space).__name__}: give it spaces of gymnasium."
            )
        if space != found[0]:
            raise InputError(
                f"task {name!r} has unequal agents ({kind}s of {agents[0]} are {found[0]}, those of {agent} "
                f"{space}): one policy shared by all agents needs equal spaces, so pad them."
            )


def _obs_dim(name: str, space: spaces.Space[Any]) -> int:
    if not isinstance(space, spaces.Box) or len(space.shape) != 1:
        raise InputError(
            f"task {name!r} has observations {space}: policies take vectors, a Box of one dimension, so "
            f"flatten them, e.g. with supersuit.flatten_v0."
        )
    return int(space.shape[0])


def _action_space(name: str, space: spaces.Space[Any]) -> spaces.Box | spaces.Discrete:
    if isinstance(space, spaces.Discrete) and space.n <= MAX_ACTIONS:
        return space
    if isinstance(space, spaces.Box) and len(space.shape) == 1 and space.shape[0] <= MAX_ACTIONS:
        if space.is_bounded():
            return space
        raise InputError(f"task {name!r} has unbounded actions {space}: give their Box a low and a high.")
    raise InputError(
        f"task {name!r} has actions {space}: policies choose a Discrete of at most {MAX_ACTIONS} actions, or "
        f"a Box of one dimension."
    )


def _max_cycles(name: str, env: Parallel) -> int:
    for layer in (env, env.unwrapped):
        cycles = getattr(layer, "max_cycles", None)
        if isinstance(cycles, int | np.integer) and cycles >= 1:
            return int(cycles)
    raise InputError(
        f"task {name!r} does not say how many steps an episode has: set `max_cycles` of its environment, "
        f"e.g. env.max_cycles = 100."
    )


def _check_repeats(task: ParallelTask) -> None:
    """Raise InputError if an episode differs when it is played again beside another one."""
    alone, beside = _played(task, (SEED,)), _played(task, (SEED, OTHER_SEED))
    for step, (first, again) in enumerate(zip_longest(alone, beside, fillvalue=np.empty(0))):
        if not np.array_equal(first, again, equal_nan=True):  # a reward may be NaN: `check task` names it
            when = "at the start" if step == 0 else f"after {step} steps"
            raise InputError(
                f"task {task.name!r} does not repeat: two episodes with seed {SEED} and the same actions "
                f"differ {when}: draw all random numbers from a generator of the environment that "
                f"reset(seed=...) seeds."
            )


def _played(task: ParallelTask, seeds: tuple[int, ...]) -> list[NDArray[np.float64]]:
    """At the start and at each step of the first episode: (N, D) observations beside (N, 1) rewards."""
    env = task.vector_env(len(seeds), TRIAL_STEPS)
    rng = np.random.default_rng(SEED)
    found = [np.append(env.reset(seeds)[0], np.zeros((task.n_agents, 1)), axis=1)]
    live = np.ones(len(seeds), dtype=np.bool_)
    while live[0]:
        chosen = random_actions(task, 1, rng)
        step = env.step(np.repeat(chosen, len(seeds), axis=0), live)
        found.append(np.append(step.observation[0], step.reward[0][:, None], axis=1))
        live &= ~(step.terminated | step.truncated)
    return found
